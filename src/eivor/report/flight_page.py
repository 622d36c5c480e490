"""HTML page of a result, and its figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, cycle
from typing import Any

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.motion import MultiStepPrediction
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import PlotData, Trace, Wording
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.distributions import chi_square_quantile
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
    printable,
)
from eivor.report.flight import (
    LEAST_AMPLITUDE,
    FlightReport,
    FlightRun,
    QuantityReport,
    ReportRow,
    band_of,
    display_unit,
    document_of,
    flight_report,
    flight_runs,
    profile_curves,
    residual_autocorrelation,
    spectrum,
    within_band,
)
from eivor.report.html import (
    Markup,
    badge,
    element,
    joined,
    part_html,
    section_html,
    shape,
    table_html,
    uplot,
    whole_page,
)
from eivor.report.json_document import json_of
from eivor.report.svg import (
    Band,
    Chart,
    Curve,
    Dots,
    Forest,
    ForestRow,
    Line,
    Linear,
    LinearBelow,
    Logarithmic,
    Mark,
    Picture,
    Pictures,
    Plot,
    Rule,
    Stems,
    margined,
    stretches_of,
)
from eivor.report.wording import NO_NUMBER, numbers, plain_numbers
from eivor.tools import Float

# -- Figures --

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
        """Groups of pictures."""
        return joined(piece for group in groups for piece in self._group(group))

    def _group(self, group: Pictures) -> Iterator[Markup]:
        if group.heading:
            yield element("h3", {"class": "flight"}, group.heading)
        over_time = [picture for picture in group.pictures if isinstance(picture.drawn, Chart)]
        others = [picture for picture in group.pictures if not isinstance(picture.drawn, Chart)]
        if over_time:
            made = [self._figure(item) for item in over_time]
            name = over_time[0].drawn.group if isinstance(over_time[0].drawn, Chart) else ""
            yield element("div", {"class": "charts", "data-group": name}, _tools(), *made)
        if others:
            yield element("div", {"class": "plots"}, *(self._figure(item) for item in others))

    def _figure(self, picture: Picture) -> Markup:
        self.count += 1
        name = f"picture-{self.count}"
        heading = element("h4", {"id": f"{name}-heading"}, picture.title)
        words = [element("p", {"class": "words"}, picture.words)] if picture.words else []
        table = []
        if picture.table is not None:
            numbers = table_html(picture.table, f"Numbers of: {picture.title}")
            summary = element(
                "summary", None, "Numbers", element("span", {"class": "unseen"}, f" of: {picture.title}")
            )
            table = [element("details", None, summary, numbers)]
        drawn = picture.drawn
        if isinstance(drawn, Chart):
            most = min(max(SAMPLES // max(self.lines, 1), FEWEST), MOST)
            self.charts[name] = {**drawn.packed(most), "title": printable(picture.title)}
            keys = "Arrow keys move, plus and minus zoom, zero shows the whole flight."
            box = {"class": "chart", "id": name, "tabindex": "0", "role": "group"}
            pieces = [element("div", {**box, "aria-label": f"{picture.title}. {keys}"})]
            legend = _lines_legend(drawn)
        else:
            pieces = [drawn.drawn(name, picture.title)]
            legend = _marks_legend(drawn.marks) if isinstance(drawn, Plot) else joined(())
        return element(
            "figure", {"aria-labelledby": f"{name}-heading"}, heading, *pieces, legend, *words, *table
        )


def lines_of(groups: Iterable[Pictures]) -> int:
    """Number of lines over time."""
    drawn = (picture.drawn for group in groups for picture in group.pictures)
    return sum(len(item.lines) for item in drawn if isinstance(item, Chart))


def _tools() -> Markup:
    """What zooms with a pointer or a finger; keys do the same."""
    buttons = [
        element("button", {"type": "button", "data-zoom": action, "aria-label": words, "title": words}, sign)
        for action, words, sign in (
            ("in", "Zoom in", "+"),
            ("out", "Zoom out", "−"),
            ("left", "Move to the left", "←"),
            ("right", "Move to the right", "→"),
            ("whole", "Show the whole flight", "whole flight"),
            ("used", "Show what is used", "what is used"),
        )
    ]
    displayed = element("output", {"class": "shown"})
    how = element("p", {"class": "how"}, "Draw over a chart to zoom into it; all charts follow.")
    return element("div", {"class": "tools"}, *buttons, displayed, how)


def _lines_legend(chart: Chart) -> Markup:
    """Samples of the lines with their words, and room for the value under the cursor."""
    entries = [
        element(
            "li",
            None,
            _sample("curve", line.look),
            element("span", None, line.label),
            element("output", {"class": "at-cursor"}),
        )
        for line in chart.lines
    ]
    if chart.omitted_s:
        entries.append(element("li", None, _sample("band", "hatched"), "left out"))
    return element("ul", {"class": "legend"}, *entries)


def _marks_legend(marks: tuple[Mark, ...]) -> Markup:
    entries = []
    for mark in marks:
        if not mark.label:
            continue
        kind = {Band: "band", Rule: "rule", Curve: "curve", Dots: "dot"}.get(type(mark), "stem")
        entries.append(element("li", None, _sample(kind, mark.look), element("span", None, mark.label)))
    return element("ul", {"class": "legend"}, *entries)


def _sample(kind: str, look: str) -> Markup:
    """A piece of what is drawn."""
    box = {"viewBox": "0 0 28 12", "class": "sample", "aria-hidden": "true"}
    if look == "hatched":
        lines = [_path_line(f"M{x} 12L{x + 12} 0", "hatch") for x in range(-6, 28, 6)]
        return element("svg", box, *lines)
    shapes = {
        "band": element("rect", {"x": "1", "y": "1", "width": "26", "height": "10", "class": f"band {look}"}),
        "dot": element("circle", {"cx": "14", "cy": "6", "r": "3", "class": f"dot {look}"}),
    }
    return element("svg", box, shapes.get(kind, _path_line("M0 6H28", f"{kind} {look}")))


def _path_line(path: str, look: str) -> Markup:
    return element("path", {"d": path, "class": look})


# -- Number tables --


def number_table(titles: Iterable[str], rows: Iterable[Iterable[float | str | Cell]]) -> TableOf:
    """Table of numbers, and of words where a row has them."""
    reported = tuple(
        tuple(item if isinstance(item, Cell) else Cell(_report(item)) for item in row) for row in rows
    )
    left = {
        index for row in reported for index, cell in enumerate(row) if cell.text and cell.text[0].isalpha()
    }
    columns = (
        TableColumn(title, right=index not in left, whole=index not in left)
        for index, title in enumerate(titles)
    )
    return TableOf(tuple(columns), reported)


def _report(coupled_axis: float | str) -> str:
    if isinstance(coupled_axis, str):
        return coupled_axis
    return f"{coupled_axis:.4g}".replace("-", "−") if np.isfinite(coupled_axis) else NO_NUMBER


# -- Figures of a fit --

#: A grid of positive values whose ends have this ratio or a larger one has a logarithmic axis.
WIDE_RATIO = 10.0
#: Looks of several curves in one drawing.
CURVE_LOOKS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
#: Rows of a table beside a spectrum: so many for each decade.
ROWS_PER_DECADE = 8
#: Bands of a spectrum in each decade.
BANDS_PER_DECADE = 90


def pictures_of_fit(result: FlightEstimate, fit: Fit) -> Pictures:
    """Pictures of an estimate that are not over time."""
    runs = flight_runs(result)
    traces = fit.traces(result.motion)
    return Pictures(
        "",
        (
            _autocorrelation(fit.estimate, runs),
            *_profiles(result, fit.estimate),
            *(_spectra(trace, runs) for trace in traces if trace.driven.any()),
            *_sets(result, fit),
            *_ellipse(result, fit.estimate),
        ),
    )


def _autocorrelation(estimate: Estimate, runs: list[FlightRun]) -> Picture:
    autocorrelation = residual_autocorrelation(estimate.best, runs)
    shift, correlation = autocorrelation.shift_s[1:], autocorrelation.correlation[1:]
    limit = max(0.3, 1.15 * float(np.max(np.abs(correlation), initial=0.0)))
    marks = (
        Band("95 % band of white noise", "shade", -autocorrelation.band, autocorrelation.band, upright=False),
        Rule("", "zero", 0.0, upright=False),
        Stems("correlation", "residual", shift, correlation),
    )
    return Picture(
        f"Autocorrelation of the {autocorrelation.what}",
        "Of a residual that holds nothing more, one stem in twenty leaves the band.",
        Plot(Linear("shift [s]", 0.0, 1.04 * float(shift[-1])), Linear("correlation", -limit, limit), marks),
        number_table(("shift [s]", "correlation"), zip(shift.tolist(), correlation.tolist(), strict=True)),
    )


def _profiles(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    for number, profile in enumerate(estimate.best.profiles):
        name = profile.nuisance.name
        wording, quantity = result.motion.wording[name], result.quantities[name]
        scale, quantile = wording.scale, chi_square_quantile(0.95)
        curves = profile_curves(result, estimate, number)
        x = _abscissa(_axis_words(wording), profile.grid * scale)
        # an interval may have no end, and a logarithm has no zero
        low, high = (float(np.clip(scale * end, x.low, x.high)) for end in quantity.interval)
        tallest = max([5.0 * quantile, *(float(item.excess.max()) for item in curves)])
        marks: list[Mark] = [
            Band("95 % interval", "shade", low, high, upright=True),
            Rule("least that 95 % leave out, by curves", "limit", quantile, upright=False),
            Rule("estimate", "value", scale * quantity.value, upright=True),
        ]
        rows = []
        for curve, look in zip(curves, cycle(CURVE_LOOKS), strict=False):
            label = curve.choice or "objective"
            marks.append(Curve(label, look, curve.values * scale, curve.excess))
            rows += [
                (label, item, excess)
                for item, excess in zip((scale * curve.values).tolist(), curve.excess.tolist(), strict=True)
            ]
        y = LinearBelow("objective above its least (χ² units)", quantile, 1.5 * tallest)
        yield Picture(
            f"How well each {wording.words} fits",
            "Values whose curve stays below the dashed line fit the flight; equal steps below it, powers of "
            "ten above.",
            Plot(x, y, tuple(marks)),
            number_table(("curve", x.words, "above the least"), rows),
        )


def _abscissa(words: str, grid: Float[np.ndarray, " values"]) -> Linear | Logarithmic:
    low, high = float(grid[0]), float(grid[-1])
    if low <= 0.0 or high < WIDE_RATIO * low:
        return margined(words, grid, 0.03)
    return Logarithmic(words, 0.9 * low, 1.1 * high)


def _spectra(trace: Trace, runs: list[FlightRun]) -> Picture:
    frequency, driven = _banded(*spectrum(trace.driven, runs))
    _, left = _banded(*spectrum(trace.measured - trace.predicted, runs))
    low, high = runs[0].spectral.band_hz
    top = float(max(driven.max(), left.max()))
    least = max(float(min(driven.min(), left.min())), LEAST_AMPLITUDE * top)
    x = Logarithmic("frequency [Hz]", float(frequency[0]), float(frequency[-1]))
    y = Logarithmic(f"amplitude [{trace.unit} per √Hz]", 0.8 * least, 1.3 * top)
    marks = (
        Band("band used", "shade", max(low, x.low), min(high, x.high), upright=True),
        Curve("residual", "residual", frequency, left),
        Curve(f"input: {trace.drive}", "predicted", frequency, driven),
    )
    decades = np.log10(frequency[-1] / frequency[0])
    kept = np.unique(
        np.searchsorted(
            frequency, np.geomspace(frequency[0], frequency[-1], int(ROWS_PER_DECADE * decades) + 2)
        )
    ).clip(max=frequency.size - 1)
    columns = (frequency[kept].tolist(), driven[kept].tolist(), left[kept].tolist())
    return Picture(
        f"What excites the {trace.axis}",
        "Where the input stands above the residual, the flight carries some information.",
        Plot(x, y, marks),
        number_table((x.words, f"input: {trace.drive}", "residual"), zip(*columns, strict=True)),
    )


def _banded(
    frequency: Float[np.ndarray, " bins"], amplitude: Float[np.ndarray, " bins"]
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Root mean square amplitude of narrow bands: bins stand closer than a drawing shows."""
    _, position = np.unique(
        np.floor(BANDS_PER_DECADE * np.log10(frequency / frequency[0])), return_inverse=True
    )
    count = np.bincount(position)
    return np.bincount(position, frequency) / count, np.sqrt(np.bincount(position, amplitude**2) / count)


def _sets(result: FlightEstimate, fit: Fit) -> Iterator[Picture]:
    """Sets of the headline beside the interval that is identified."""
    for name, sets in fit.sets.items():
        wording, quantity = result.motion.wording[name], result.quantities[name]
        value = quantity.value * wording.scale
        reported = numbers(quantity, wording)
        interval = (quantity.interval[0] * wording.scale, quantity.interval[1] * wording.scale)
        rows = [ForestRow("reported", " ".join(reported), value, (interval,), quantity.verdict)]
        for label, item in (
            ("estimate plus and minus", sets.wald),
            ("profile", sets.profile),
            ("Anderson–Rubin", sets.anderson_rubin),
        ):
            pieces = tuple((low * wording.scale, high * wording.scale) for low, high in item.intervals)
            rows.append(ForestRow(label, _pieces(item, value, wording), np.nan, pieces))
        table = number_table(
            ("set", f"{wording.symbol} [{wording.shown_unit}]"), [(row.label, row.numbers) for row in rows]
        )
        yield Picture(
            f"Three 95 % sets of the {wording.words}",
            "Nearly one where instruments are strong; where they are weak, the wider of the last two counts.",
            Forest(_axis_words(wording), tuple(rows)),
            table,
        )


def _pieces(confidence_set: ConfidenceSet, value: float, wording: Wording) -> str:
    """Pieces of a set in words."""
    if not confidence_set.intervals:
        return "no value"
    return " or ".join(
        _piece(low * wording.scale, high * wording.scale, value) for low, high in confidence_set.intervals
    )


def _piece(low: float, high: float, value: float) -> str:
    plain_number = plain_numbers(value, (low, high))[1]
    if plain_number != NO_NUMBER:
        return plain_number
    if np.isfinite(low):
        return f"above {low:.3g}"
    return f"below {high:.3g}" if np.isfinite(high) else "any value"


def _ellipse(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    """Joint region of the two parameters that trade off most."""
    pair = _closest(result, estimate)
    if pair is None:
        return
    try:
        ellipse = estimate.ellipse(*pair)
    except UsageError:  # too few degrees of freedom for a region of two
        return
    words = [result.motion.wording[name] for name in pair]
    scales = np.array([word.scale for word in words])
    outline, centre = ellipse.outline() * scales, ellipse.centre * scales
    if not np.isfinite(outline).all():
        return
    ends = [
        np.array(result.quantities[name].interval) * word.scale
        for name, word in zip(pair, words, strict=True)
    ]
    x, y = (
        margined(_axis_words(word), np.concatenate([outline[:, index], ends[index]]))
        for index, word in enumerate(words)
    )
    marks: list[Mark] = [
        Curve("joint 95 % ellipse", "first", *outline.T),
        *(
            Rule(label, "limit", float(end), upright=True)
            for label, end in zip(("intervals one by one", ""), ends[0], strict=True)
            if np.isfinite(end)
        ),
        *(Rule("", "limit", float(end), upright=False) for end in ends[1] if np.isfinite(end)),
        Dots("estimate", "first", centre[:1], centre[1:]),
    ]
    rows = [
        (word.words, *numbers(result.quantities[name], word), word.shown_unit)
        for name, word in zip(pair, words, strict=True)
    ]
    first, other = (word.words for word in words)
    yield Picture(
        f"{first[0].upper()}{first[1:]} and {other} together",
        f"The two parameters that trade off most: their errors correlate by {ellipse.correlation:+.2f}.",
        Plot(x, y, tuple(marks)),
        number_table(("quantity", "value", "95 % interval", "unit"), rows),
    )


def _closest(result: FlightEstimate, estimate: Estimate) -> tuple[str, str] | None:
    """The two of the reported parameters whose errors correlate most; None where there are no two."""
    covariance, names = estimate.covariance, list(estimate.names)
    spread = np.sqrt(np.diag(covariance))
    known = [
        name
        for name in result.motion.plotted
        if name in names and np.isfinite(spread[names.index(name)]) and spread[names.index(name)] > 0.0
    ]

    def size(pair: tuple[str, str]) -> float:
        item, other = (names.index(name) for name in pair)
        return abs(float(covariance[item, other])) / float(spread[item] * spread[other])

    return max(combinations(known, 2), key=size, default=None)


def _axis_words(wording: Wording) -> str:
    return f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"


# -- Figures of rows --

ROW_LOOKS = ("predicted", "second", "third", "fourth")


def forests(record: FlightReport, rows: tuple[ReportRow, ...], whole: str) -> Pictures:
    """Forest of each quantity that the rows have; below them the result itself, named `whole`, if any."""
    pictures = []
    for item in record.reported:
        if item.name not in record.rows:
            continue
        neighbours = [
            _row_of_forest(row.label, quantity)
            for row in rows
            for quantity in row.quantities
            if quantity.name == item.name
        ]
        if whole:
            neighbours.append(_row_of_forest(whole, item, whole=True))
        wording = item.wording
        axis = f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"
        title = f"{wording.words[0].upper()}{wording.words[1:]}"
        pictures.append(Picture(title, "", Forest(axis, tuple(neighbours)), None))
    return Pictures("", tuple(pictures))


def _row_of_forest(label: str, record: QuantityReport, *, whole: bool = False) -> ForestRow:
    quantity, scale = record.quantity, record.wording.scale
    low, high = (end * scale for end in quantity.interval)
    known = math.isfinite(quantity.value) and not (math.isnan(low) or math.isnan(high))
    pieces = ((low, high),) if known else ()
    numbers = " ".join(dict.fromkeys(record.numbers_text))
    return ForestRow(label, numbers, quantity.value * scale, pieces, quantity.verdict, whole)


def prediction_pictures(prediction: MultiStepPrediction) -> Pictures:
    """Errors by horizon, of every quantity."""
    return Pictures("", tuple(_by_horizon(prediction)))


def _by_horizon(prediction: MultiStepPrediction) -> Iterator[Picture]:
    horizons = np.array(prediction.horizons_s)
    for models in prediction.by_quantity:
        unit, times = display_unit(models[0].unit)
        quantity = models[0].quantity
        marks: list[Mark] = []
        every = [0.0]
        for model, look in zip(models, cycle(ROW_LOOKS), strict=False):
            errors = times * np.array(model.rms)
            marks += [Curve(model.words, look, horizons, errors), Dots("", look, horizons, errors)]
            every += errors.tolist()
        x = margined("predicted so far ahead [s]", horizons)
        y = Linear(f"RMS error [{unit}]", 0.0, 1.08 * max(every) or 1.0)
        title = f"Error of {quantity} by horizon"
        yield Picture(title, "", Plot(x, y, tuple(marks)), None)


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
    for number, flight in enumerate(result.prepared[:MOST_FLIGHTS]):
        runs_kept = [run for run in runs if run.flight == number]
        pictures = (*_fitted(number, flight, traces, runs_kept), *_simulated(number, flight, result))
        yield Pictures(flight.recording.name if several else "", pictures)


def _fitted(
    number: int, flight: PreparedFlight, traces: tuple[Trace, ...], runs: list[FlightRun]
) -> Iterator[Picture]:
    """Measured and predicted along each axis, and what is left."""
    if not runs:
        return
    time = np.concatenate([run.time_s for run in runs])
    for trace in traces:
        bands = [within_band(trace, run) for run in runs]
        low, high = band_of(trace, runs[0])
        both = np.concatenate(bands)
        table = _by_run(runs, bands, trace.unit)
        passed = f"Both are band-passed {low:.2f} to {high:.0f} Hz"
        lines = (
            Line("measured", "measured", both[:, 0]),
            Line(f"predicted: {trace.model}", "predicted", both[:, 1]),
        )
        yield Picture(
            f"{_started(trace.axis)}, measured and predicted [{trace.unit}]",
            f"{passed}.{_hatched(flight)}",
            _chart(number, flight, trace.unit, time, lines),
            table,
        )
        left = (Line("measured − predicted", "residual", both[:, 0] - both[:, 1]),)
        yield Picture(
            f"{_started(trace.axis)}, what the model leaves [{trace.unit}]",
            "Nothing of the vehicle's movement should be seen in it.",
            _chart(number, flight, trace.unit, time, left),
            table,
        )


def _by_run(runs: list[FlightRun], bands: list[Float[np.ndarray, "length 2"]], unit: str) -> TableOf:
    """How much moves and how much is left in each run."""
    titles = (
        "from [s]",
        "to [s]",
        "samples",
        f"RMS measured [{unit}]",
        f"RMS predicted [{unit}]",
        f"RMS left [{unit}]",
    )
    rows: list[tuple[float | str, ...]] = []
    for run, band in zip(runs, bands, strict=True):
        times = (f"{run.time_s[0]:.2f}", f"{run.time_s[-1]:.2f}", f"{run.time_s.size}")
        rows.append((*times, _rms(band[:, 0]), _rms(band[:, 1]), _rms(band[:, 0] - band[:, 1])))
    return number_table(titles, rows)


def _simulated(number: int, flight: PreparedFlight, result: FlightEstimate) -> Iterator[Picture]:
    """What moved, with what was requested, and the input."""
    where = result.motion.words.where
    known = f"{_started(where)} by {flight.active.rule}." if flight.active.mask.any() else f"Never {where}."
    level = flight.signals.family(flight.input.name).mean(axis=1)
    mean = "" if flight.actuators == 1 else f", mean of {flight.actuators} actuators"
    panels = (*result.motion.overview(flight), PlotData(f"input: {flight.input.name}{mean}", level))
    for panel in panels:
        name, _, unit = " ".join(panel.label.split()).partition(" [")
        lines = [Line("measured" if unit else "logged", "measured", panel.values)]
        if panel.reference is not None:
            lines.append(Line("asked for", "predicted", panel.reference))
        title = f"{_started(name)} [{unit}" if unit else _started(name)
        table = number_table(
            ("series", "least", "mean", "greatest", "standard deviation"),
            [(line.label, *_spread(line.values)) for line in lines],
        )
        chart = _chart(number, flight, unit.removesuffix("]"), flight.grid.time_s, tuple(lines))
        yield Picture(title, f"{known}{_hatched(flight)}", chart, table)


def _chart(
    number: int,
    flight: PreparedFlight,
    unit: str,
    time_s: Float[np.ndarray, " n"],
    lines: tuple[Line, ...],
) -> Chart:
    whole = flight.grid.time_s
    over = (float(whole[0]), float(whole[-1]))
    view = over
    if flight.runs:
        first, last = flight.span_s
        around = AROUND * (last - first)
        view = (max(over[0], first - around), min(over[1], last + around))
    return Chart(f"flight-{number + 1}", unit, time_s, lines, over, view, stretches_of(~flight.used, whole))


def _spread(values: Float[np.ndarray, " n"]) -> tuple[float, ...]:
    there = values[np.isfinite(values)]
    if not there.size:
        return (np.nan,) * 4
    return float(there.min()), float(there.mean()), float(there.max()), float(there.std())


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _hatched(flight: PreparedFlight) -> str:
    return "" if flight.used.all() else " Hatched: left out of the estimate."


def _started(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


# -- Provenance --

TITLES = ("log", "format", "span [s]", "used [s]", "runs", "samples", "rate [Hz]")


def provenance(numbers: Mapping[str, Any]) -> Markup:
    """Section of a page, of the document as JSON."""
    made = numbers["provenance"]
    facts = (Fact("made by", f"Eivor {made['version']}"), Fact("schema", numbers["schema"]))
    section = Section("Provenance", (Facts(facts), _logs(numbers)))
    words = [
        Fact(name, _option(item)) for name, item in made["options"].items() if item not in (None, "", [], {})
    ]
    drawing = uplot()
    licence = drawing.licence.strip().split("\n\n")
    return element(
        "div",
        None,
        section_html(section, "provenance", {}),
        _unfolded("Options", part_html(Facts(tuple(words)), {})),
        _unfolded(
            f"Licence of {drawing.name} {drawing.version}, which draws the charts and is part of this file",
            *(element("p", {"class": "licence"}, paragraph.replace("\n", " ")) for paragraph in licence),
        ),
        element(
            "p", {"class": "saving"}, element("button", {"type": "button", "id": "save"}, "Save as JSON")
        ),
    )


def _unfolded(summary: str, *content: Markup) -> Markup:
    return element("details", None, element("summary", None, summary), *content)


def _logs(numbers: Mapping[str, Any]) -> TableOf:
    rows = []
    for log, source in zip(numbers["logs"], numbers["provenance"]["logs"], strict=True):
        checksum = f"SHA-256 {source['sha256']}" if source["sha256"] else ""
        counts = (str(log["runs"]), str(log["samples"]), f"{log['rate_hz']:g}")
        selected = (log["format"], _span(log["span"]), _span(log["window"]), *counts)
        rows.append((Cell(log["name"], checksum), *map(Cell, selected)))
    columns = (*map(TableColumn, TITLES[:2]), *(TableColumn(title, whole=True) for title in TITLES[2:]))
    return TableOf(columns, tuple(rows))


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
    value, interval = record.numbers_text
    index, low, high = (item * wording.scale for item in (quantity.value, *quantity.interval))
    return {
        "name": record.name,
        "words": wording.words,
        "symbol": wording.symbol,
        "unit": wording.shown_unit,
        "shown": [value, interval],
        "status": quantity.verdict.value,
        "at": index if math.isfinite(index) else None,
        "interval": [end if math.isfinite(end) else None for end in (low, high)],
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


def flight_page(result: FlightEstimate) -> str:
    """Text of a page that identifies a result: HTML without anything to fetch."""
    flight = flight_report(result)
    document, numbers = document_of(flight, card=True), json_of(flight, result)
    over_time = list(flights_over_time(result))
    figures = Figures(lines_of(over_time))
    drawn = {
        "ahead": figures.html(
            [prediction_pictures(flight.multi_step_prediction)]
            if flight.multi_step_prediction is not None
            else []
        ),
        "flights": figures.html([forests(flight, flight.flights, "all together")] if flight.flights else []),
        "methods": figures.html([forests(flight, flight.comparisons, "")] if flight.comparisons else []),
        "flight": figures.html(
            [*over_time, *([] if result.fit is None else [pictures_of_fit(result, result.fit)])]
        ),
    }
    sections = [(_name(section), section) for section in document.sections]
    told_sections = [section_html(_displayed(section, result), name, drawn) for name, section in sections]
    title = _title(flight)
    body = joined(
        [
            element("a", {"class": "skip", "href": "#main"}, "To the verdict"),
            _header(result, title),
            element(
                "main",
                {"id": "main"},
                _verdict(document, flight),
                _contents([*sections, ("provenance", Section("Provenance", ()))]),
                *told_sections,
                provenance(numbers),
            ),
        ]
    )
    data = {"result": numbers, "charts": figures.charts, "verdict": verdict_data(document, flight)}
    return whole_page(f"{title}: {flight.verdict.status.value}", body, data)


def _title(record: FlightReport) -> str:
    names = ", ".join(record.logs[:NAMED])
    if len(record.logs) > NAMED:
        names = f"{len(record.logs)} flights: {names}, …"
    return names if len(names) <= LONGEST_TITLE else f"{names[: LONGEST_TITLE - 1]}…"


def _header(result: FlightEstimate, title: str) -> Markup:
    theme = element("button", {"type": "button", "id": "theme"}, "Dark")
    about = element("p", {"class": "about"}, f"Eivor · {result.motion.words.title}")
    return element("header", None, element("div", None, about, element("h1", None, title)), theme)


def _verdict(document: Document, record: FlightReport) -> Markup:
    """What is taken home in three seconds: the verdict in a sentence, and the numbers that it is about."""
    status = record.verdict.status
    sentence = element(
        "p", {"class": "said"}, shape(status), element("strong", None, status.value), f": {document.about}"
    )
    more = [element("p", None, verdict_detail) for verdict_detail in verdict_details(record)]
    readings = [_reading_section(item) for item in record.brief]
    note = element("p", {"class": "note"}, "In brackets: 95 % intervals.")
    listed = [element("div", {"class": "readings"}, *readings), note] if readings else []
    return element("div", {"class": f"verdict {status.value}"}, sentence, *more, *listed)


def _reading_section(quantity: QuantityReport) -> Markup:
    """One number with its interval."""
    value, interval = quantity.numbers_text
    wording = quantity.wording
    unit = [element("span", {"class": "unit"}, f" {wording.shown_unit}")] if wording.shown_unit else []
    return element(
        "div",
        {"class": "reading", "data-quantity": quantity.name},
        element(
            "p", {"class": "name"}, f"{wording.words} ", element("span", {"class": "symbol"}, wording.symbol)
        ),
        element("p", {"class": "number"}, element("span", {"class": "value"}, value), *unit),
        element("p", {"class": "interval"}, interval),
        badge(quantity.quantity.verdict, quantity.quantity.verdict.value),
    )


def _contents(sections: list[tuple[str, Section]]) -> Markup:
    links = [
        element("li", None, element("a", {"href": f"#{name}"}, SHORT.get(section.heading, section.heading)))
        for name, section in sections
    ]
    return element("nav", {"aria-label": "On this page"}, element("ul", None, *links))


def _name(section: Section) -> str:
    """Identifier of a section."""
    words = SHORT.get(section.heading, section.heading).lower()
    return "-".join("".join(letter if letter.isalnum() else " " for letter in words).split())


def _displayed(section: Section, result: FlightEstimate) -> Section:
    """Section under the heading that a page has for it."""
    if not section.heading:
        return replace(section, parts=tuple(_without_summary(part) for part in section.parts))
    if section.heading != "Figure":
        return section
    omitted = len(result.prepared) - MOST_FLIGHTS
    more = f"The first {MOST_FLIGHTS} flights are drawn over time; {omitted} more are in the tables."
    return Section("Pictures", (*((Bullets((more,)),) if omitted > 0 else ()), *section.parts))


def _without_summary(part: Part) -> Part:
    """Facts without what the verdict above has said."""
    if not isinstance(part, Facts):
        return part
    return Facts(tuple(fact for fact in part.facts if fact.label != "identified"))
