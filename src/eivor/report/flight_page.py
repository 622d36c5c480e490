"""HTML page of a result, and its pictures."""

from __future__ import annotations

import base64
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import PlotData, Trace
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.regions import Ellipse
from eivor.inference.verdict import Status
from eivor.report.document import (
    Bullets,
    Cell,
    Document,
    Fact,
    Facts,
    Part,
    Section,
    TableColumn,
    TableOf,
    capitalised,
    printable,
)
from eivor.report.figure_panels import (
    BLUE,
    DARK,
    RED,
    PlottedInterval,
    draw_autocorrelation,
    draw_excitation,
    draw_forest,
    draw_profile,
    ellipse_figure,
    labelled,
    legend,
    page,
)
from eivor.report.figures import draw_by_horizon, write_figure
from eivor.report.flight import (
    NO_NUMBER,
    FlightReport,
    FlightRun,
    QuantityReport,
    ReportRow,
    axis_of,
    band_of,
    banded,
    document_of,
    flight_report,
    flight_runs,
    plain_numbers,
    profile_curves,
    residual_autocorrelation,
    spans_of,
    spectrum,
    within_band,
)
from eivor.report.html import rendered, uplot, whole_page
from eivor.report.json_document import json_of, number
from eivor.tools import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# -- Chart --

#: Code of a value that is not there, and the largest of one that is.
MISSING, LARGEST = 65535, 65534
#: Samples further apart than so many steps are not joined by a line.
BROKEN_AFTER = 1.5


@dataclass(frozen=True)
class Line:
    """One series."""

    label: str
    look: str
    values: Float[np.ndarray, " n"]  # Not a number where there is none


@dataclass(frozen=True)
class Chart:
    """Series over one time."""

    group: str
    unit: str
    time_s: Float[np.ndarray, " n"]
    lines: tuple[Line, ...]  # With values at these times
    over_s: tuple[float, float]
    view_s: tuple[float, float]
    omitted_s: tuple[tuple[float, float], ...]

    def packed(self, most: int) -> dict[str, object]:
        """Return it for the page's script, in about `most` samples."""
        values = np.stack([line.values for line in self.lines], axis=1)
        stretches, kept = _thinned(self.time_s, values, most)
        return {
            "group": self.group,
            "unit": printable(self.unit),
            "over": list(self.over_s),
            "view": list(self.view_s),
            "leftOut": [list(pair) for pair in self.omitted_s],
            "stretches": stretches,
            "lines": [
                {"label": printable(line.label), "look": line.look, **_coded(kept[:, index])}
                for index, line in enumerate(self.lines)
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


# -- Pictures --

#: Draws a picture that nobody needs to pan.
Draw: TypeAlias = "Callable[[Axes], None]"
#: Width of a drawing, its height, and what a row of a forest and its axis add to it [inch].
WIDTH_INCHES, HEIGHT_INCHES, FOREST_ROW_INCHES, FOREST_FOOT_INCHES = 3.5, 2.7, 0.4, 0.55
#: Samples of all lines of a page together; each chart has its share.
SAMPLES = 160_000
#: What a chart has in any case, and what no screen has any use for.
FEWEST, MOST = 1_000, 20_000
_SVG, _LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"


@dataclass(frozen=True, slots=True)
class Picture:
    """Series over time to zoom into, or a drawing."""

    title: str
    words: str
    drawn: Chart | Draw
    table: TableOf | None = None
    height: float = HEIGHT_INCHES


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures that belong together: those over time share their axis."""

    heading: str  # May be empty
    pictures: tuple[Picture, ...]


def forest_picture(
    title: str, axis: str, rows: Iterable[PlottedInterval], words: str = "", table: TableOf | None = None
) -> Picture:
    """Intervals below each other, with their numbers."""
    drawn = tuple(rows)
    height = FOREST_ROW_INCHES * len(drawn) + FOREST_FOOT_INCHES
    return Picture(title, words, partial(draw_forest, rows=drawn, words=axis), table, height)


def trend_picture(
    title: str,
    words: tuple[str, str],
    points: tuple[Float[np.ndarray, " n"], ...],
    lines: Iterable[tuple[str, Float[np.ndarray, " m"], Float[np.ndarray, " m"]]],
    table: TableOf,
) -> Picture:
    """Values with their intervals (abscissa, value, low, high), and lines through them by their labels."""
    drawn = tuple(lines)

    def draw(axes: Axes) -> None:
        x, value, low, high = points
        axes.vlines(x, low, high, color=DARK, lw=1.2)
        axes.plot(x, value, "o", color=DARK, ms=3.5, label="flights, 95 %")
        for (label, *line), colour, style in zip(drawn, (RED, BLUE), ("-", "--"), strict=False):
            axes.plot(*line, color=colour, lw=1.3, ls=style, label=label)
        labelled(axes, x=words[0], y=words[1], size=9.0)
        legend(axes, size=7)

    return Picture(title, "", draw, table)


@dataclass
class Figures:
    """Figures of one page: they are numbered, so that no two have one name, and share its room."""

    lines: int
    charts: dict[str, dict[str, object]] = field(default_factory=dict)
    count: int = 0

    def html(self, groups: Iterable[Pictures]) -> Markup:
        """Groups of pictures."""
        drawn = []
        for group in groups:
            entries = [self._entry(picture) for picture in group.pictures]
            charts = [entry for entry in entries if not entry[2]]
            drawn.append((group.heading, charts, [entry for entry in entries if entry[2]]))
        return rendered("figures.html", groups=drawn)

    def _entry(self, picture: Picture) -> tuple[str, Picture, Markup]:
        """Name of a picture, and its drawing; empty for a chart, whose data the page's script draws."""
        self.count += 1
        name = f"picture-{self.count}"
        if isinstance(picture.drawn, Chart):
            most = min(max(SAMPLES // max(self.lines, 1), FEWEST), MOST)
            self.charts[name] = {**picture.drawn.packed(most), "title": printable(picture.title)}
            return name, picture, Markup()
        return name, picture, drawing(picture.drawn, name, picture.title, picture.height)


def drawing(draw: Draw, name: str, title: str, height: float) -> Markup:
    """SVG with identifiers that begin with a name of its own, and attributes in place of styles."""
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
            axis.set_major_formatter(partial(_tick, getattr(axis.get_transform(), "linthresh", 0.0)))
    stream = BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "savefig.transparent": True}):
        write_figure(figure, stream, "svg")
    root = ElementTree.fromstring(stream.getvalue())  # noqa: S314 - Matplotlib wrote it
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in {f"{_SVG}metadata", f"{_SVG}style"}:
                parent.remove(child)
        parent.tag = parent.tag.removeprefix(_SVG)
        parent.attrib = _attributes(parent.attrib, name)
        texts = parent.text, parent.tail
        parent.text, parent.tail = (text if text and text.strip() else None for text in texts)
    heading = ElementTree.Element("title", {"id": f"{name}-title"})
    heading.text = printable(title)
    root.insert(0, heading)
    box = {"viewBox": root.get("viewBox", ""), "class": "drawn", "role": "img"}
    root.attrib = box | {"aria-labelledby": f"{name}-title", "stroke-linejoin": "round"}
    return Markup(ElementTree.tostring(root, encoding="unicode", method="html"))  # noqa: S704 - escaped


def _tick(bend: float, value: float, _position: int) -> str:
    """Number at a tick; none between zero and the bend of an axis, where they would touch."""
    return "" if 0.0 < value < bend else f"{value:g}"


def _attributes(given: dict[str, str], name: str) -> dict[str, str]:
    """Attributes of an element: in place of a style, which the page's policy forbids, and with own names."""
    made = {}
    for key, value in given.items():
        if key == "id":
            made[key] = f"{name}-{value}"
        elif key == "style":
            pairs = (item.partition(":") for item in value.split(";") if item.strip())
            made |= {word.strip(): setting.strip() for word, _, setting in pairs}
        elif key in {_LINK, "clip-path"}:
            made[key.rpartition("}")[2]] = value.replace("#", f"#{name}-")
        else:
            made[key] = re.sub(r"(\.\d\d)\d+", r"\1", value)
    made.pop("font-family", "")
    size = made.pop("font", "").partition("px")[0].rpartition(" ")[2]
    return made | ({"font-size": size} if size else {})


def lines_of(groups: Iterable[Pictures]) -> int:
    """Number of lines over time."""
    drawn = (picture.drawn for group in groups for picture in group.pictures)
    return sum(len(item.lines) for item in drawn if isinstance(item, Chart))


# -- Number tables --


def number_table(titles: Iterable[str], rows: Iterable[Iterable[float | str | Cell]]) -> TableOf:
    """Table of numbers, and of words where a row has them."""
    cells = tuple(tuple(map(_cell, row)) for row in rows)
    left = {index for row in cells for index, cell in enumerate(row) if cell.text[:1].isalpha()}
    columns = [(title, index not in left) for index, title in enumerate(titles)]
    return TableOf(tuple(TableColumn(title, right=right, whole=right) for title, right in columns), cells)


def _cell(item: float | str | Cell) -> Cell:
    if isinstance(item, Cell | str):
        return item if isinstance(item, Cell) else Cell(item)
    return Cell(f"{item:.4g}".replace("-", "−") if np.isfinite(item) else NO_NUMBER)


# -- Figures of a fit --

#: Rows of a table beside a spectrum, and bands of its drawing, in each decade.
ROWS_PER_DECADE, BANDS_PER_DECADE = 8, 90


def pictures_of_fit(result: FlightEstimate, fit: Fit) -> Pictures:
    """Pictures of an estimate that are not over time."""
    runs = flight_runs(result)
    pictures = (
        _autocorrelation(fit.estimate, runs),
        *_profiles(result, fit.estimate),
        *(_spectra(trace, runs) for trace in fit.traces(result.motion) if trace.driven.any()),
        *_sets(result, fit),
        *_ellipse(result, fit.estimate),
    )
    return Pictures("", pictures)


def _autocorrelation(estimate: Estimate, runs: list[FlightRun]) -> Picture:
    autocorrelation = residual_autocorrelation(estimate, runs)
    shift, correlation = autocorrelation.shift_s[1:], autocorrelation.correlation[1:]
    return Picture(
        f"Autocorrelation of the {autocorrelation.what}",
        "Of a residual that holds nothing more, one stem in twenty leaves the band.",
        partial(draw_autocorrelation, best=estimate, runs=runs),
        number_table(("shift [s]", "correlation"), zip(shift.tolist(), correlation.tolist(), strict=True)),
    )


def _profiles(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    for index, profile in enumerate(estimate.profiles):
        wording = result.motion.quantities[profile.nuisance.name]
        rows = [
            (curve.choice or "objective", value, excess)
            for curve in profile_curves(result, estimate, index)
            for value, excess in zip(
                (wording.scale * curve.values).tolist(), curve.excess.tolist(), strict=True
            )
        ]
        yield Picture(
            f"How well each {wording.words} fits",
            "Values whose curve stays below the dashed line fit the flight; equal steps below it, powers of "
            "ten above.",
            partial(draw_profile, result=result, estimate=estimate, number=index),
            number_table(("curve", axis_of(wording), "above the least"), rows),
        )


def _spectra(trace: Trace, runs: list[FlightRun]) -> Picture:
    frequency, driven = banded(*spectrum(trace.driven, runs), BANDS_PER_DECADE)
    _, left = banded(*spectrum(trace.measured - trace.predicted, runs), BANDS_PER_DECADE)
    steps = int(ROWS_PER_DECADE * np.log10(frequency[-1] / frequency[0])) + 2
    kept = np.searchsorted(frequency, np.geomspace(frequency[0], frequency[-1], steps))
    kept = np.unique(kept.clip(max=frequency.size - 1))
    columns = (frequency[kept].tolist(), driven[kept].tolist(), left[kept].tolist())
    return Picture(
        f"What excites the {trace.axis}",
        "Where the input stands above the residual, the flight carries some information.",
        partial(draw_excitation, traces=(trace,), runs=runs, per_decade=BANDS_PER_DECADE),
        number_table(("frequency [Hz]", f"input: {trace.drive}", "residual"), zip(*columns, strict=True)),
    )


def _sets(result: FlightEstimate, fit: Fit) -> Iterator[Picture]:
    for name, sets in fit.sets.items():
        wording, quantity = result.motion.quantities[name], result.quantities[name]
        rows = [_interval("reported", QuantityReport(name, wording, quantity))]
        value = quantity.value * wording.scale
        for label, item in (
            ("estimate plus and minus", sets.wald),
            ("profile", sets.profile),
            ("Anderson–Rubin", sets.anderson_rubin),
        ):
            pieces = tuple((low * wording.scale, high * wording.scale) for low, high in item.intervals)
            texts = " or ".join(_piece(*piece, value) for piece in pieces) or "no value"
            rows.append(PlottedInterval(label, np.nan, pieces, texts))
        yield forest_picture(
            f"Three 95 % sets of the {wording.words}",
            axis_of(wording),
            rows,
            "Nearly one where instruments are strong; where they are weak, the wider of the last two counts.",
            number_table(
                ("set", f"{wording.symbol} [{wording.shown_unit}]"),
                [(row.label, row.numbers) for row in rows],
            ),
        )


def _piece(low: float, high: float, value: float) -> str:
    plain_number = plain_numbers(value, (low, high))[1]
    if plain_number != NO_NUMBER:
        return plain_number
    if np.isfinite(low):
        return f"above {low:.3g}"
    return f"below {high:.3g}" if np.isfinite(high) else "any value"


def _ellipse(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    pair = _closest(result, estimate)
    if pair is None:
        return
    try:
        ellipse = estimate.ellipse(*pair)
    except UsageError:  # too few degrees of freedom for a region of two
        return
    words = [result.motion.quantities[name] for name in pair]
    scales = np.array([word.scale for word in words])
    covariance = ellipse.covariance * np.outer(scales, scales)
    scaled = replace(ellipse, centre=ellipse.centre * scales, covariance=covariance)
    if not np.isfinite(scaled.outline()).all():
        return
    named = zip(pair, words, strict=True)
    quantities = [QuantityReport(name, word, result.quantities[name]) for name, word in named]
    first, other = (word.words for word in words)
    yield Picture(
        f"{capitalised(first)} and {other} together",
        f"The two parameters that trade off most: their errors correlate by {ellipse.correlation:+.2f}.",
        partial(_draw_ellipse, ellipse=scaled, quantities=quantities),
        number_table(
            ("quantity", "value", "95 % interval", "unit"),
            [(item.wording.words, *item.numbers_text, item.wording.shown_unit) for item in quantities],
        ),
    )


def _draw_ellipse(axes: Axes, ellipse: Ellipse, quantities: list[QuantityReport]) -> None:
    names = [item.name for item in quantities]
    intervals = [item.scaled_interval for item in quantities]
    ellipse_figure(
        {"joint 95 % ellipse": ellipse},
        names=(names[0], names[1]),
        intervals=(intervals[0], intervals[1]) if np.isfinite(intervals).all() else None,
        ax=axes,
    )
    axes.set_xlabel(axis_of(quantities[0].wording), parse_math=False)
    axes.set_ylabel(axis_of(quantities[1].wording), parse_math=False)


def _closest(result: FlightEstimate, estimate: Estimate) -> tuple[str, str] | None:
    covariance, names = estimate.covariance, list(estimate.names)
    spread = np.sqrt(np.diag(covariance))
    known = [
        name
        for name in result.motion.quantities
        if name in names and np.isfinite(spread[names.index(name)]) and spread[names.index(name)] > 0.0
    ]

    def size(pair: tuple[str, str]) -> float:
        item, other = (names.index(name) for name in pair)
        return abs(float(covariance[item, other])) / float(spread[item] * spread[other])

    return max(combinations(known, 2), key=size, default=None)


# -- Figures of rows --


def forests(record: FlightReport, rows: tuple[ReportRow, ...], whole: str) -> Pictures:
    """Forest of each quantity that the rows have; below them the result itself, named `whole`, if any."""
    pictures = []
    for item in record.reported:
        if item.name not in record.result.motion.quantities.rows:
            continue
        estimates = ((row.label, each) for row in rows for each in row.quantities if each.name == item.name)
        drawn = [_interval(label, each) for label, each in estimates]
        if whole:
            drawn.append(replace(_interval(whole, item), whole=True))
        pictures.append(forest_picture(capitalised(item.wording.words), axis_of(item.wording), drawn))
    return Pictures("", tuple(pictures))


def _interval(label: str, record: QuantityReport) -> PlottedInterval:
    low, high = record.scaled_interval
    value = record.quantity.value * record.wording.scale
    known = math.isfinite(value) and not (math.isnan(low) or math.isnan(high))
    texts = " ".join(dict.fromkeys(record.numbers_text))
    return PlottedInterval(label, value, ((low, high),) if known else (), texts, record.quantity.verdict)


def prediction_pictures(prediction: MultiStepPrediction) -> Pictures:
    """Errors by horizon, of every quantity."""
    pictures = []
    for models in prediction.by_quantity:
        draw = partial(draw_by_horizon, prediction=prediction, models=models, key=True)
        pictures.append(Picture(f"Error of {models[0].quantity} by horizon", "", draw))
    return Pictures("", tuple(pictures))


# -- Over time --

#: Flights of a pool that are drawn over time; the others are in its tables.
MOST_FLIGHTS = 8
#: Share of the time used that is shown on either side of it.
AROUND = 0.04


def flights_over_time(result: FlightEstimate) -> Iterator[Pictures]:
    """Pictures of each flight, those that share an axis of time together."""
    several = len(result.prepared) > 1
    traces = () if result.fit is None else result.fit.traces(result.motion)
    runs = [] if result.fit is None else flight_runs(result)
    for index, flight in enumerate(result.prepared[:MOST_FLIGHTS]):
        runs_kept = [run for run in runs if run.flight == index]
        pictures = (*_fitted(index, flight, traces, runs_kept), *_airborne_pictures(index, flight, result))
        yield Pictures(flight.recording.name if several else "", pictures)


def _fitted(
    number: int, flight: PreparedFlight, traces: tuple[Trace, ...], runs: list[FlightRun]
) -> Iterator[Picture]:
    if not runs:
        return
    time = np.concatenate([run.time_s for run in runs])
    for trace in traces:
        bands = [within_band(trace, run) for run in runs]
        low, high = band_of(trace, runs[0])
        both = np.concatenate(bands)
        table = _by_run(runs, bands, trace.unit)
        measured = Line("measured", "measured", both[:, 0])
        predicted = Line(f"predicted: {trace.model}", "predicted", both[:, 1])
        left = Line("measured − predicted", "residual", both[:, 0] - both[:, 1])
        for what, words, lines in (
            (
                "measured and predicted",
                f"Both are band-passed {low:.2f} to {high:.0f} Hz.{_hatched(flight)}",
                (measured, predicted),
            ),
            ("what the model leaves", "Nothing of the vehicle's movement should be seen in it.", (left,)),
        ):
            title = f"{capitalised(trace.axis)}, {what} [{trace.unit}]"
            yield Picture(title, words, _chart(number, flight, trace.unit, time, lines), table)


def _by_run(runs: list[FlightRun], bands: list[Float[np.ndarray, "length 2"]], unit: str) -> TableOf:
    of_rms = (f"RMS {what} [{unit}]" for what in ("measured", "predicted", "left"))
    rows: list[tuple[float | str, ...]] = []
    for run, band in zip(runs, bands, strict=True):
        times = (f"{run.time_s[0]:.2f}", f"{run.time_s[-1]:.2f}", f"{run.time_s.size}")
        rows.append((*times, _rms(band[:, 0]), _rms(band[:, 1]), _rms(band[:, 0] - band[:, 1])))
    return number_table(("from [s]", "to [s]", "samples", *of_rms), rows)


def _airborne_pictures(number: int, flight: PreparedFlight, result: FlightEstimate) -> Iterator[Picture]:
    where = result.motion.words.where
    active = flight.active
    known = f"{capitalised(where)} by {active.rule}." if active.mask.any() else f"Never {where}."
    level = flight.signals.family(flight.input.name).mean(axis=1)
    mean = "" if flight.actuators == 1 else f", mean of {flight.actuators} actuators"
    panels = (*result.motion.view(flight).panels, PlotData(f"input: {flight.input.name}{mean}", level))
    for panel in panels:
        name, _, unit = " ".join(panel.label.split()).partition(" [")
        lines = [Line("measured" if unit else "logged", "measured", panel.values)]
        if panel.reference is not None:
            lines.append(Line("asked for", "predicted", panel.reference))
        title = f"{capitalised(name)} [{unit}" if unit else capitalised(name)
        table = number_table(
            ("series", "least", "mean", "greatest", "standard deviation"),
            [(line.label, *_spread(line.values)) for line in lines],
        )
        chart = _chart(number, flight, unit.removesuffix("]"), flight.grid.time_s, tuple(lines))
        yield Picture(title, f"{known}{_hatched(flight)}", chart, table)


def _chart(
    number: int, flight: PreparedFlight, unit: str, time_s: Float[np.ndarray, " n"], lines: tuple[Line, ...]
) -> Chart:
    whole = flight.grid.time_s
    over = (float(whole[0]), float(whole[-1]))
    view = over
    if flight.runs:
        first, last = flight.span_s
        around = AROUND * (last - first)
        view = (max(over[0], first - around), min(over[1], last + around))
    return Chart(f"flight-{number + 1}", unit, time_s, lines, over, view, spans_of(~flight.used, whole))


def _spread(values: Float[np.ndarray, " n"]) -> tuple[float, ...]:
    there = values[np.isfinite(values)]
    measures = (np.min, np.mean, np.max, np.std)
    return tuple(float(measure(there)) if there.size else np.nan for measure in measures)


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _hatched(flight: PreparedFlight) -> str:
    return "" if flight.used.all() else " Hatched: left out of the estimate."


# -- Verdict data --


def verdict_details(record: FlightReport) -> tuple[str, ...]:
    """What is said below the verdict: what is identified and what is not, or the first reason against it."""
    if record.summary:
        return (record.summary,)
    if record.verdict.status is Status.IDENTIFIED or not record.reasons:
        return ()
    return (record.reasons[0].sentence,)


def verdict_data(document: Document, record: FlightReport) -> dict[str, object]:
    """The verdict, what is said of it, and the quantities that it is about."""
    return {
        "status": record.verdict.status.value,
        "about": printable(document.about),
        "more": [printable(verdict_detail) for verdict_detail in verdict_details(record)],
        "logs": [printable(log) for log in record.logs],
        "readings": [_reading_json(item) for item in record.brief],
    }


def _reading_json(record: QuantityReport) -> dict[str, object]:
    """A quantity in its shown unit: as it is written, and as numbers to draw; null for no bound."""
    wording, quantity = record.wording, record.quantity
    return {
        "name": record.name,
        "words": wording.words,
        "symbol": wording.symbol,
        "unit": wording.shown_unit,
        "shown": list(record.numbers_text),
        "status": quantity.verdict.value,
        "at": number(quantity.value * wording.scale),
        "interval": [number(end) for end in record.scaled_interval],
    }


# -- Flight page --

#: Titles are cut to so many letters; provenance has the names as they are.
LONGEST_TITLE = 120
#: So many names of logs are in a title.
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


def flight_page(result: FlightEstimate) -> str:
    """HTML page of a result, without anything to fetch."""
    flight = flight_report(result)
    document, written = document_of(flight, card=True), json_of(flight)
    over_time = list(flights_over_time(result))
    figures = Figures(lines_of(over_time))
    groups = {
        "ahead": [prediction_pictures(multi_step)] if (multi_step := result.multi_step_prediction) else [],
        "flights": [forests(flight, flight.flights, "all together")] if flight.flights else [],
        "methods": [forests(flight, flight.comparisons, "")] if flight.comparisons else [],
        "flight": [*over_time, *([] if result.fit is None else [pictures_of_fit(result, result.fit)])],
    }
    provenance, options = _provenance(written)
    sections = [
        (_displayed(section, result), SHORT.get(section.heading, section.heading))
        for section in document.sections
    ]
    title = _title(flight)
    body = rendered(
        "flight.html",
        title=title,
        about=result.motion.words.title,
        meaning=document.about,
        report=flight,
        details=verdict_details(flight),
        sections=[
            ("-".join(re.findall(r"[^\W_]+", words.lower())), words, section)
            for section, words in (*sections, (provenance, provenance.heading))
        ],
        provenance=provenance,
        options=options,
        drawing=uplot(),
        figures={name: figures.html(group) for name, group in groups.items()},
    )
    data = {"result": written, "charts": figures.charts, "verdict": verdict_data(document, flight)}
    return whole_page(f"{title}: {flight.verdict.status.value}", body, data)


def _title(record: FlightReport) -> str:
    names = ", ".join(record.logs[:NAMED])
    if len(record.logs) > NAMED:
        names = f"{len(record.logs)} flights: {names}, …"
    return names if len(names) <= LONGEST_TITLE else f"{names[: LONGEST_TITLE - 1]}…"


def _displayed(section: Section, result: FlightEstimate) -> Section:
    """Section as a page has it: without what the verdict above has said, and what is not drawn."""
    if not section.heading:
        return replace(section, parts=tuple(_without_summary(part) for part in section.parts))
    if section.heading != "Figure":
        return section
    omitted = len(result.prepared) - MOST_FLIGHTS
    more = f"The first {MOST_FLIGHTS} flights are drawn over time; {omitted} more are in the tables."
    return Section("Pictures", (*((Bullets((more,)),) if omitted > 0 else ()), *section.parts))


def _without_summary(part: Part) -> Part:
    if not isinstance(part, Facts):
        return part
    return Facts(tuple(fact for fact in part.facts if fact.label != "summary"))


def _provenance(written: Mapping[str, Any]) -> tuple[Section, Facts]:
    made = written["provenance"]
    rows = []
    for log, source in zip(written["logs"], made["logs"], strict=True):
        checksum = f"SHA-256 {source['sha256']}" if source["sha256"] else ""
        counts = (str(log["runs"]), str(log["samples"]), f"{log['rate_hz']:g}")
        texts = (log["format"], _span(log["span"]), _span(log["window"]), *counts)
        rows.append((Cell(log["name"], checksum), *map(Cell, texts)))
    columns = (*map(TableColumn, TITLES[:2]), *(TableColumn(title, whole=True) for title in TITLES[2:]))
    facts = (Fact("made by", f"Eivor {made['version']}"), Fact("schema", written["schema"]))
    given = {name: item for name, item in made["options"].items() if item not in (None, "", [], {})}
    options = (Fact(name, _option(item)) for name, item in given.items())
    return Section("Provenance", (Facts(facts), TableOf(columns, tuple(rows)))), Facts(tuple(options))


def _span(pair: list[float] | None) -> str:
    return NO_NUMBER if pair is None else f"{pair[0]:.2f} to {pair[1]:.2f}"


def _option(value: object) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case list() | tuple():
            return ", ".join(map(_option, value))
        case _:
            return str(value)
