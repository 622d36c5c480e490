"""Pictures of a flight over time: measured and predicted, what is left, what moved and was asked for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.flights.result import FlightEstimate
from eivor.flights.shown import Panel, Trace
from eivor.report.document import TableOf
from eivor.report.fit_numbers import FlightRun, band_of, flight_runs, within_band
from eivor.report.page.chart import Chart, Line, stretches_of
from eivor.report.page.number_tables import number_table
from eivor.report.page.picture import Picture, Pictures
from eivor.shapes import Float

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
        own = [run for run in runs if run.flight == number]
        pictures = (*_fitted(number, flight, traces, own), *_flown(number, flight, result))
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
            f"{_begun(trace.axis)}, measured and predicted [{trace.unit}]",
            f"{passed}.{_hatched(flight)}",
            _chart(number, flight, trace.unit, time, lines),
            table,
        )
        left = (Line("measured − predicted", "residual", both[:, 0] - both[:, 1]),)
        yield Picture(
            f"{_begun(trace.axis)}, what the model leaves [{trace.unit}]",
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


def _flown(number: int, flight: PreparedFlight, result: FlightEstimate) -> Iterator[Picture]:
    """What moved, with what was asked for, and the input."""
    where = result.motion.words.where
    known = f"{_begun(where)} by {flight.active.rule}." if flight.active.mask.any() else f"Never {where}."
    level = flight.signals.family(flight.input.name).mean(axis=1)
    mean = "" if flight.actuators == 1 else f", mean of {flight.actuators} actuators"
    panels = (*result.motion.overview(flight), Panel(f"input: {flight.input.name}{mean}", level))
    for panel in panels:
        name, _, unit = " ".join(panel.label.split()).partition(" [")
        lines = [Line("measured" if unit else "logged", "measured", panel.values)]
        if panel.asked is not None:
            lines.append(Line("asked for", "predicted", panel.asked))
        title = f"{_begun(name)} [{unit}" if unit else _begun(name)
        table = number_table(
            ("series", "least", "mean", "greatest", "standard deviation"),
            [(one.label, *_spread(one.values)) for one in lines],
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


def _begun(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"
