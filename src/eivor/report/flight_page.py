"""HTML page of a result, and its drawings."""

from __future__ import annotations

import base64
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from io import BytesIO
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from eivor.flights.motion import MultiStepPrediction
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import PlotData, Trace
from eivor.flights.result import FlightEstimate, FlightRow, LogEstimate
from eivor.report import document as doc
from eivor.report import flight as report
from eivor.report import flight_figures
from eivor.report.figure_panels import Axes, Chart, Line, Picture, Pictures, forest_picture, page
from eivor.report.figures import draw_by_horizon, write_figure
from eivor.report.frequency_responses import response_pictures
from eivor.report.html import rendered, uplot, whole_page
from eivor.report.json_document import FitDocument, fit_document, json_document, log_document, number, plain
from eivor.tools import Float, capitalised, printable

#: Code of a value that is not there, and the largest of one that is.
MISSING, LARGEST = 65535, 65534
#: Samples further apart than so many steps are not joined by a line.
BROKEN_AFTER = 1.5


def packed(chart: Chart, most: int) -> dict[str, object]:
    """A chart for the page's script, in about `most` samples."""
    values = np.stack([line.values for line in chart.lines], axis=1)
    stretches, kept = _thinned(chart.time_s, values, most)
    return {
        "group": chart.group,
        "unit": printable(chart.unit),
        "hertz": chart.over_frequency,
        "over": list(chart.over_s),
        "view": list(chart.view_s),
        "leftOut": [list(pair) for pair in chart.omitted_s],
        "stretches": stretches,
        "lines": [
            {"label": printable(line.label), "look": line.look, **_coded(kept[:, index])}
            for index, line in enumerate(chart.lines)
        ],
    }


def _thinned(
    time_s: Float[np.ndarray, " n"], values: Float[np.ndarray, "n lines"], most: int
) -> tuple[list[list[float]], Float[np.ndarray, "kept lines"]]:
    """Start, step and count of each unbroken stretch, and its values: all, or the ends of their ranges."""
    if time_s.size < 2:
        return [[float(item), 0.0, 1] for item in time_s], values
    steps = np.diff(time_s)
    step = float(np.median(steps))
    edges = [0, *(np.flatnonzero(steps > BROKEN_AFTER * step) + 1).tolist(), time_s.size]
    together = max(1, -(-2 * time_s.size // most)) if time_s.size > most else 1
    stretches, kept = [], []
    for first, end in pairwise(edges):
        part = values[first:end] if together == 1 else _ranges(values[first:end], together)
        stretches.append([float(time_s[first]), step * max(together / 2.0, 1.0), len(part)])
        kept.append(part)
    return stretches, np.concatenate(kept)


def _ranges(values: Float[np.ndarray, "n lines"], together: int) -> Float[np.ndarray, "kept lines"]:
    """Least and greatest of so many values at a time, in the order in which they come."""
    short = -len(values) % together
    padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
    blocks = padded.reshape(-1, together, values.shape[1])
    low = np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    both = np.take_along_axis(blocks, np.sort(np.stack([low, high], axis=1), axis=1), axis=1)
    return both.reshape(-1, values.shape[1])


def _coded(values: Float[np.ndarray, " n"]) -> dict[str, object]:
    """Values as integers of two bytes in base64, and how to turn them back."""
    there = np.isfinite(values)
    low, high = (float(values[there].min()), float(values[there].max())) if there.any() else (0.0, 0.0)
    step = (high - low) / LARGEST
    codes = np.full(values.size, MISSING, dtype="<u2")
    codes[there] = np.rint((values[there] - low) / step) if step > 0.0 else 0
    return {"low": low, "step": step, "codes": base64.b64encode(codes.tobytes()).decode("ascii")}


WIDTH_INCHES = 3.5
#: Samples of all lines of a page together; each chart has its share.
SAMPLES = 160_000
#: What a chart has in any case, and what no screen has any use for.
FEWEST, MOST = 1_000, 20_000


@dataclass
class Figures:
    """Figures of one page: they are numbered, so that no two have one name, and share its room."""

    lines: int
    charts: dict[str, dict[str, object]] = field(default_factory=dict)
    count: int = 0

    def html(self, groups: Iterable[Pictures]) -> Markup:
        """Groups of pictures, but those without one."""
        drawn = []
        for heading, pictures in groups:
            entries = [self._entry(picture) for picture in pictures]
            charts = [entry for entry in entries if isinstance(entry[1].drawn, Chart)]
            if entries:
                drawn.append((heading, charts, [entry for entry in entries if entry not in charts]))
        return rendered("figures.html", groups=drawn)

    def _entry(self, picture: Picture) -> tuple[str, Picture, str]:
        """Name of a picture, and its drawing: none for a chart, whose data the page's script draws."""
        self.count += 1
        name = f"picture-{self.count}"
        if isinstance(picture.drawn, Chart):
            most = min(max(SAMPLES // max(self.lines, 1), FEWEST), MOST)
            self.charts[name] = {**packed(picture.drawn, most), "title": printable(picture.title)}
            return name, picture, ""
        return name, picture, drawing(picture.drawn, name, picture.height)


def drawing(draw: Callable[[Axes], None], name: str, height: float) -> str:
    """SVG as the address of an image; empty without Matplotlib, which a page does without."""
    if find_spec("matplotlib") is None:
        return ""
    from matplotlib import rc_context

    figure = page(WIDTH_INCHES, height)
    axes = figure.add_subplot()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Attempting to set identical")  # values that are all equal
        draw(axes)
        axes.get_ylim()
    axes.set_title("")
    axes.tick_params(labelsize=8)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_fontsize(8.5)
        if axis.get_scale() != "linear":
            bend = getattr(axis.get_transform(), "linthresh", 0.0)  # below it numbers would touch
            axis.set_major_formatter(partial(lambda bend, x, _: "" if 0.0 < x < bend else f"{x:g}", bend))
    stream = BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "savefig.transparent": True}):
        write_figure(figure, stream, "svg")
    return f"data:image/svg+xml;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def _forests(
    result: FlightEstimate, rows: Sequence[FlightRow], whole: Mapping[str, doc.QuantityRow]
) -> Iterator[Picture]:
    """Forest of each quantity of a motion's `rows`; below them that of the whole, if any. None of no rows."""
    motion = result.motion
    by_label = [(row.label, {item.name: item for item in report.row_quantities(row, motion)}) for row in rows]
    for name in (name for name in motion.quantities if rows and name in motion.quantities.rows):
        drawn = [flight_figures.quantity_interval(label, quantities[name]) for label, quantities in by_label]
        if name in whole:
            drawn.append(replace(flight_figures.quantity_interval("all together", whole[name]), whole=True))
        wording = motion.quantities[name]
        yield forest_picture(capitalised(wording.words), doc.axis_of(wording), drawn)


def _prediction_pictures(prediction: MultiStepPrediction) -> Iterator[Picture]:
    draw = partial(draw_by_horizon, prediction=prediction)
    for models in prediction.by_quantity:
        yield Picture(f"Error of {models[0].quantity} by horizon", "", partial(draw, models=models))


#: Flights of a pool that are drawn over time; the others are in its tables.
MOST_FLIGHTS = 8
#: Share of the time used that is shown on either side of it.
AROUND = 0.04


def _flights_over_time(result: FlightEstimate) -> Iterator[tuple[str, tuple[Picture, ...]]]:
    several = len(result.prepared) > 1
    traces = () if result.fit is None else result.fit.traces(result.motion)
    runs = [] if result.fit is None else flight_figures.flight_runs(result)
    for index, flight in enumerate(result.prepared[:MOST_FLIGHTS]):
        runs_kept = [run for run in runs if run.flight == index]
        fitted = _fitted(index, flight, traces, runs_kept) if runs_kept else ()
        pictures = (*fitted, *_flown(index, flight, result))
        yield flight.recording.name if several else "", pictures


def _fitted(
    number: int, flight: PreparedFlight, traces: tuple[Trace, ...], runs: list[flight_figures.FlightRun]
) -> Iterator[Picture]:
    time = np.concatenate([run.time_s for run in runs])
    for trace in traces:
        rows, parts = [], []
        for run in runs:
            part = np.column_stack([band := flight_figures.within_band(trace, run), band[:, 0] - band[:, 1]])
            times = (f"{run.time_s[0]:.2f}", f"{run.time_s[-1]:.2f}", f"{run.time_s.size}")
            rows.append((*times, *np.sqrt(np.mean(part**2, axis=0)).tolist()))
            parts.append(part)
        of_rms = (f"RMS {what} [{trace.unit}]" for what in ("measured", "predicted", "left"))
        table = doc.number_table(("from [s]", "to [s]", "samples", *of_rms), rows)
        measured, predicted, left = np.concatenate(parts).T
        low, high = flight_figures.band_of(trace, runs[0])
        passed = f"Both are band-passed {low:.2f} to {high:.0f} Hz.{_hatched(flight)}"
        model = Line(f"predicted: {trace.model}", "predicted", predicted)
        both = (Line("measured", "measured", measured), model)
        residual = (Line("measured − predicted", "residual", left),)
        for what, words, lines in (
            ("measured and predicted", passed, both),
            ("what the model leaves", "Nothing of the vehicle's movement should be seen in it.", residual),
        ):
            title = f"{capitalised(trace.axis)}, {what} [{trace.unit}]"
            yield Picture(title, words, _chart(number, flight, trace.unit, time, lines), table)


def _flown(number: int, flight: PreparedFlight, result: FlightEstimate) -> Iterator[Picture]:
    where, active = result.motion.words.where, flight.active
    known = f"{capitalised(where)} by {active.rule}." if active.mask.any() else f"Never {where}."
    count = len(flight.driving)
    mean = "" if count == 1 else f", mean of {count} actuators"
    logged = PlotData(f"input: {flight.input.name}{mean}", flight.logged_input)
    for panel in (*result.motion.view(flight).panels, logged):
        name, _, unit = " ".join(panel.label.split()).partition(" [")
        lines = [Line("measured" if unit else "logged", "measured", panel.values)]
        if panel.reference is not None:
            lines.append(Line("asked for", "predicted", panel.reference))
        title = f"{capitalised(name)} [{unit}" if unit else capitalised(name)
        rows: list[tuple[float | str, ...]] = []
        for line in lines:
            there = line.values[np.isfinite(line.values)]
            measures = (there.min, there.mean, there.max, there.std)
            rows.append((line.label, *(float(of()) if there.size else np.nan for of in measures)))
        table = doc.number_table(("series", "least", "mean", "greatest", "standard deviation"), rows)
        chart = _chart(number, flight, unit.removesuffix("]"), flight.grid.time_s, tuple(lines))
        yield Picture(title, f"{known}{_hatched(flight)}", chart, table)


def _chart(
    number: int, flight: PreparedFlight, unit: str, time_s: Float[np.ndarray, " n"], lines: tuple[Line, ...]
) -> Chart:
    whole = flight.grid.time_s
    over = view = (float(whole[0]), float(whole[-1]))
    if flight.runs:
        first, last = flight.span_s
        around = AROUND * (last - first)
        view = (max(over[0], first - around), min(over[1], last + around))
    return Chart(
        f"flight-{number + 1}", unit, time_s, lines, over, view, report.spans_of(~flight.used, whole)
    )


def _hatched(flight: PreparedFlight) -> str:
    return "" if flight.used.all() else " Hatched: left out of the estimate."


#: So many names of logs are in a title; provenance has all of them as they are.
NAMED = 3
#: Headings of the document in fewer words, for the list of what is on the page.
SHORT = {
    "": "Numbers",
    "Predicted ahead, from many starts of this flight": "Predicted ahead",
    "What belongs to each flight of the pool": "By flight",
    "Noticed in the log": "Noticed",
    "Noticed in the logs": "Noticed",
    "Figure": "Pictures",
}
TITLES = ("log", "format", "span [s]", "used [s]", "runs", "samples", "rate [Hz]")


def flight_page(result: FlightEstimate | LogEstimate) -> str:
    """HTML page of a result, without anything to fetch."""
    whole = LogEstimate({result.motion.name: result}) if isinstance(result, FlightEstimate) else result
    results, first = tuple(whole.motions.values()), whole.first
    documents, card = report.log_documents(whole, card=True), report.result_card(results)
    over_time = [list(_flights_over_time(item)) for item in results]
    pictures = (picture.drawn for groups in over_time for _, group in groups for picture in group)
    charts = [drawn for drawn in pictures if isinstance(drawn, Chart)]
    figures = Figures(sum(len(chart.lines) for chart in charts))
    motions = [
        _motion(item, document, figures, pictures, alone=len(results) == 1)
        for item, document, pictures in zip(results, documents[-len(results) :], over_time, strict=True)
    ]
    provenance, options = _provenance(fit_document(first))
    logs = [flight.recording.name for flight in first.prepared]
    title = ", ".join(logs[:NAMED])
    title = doc.shortened(title if len(logs) <= NAMED else f"{len(logs)} flights: {title}, …", 120)
    body = rendered(
        "flight.html",
        title=title,
        about=", ".join(item.motion.words.title for item in results),
        card=card,
        motions=motions,
        provenance=provenance,
        options=options,
        drawing=uplot(),
    )
    verdict = {
        "status": card.look.value,
        "card": plain(card),
        "logs": [printable(log) for log in logs],
        "readings": [
            _reading(entry) for entry in report.card_entries(results) if np.isfinite(entry.row.value)
        ],
    }
    tree = log_document(result) if isinstance(result, LogEstimate) else json_document(result)
    data = {"result": tree, "charts": figures.charts, "verdict": verdict}
    return whole_page(f"{title}: {card.title}", body, data)


def _motion(
    result: FlightEstimate,
    document: doc.Document,
    figures: Figures,
    over_time: Iterable[Pictures],
    *,
    alone: bool,
) -> tuple[str, list[tuple[str, str, doc.Section]], dict[str, Markup]]:
    """Heading of a motion where there are several, its sections with their names, and its pictures."""
    prediction = result.multi_step_prediction
    of_fit = () if result.fit is None else flight_figures.fit_pictures(result, result.fit)
    whole = {row.name: row for row in report.reported_rows(result)}
    groups: dict[str, list[Pictures]] = {
        "ahead": [("", () if prediction is None else _prediction_pictures(prediction))],
        "flights": [("", _forests(result, result.flights, whole))],
        "methods": [("", _forests(result, result.comparisons, {}))],
        "flight": [*over_time, ("", of_fit), *response_pictures(result)],
    }
    prefix = "" if alone else f"{result.motion.name}-"
    sections = []
    for section in document.sections:
        words = SHORT.get(section.heading, section.heading)
        name = prefix + "-".join(re.findall(r"[^\W_]+", words.lower()))
        sections.append((name, words, _displayed(section, result)))
    drawn = {name: figures.html(group) for name, group in groups.items()}
    return "" if alone else result.motion.words.title, sections, drawn


def _reading(entry: report.CardEntry) -> dict[str, object]:
    """A quantity in its shown unit: as it is written, and as numbers to draw; null for no bound."""
    row = entry.row
    return {
        "name": f"{entry.result.motion.name}.{row.name}",
        "words": entry.words,
        "symbol": row.wording.own_symbol,
        "unit": row.wording.shown_unit,
        "shown": list(row.texts),
        "status": row.quantity.verdict.value,
        "at": number(row.value),
        "interval": [number(end) for end in row.interval],
    }


def _displayed(section: doc.Section, result: FlightEstimate) -> doc.Section:
    if section.heading != "Figure":
        return section
    omitted = len(result.prepared) - MOST_FLIGHTS
    more = f"The first {MOST_FLIGHTS} flights are drawn over time; {omitted} more are in the tables."
    return doc.Section("Pictures", (*((doc.Bullets((more,)),) if omitted > 0 else ()), *section.parts))


def _provenance(tree: FitDocument) -> tuple[doc.Section, doc.Facts]:
    made = tree.provenance
    rows: list[tuple[str | doc.Cell, ...]] = []
    for log, source in zip(tree.logs, made.logs, strict=True):
        checksum = f"SHA-256 {source['sha256']}" if source["sha256"] else ""
        counts = (str(log.runs), str(log.samples), f"{log.rate_hz:g}")
        spans = (
            doc.NO_NUMBER if pair is None else f"{pair[0]:.2f} to {pair[1]:.2f}"
            for pair in (log.span, log.window)
        )
        rows.append((doc.Cell(log.name, checksum), log.format, *spans, *counts))
    columns = (doc.TableColumn(title, whole=title not in TITLES[:2]) for title in TITLES)
    facts = (("made by", f"Eivor {made.version}"), ("schema", tree.schema_))
    options = plain(made.options)
    given = ((name, _option(item)) for name, item in options.items() if item not in (None, "", [], {}))
    return doc.Section("Provenance", (doc.Facts(facts), doc.table(columns, rows))), doc.Facts(tuple(given))


def _option(value: object) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case list():
            return ", ".join(map(_option, value))
        case _:
            return str(value)
