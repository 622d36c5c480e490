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

#: Code of a missing value, and the largest code of a finite one.
MISSING, LARGEST = 65535, 65534
#: Samples further apart than so many steps are not joined by a line.
BROKEN_AFTER = 1.5


def pack(chart: Chart, limit: int) -> dict[str, object]:
    """A chart for the page's script, in about `most` samples."""
    samples = np.stack([line.values for line in chart.lines], axis=1)
    stretches, values = _thin(chart.time_s, samples, limit)
    return {
        "group": chart.group,
        "unit": printable(chart.unit),
        "hertz": chart.over_frequency,
        "over": list(chart.over_s),
        "view": list(chart.view_s),
        "leftOut": [list(interval) for interval in chart.omitted_s],
        "stretches": stretches,
        "lines": [
            {"label": printable(line.label), "look": line.look, **_encode(values[:, index])}
            for index, line in enumerate(chart.lines)
        ],
    }


def _thin(
    time_s: Float[np.ndarray, " n"], values: Float[np.ndarray, "n lines"], limit: int
) -> tuple[list[list[float]], Float[np.ndarray, "kept lines"]]:
    """Start, step and count of each stretch without gaps, and its values, or least and greatest of blocks."""
    if time_s.size < 2:
        return [[float(item), 0.0, 1] for item in time_s], values
    steps = np.diff(time_s)
    step = float(np.median(steps))
    edges = [0, *(np.flatnonzero(steps > BROKEN_AFTER * step) + 1).tolist(), time_s.size]
    size = max(1, -(-2 * time_s.size // limit)) if time_s.size > limit else 1
    stretches, parts = [], []
    for first, end in pairwise(edges):
        part = values[first:end] if size == 1 else _ranges(values[first:end], size)
        stretches.append([float(time_s[first]), step * max(size / 2.0, 1.0), len(part)])
        parts.append(part)
    return stretches, np.concatenate(parts)


def _ranges(values: Float[np.ndarray, "n lines"], size: int) -> Float[np.ndarray, "kept lines"]:
    """Least and greatest of each block of `size` values, in their order in time."""
    short = -len(values) % size
    padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
    blocks = padded.reshape(-1, size, values.shape[1])
    low = np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    extremes = np.take_along_axis(blocks, np.sort(np.stack([low, high], axis=1), axis=1), axis=1)
    return extremes.reshape(-1, values.shape[1])


def _encode(values: Float[np.ndarray, " n"]) -> dict[str, object]:
    """Values as integers of two bytes in base64, with offset and step."""
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    step = (high - low) / LARGEST
    codes = np.full(values.size, MISSING, dtype="<u2")
    codes[finite] = np.rint((values[finite] - low) / step) if step > 0.0 else 0
    return {"low": low, "step": step, "codes": base64.b64encode(codes.tobytes()).decode("ascii")}


WIDTH_INCHES = 3.5
#: Samples of all lines of a page together; each chart has its share.
SAMPLES = 160_000
#: Fewest and most samples of a chart.
FEWEST, MOST = 1_000, 20_000


@dataclass
class Figures:
    """Figures of one page, numbered; their charts share a budget of samples."""

    lines: int
    charts: dict[str, dict[str, object]] = field(default_factory=dict)
    count: int = 0

    def html(self, groups: Iterable[Pictures]) -> Markup:
        """Groups of pictures, but those without one."""
        nonempty = []
        for heading, pictures in groups:
            entries = [self._entry(picture) for picture in pictures]
            charts = [entry for entry in entries if isinstance(entry[1].drawn, Chart)]
            if entries:
                nonempty.append((heading, charts, [entry for entry in entries if entry not in charts]))
        return rendered("figures.html", groups=nonempty)

    def _entry(self, picture: Picture) -> tuple[str, Picture, str]:
        """Name of a picture, and its drawing: none for a chart, whose data the page's script draws."""
        self.count += 1
        name = f"picture-{self.count}"
        if isinstance(picture.drawn, Chart):
            limit = min(max(SAMPLES // max(self.lines, 1), FEWEST), MOST)
            self.charts[name] = {**pack(picture.drawn, limit), "title": printable(picture.title)}
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


def _forest_pictures(
    result: FlightEstimate, rows: Sequence[FlightRow], pool: Mapping[str, doc.QuantityRow]
) -> Iterator[Picture]:
    """Forest plot of each quantity of a motion's `rows`, with the pooled interval below if there is one."""
    motion = result.motion
    by_label = [(row.label, {item.name: item for item in report.row_quantities(row, motion)}) for row in rows]
    for name in (name for name in motion.quantities if rows and name in motion.quantities.rows):
        forest = [flight_figures.quantity_interval(label, quantities[name]) for label, quantities in by_label]
        if name in pool:
            forest.append(replace(flight_figures.quantity_interval("all together", pool[name]), whole=True))
        wording = motion.quantities[name]
        yield forest_picture(capitalised(wording.words), doc.axis_of(wording), forest)


def _prediction_pictures(prediction: MultiStepPrediction) -> Iterator[Picture]:
    draw = partial(draw_by_horizon, prediction=prediction)
    for models in prediction.by_quantity:
        yield Picture(f"Error of {models[0].quantity} by horizon", "", partial(draw, models=models))


#: Flights of a pool that are drawn over time; the others are in its tables.
MOST_FLIGHTS = 8
#: Share of the time used that is shown on either side of it.
AROUND = 0.04


def _flights_over_time(result: FlightEstimate) -> Iterator[tuple[str, tuple[Picture, ...]]]:
    is_pool = len(result.prepared) > 1
    traces = () if result.fit is None else result.fit.traces(result.motion)
    runs = [] if result.fit is None else flight_figures.flight_runs(result)
    for index, flight in enumerate(result.prepared[:MOST_FLIGHTS]):
        runs_kept = [run for run in runs if run.flight == index]
        fit_pictures = _fit_pictures(index, flight, traces, runs_kept) if runs_kept else ()
        pictures = (*fit_pictures, *_signal_pictures(index, flight, result))
        yield flight.recording.name if is_pool else "", pictures


def _fit_pictures(
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
        rms_titles = (f"RMS {name} [{trace.unit}]" for name in ("measured", "predicted", "left"))
        table = doc.number_table(("from [s]", "to [s]", "samples", *rms_titles), rows)
        measured, predicted, residual = np.concatenate(parts).T
        low, high = flight_figures.band_of(trace, runs[0])
        caption = f"Both are band-passed {low:.2f} to {high:.0f} Hz.{_hatching_note(flight)}"
        model = Line(f"predicted: {trace.model}", "predicted", predicted)
        signals = (Line("measured", "measured", measured), model)
        residuals = (Line("measured − predicted", "residual", residual),)
        for name, words, lines in (
            ("measured and predicted", caption, signals),
            ("what the model leaves", "Nothing of the vehicle's movement should be seen in it.", residuals),
        ):
            title = f"{capitalised(trace.axis)}, {name} [{trace.unit}]"
            yield Picture(title, words, _chart(number, flight, trace.unit, time, lines), table)


def _signal_pictures(number: int, flight: PreparedFlight, result: FlightEstimate) -> Iterator[Picture]:
    where, active = result.motion.words.where, flight.active
    caption = f"{capitalised(where)} by {active.rule}." if active.mask.any() else f"Never {where}."
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
            finite = line.values[np.isfinite(line.values)]
            measures = (finite.min, finite.mean, finite.max, finite.std)
            rows.append((line.label, *(float(measure()) if finite.size else np.nan for measure in measures)))
        table = doc.number_table(("series", "least", "mean", "greatest", "standard deviation"), rows)
        chart = _chart(number, flight, unit.removesuffix("]"), flight.grid.time_s, tuple(lines))
        yield Picture(title, f"{caption}{_hatching_note(flight)}", chart, table)


def _chart(
    number: int, flight: PreparedFlight, unit: str, time_s: Float[np.ndarray, " n"], lines: tuple[Line, ...]
) -> Chart:
    grid_s = flight.grid.time_s
    full = view = (float(grid_s[0]), float(grid_s[-1]))
    if flight.runs:
        first, last = flight.span_s
        around = AROUND * (last - first)
        view = (max(full[0], first - around), min(full[1], last + around))
    return Chart(
        f"flight-{number + 1}", unit, time_s, lines, full, view, report.spans_of(~flight.used, grid_s)
    )


def _hatching_note(flight: PreparedFlight) -> str:
    return "" if flight.used.all() else " Hatched: left out of the estimate."


#: Names of logs in a title; provenance has all of them.
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
    estimate = LogEstimate({result.motion.name: result}) if isinstance(result, FlightEstimate) else result
    results, first = tuple(estimate.motions.values()), estimate.first
    documents, card = report.log_documents(estimate, card=True), report.result_card(results)
    over_time = [list(_flights_over_time(item)) for item in results]
    pictures = (picture.drawn for groups in over_time for _, group in groups for picture in group)
    charts = [drawn for drawn in pictures if isinstance(drawn, Chart)]
    figures = Figures(sum(len(chart.lines) for chart in charts))
    motions = [
        _motion(item, document, figures, pictures, is_only=len(results) == 1)
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
    is_only: bool,
) -> tuple[str, list[tuple[str, str, doc.Section]], dict[str, Markup]]:
    """Heading of a motion where there are several, its sections with their names, and its pictures."""
    prediction = result.multi_step_prediction
    of_fit = () if result.fit is None else flight_figures.fit_pictures(result, result.fit)
    pooled = {row.name: row for row in report.reported_rows(result)}
    groups: dict[str, list[Pictures]] = {
        "ahead": [("", () if prediction is None else _prediction_pictures(prediction))],
        "flights": [("", _forest_pictures(result, result.flights, pooled))],
        "methods": [("", _forest_pictures(result, result.comparisons, {}))],
        "flight": [*over_time, ("", of_fit), *response_pictures(result)],
    }
    prefix = "" if is_only else f"{result.motion.name}-"
    sections = []
    for section in document.sections:
        words = SHORT.get(section.heading, section.heading)
        name = prefix + "-".join(re.findall(r"[^\W_]+", words.lower()))
        sections.append((name, words, _shown_section(section, result)))
    pictures = {name: figures.html(group) for name, group in groups.items()}
    return "" if is_only else result.motion.words.title, sections, pictures


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


def _shown_section(section: doc.Section, result: FlightEstimate) -> doc.Section:
    if section.heading != "Figure":
        return section
    omitted = len(result.prepared) - MOST_FLIGHTS
    note = f"The first {MOST_FLIGHTS} flights are drawn over time; {omitted} more are in the tables."
    return doc.Section("Pictures", (*((doc.Bullets((note,)),) if omitted > 0 else ()), *section.parts))


def _provenance(tree: FitDocument) -> tuple[doc.Section, doc.Facts]:
    provenance = tree.provenance
    rows: list[tuple[str | doc.Cell, ...]] = []
    for log, source in zip(tree.logs, provenance.logs, strict=True):
        checksum = f"SHA-256 {source['sha256']}" if source["sha256"] else ""
        counts = (str(log.runs), str(log.samples), f"{log.rate_hz:g}")
        spans = (
            doc.NO_NUMBER if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"
            for interval in (log.span, log.window)
        )
        rows.append((doc.Cell(log.name, checksum), log.format, *spans, *counts))
    columns = (doc.TableColumn(title, whole=title not in TITLES[:2]) for title in TITLES)
    facts = (("made by", f"Eivor {provenance.version}"), ("schema", tree.schema_))
    options = plain(provenance.options)
    settings = ((name, _option(item)) for name, item in options.items() if item not in (None, "", [], {}))
    return doc.Section("Provenance", (doc.Facts(facts), doc.table(columns, rows))), doc.Facts(tuple(settings))


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
