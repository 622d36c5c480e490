"""Panels of a flight's figure that are drawn of its runs: the fit, its residual, what excites it."""

from __future__ import annotations

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes

from eivor.estimation.candidate import Candidate
from eivor.flights.shown import Trace
from eivor.report.fit_numbers import (
    LEAST_AMPLITUDE,
    FlightRun,
    band_of,
    residual_autocorrelation,
    spectrum,
    within_band,
)
from eivor.report.plain_figure import fitting, legend
from eivor.report.printable import short_name
from eivor.shapes import Float

MEASURED, PREDICTED, RESIDUAL, SHADE = "#333333", "#d1495b", "#66717e", "#2e86ab"
#: At most so much of a flight is drawn over time [s].
SHOWN_S = 40.0
#: Line styles of several axes in one panel.
STYLES = ("-", "--", ":")


def draw_fit(axes: Axes, trace: Trace, runs: list[FlightRun]) -> None:
    """Draw what was measured along one axis and what the model says, both within the band."""
    run = _longest(runs)
    time, band = _within_the_band(trace, run)
    low, high = band_of(trace, run)
    axes.plot(time, band[:, 0], color=MEASURED, lw=0.9, label="measured")
    axes.plot(time, band[:, 1], color=PREDICTED, lw=1.1, label=f"predicted: {trace.model}")
    axes.set_ylabel(f"{trace.axis}\n[{trace.unit}]", parse_math=False)
    count = len(runs)
    what = "the whole run" if count == 1 else f"the longest of {count} runs"
    if time.size < run.time_s.size:
        what = f"the liveliest {time[-1] - time[0]:.0f} s of {what.replace('the whole', 'the')}"
    passed = f"both band-passed {low:.2f} to {high:.0f} Hz"
    title = f"Measured and predicted, {passed}: {what}, {short_name(run.name)}"
    axes.set_title(fitting(axes, title), fontsize=9, parse_math=False)
    legend(axes)
    _over_time(axes)


def draw_residual(axes: Axes, trace: Trace, runs: list[FlightRun]) -> None:
    """Draw what the model leaves of what `draw_fit` shows."""
    time, band = _within_the_band(trace, _longest(runs))
    axes.plot(time, band[:, 0] - band[:, 1], color=RESIDUAL, lw=0.9)
    axes.axhline(0.0, color="black", lw=0.5)
    axes.set_ylabel(f"residual\n[{trace.unit}]", parse_math=False)
    _over_time(axes)


def _over_time(axes: Axes) -> None:
    axes.set_xlabel("time from the log's start [s]")
    axes.margins(x=0.005)
    axes.grid(alpha=0.25)


def _longest(runs: list[FlightRun]) -> FlightRun:
    return max(runs, key=lambda candidate: candidate.time_s.size)


def _within_the_band(
    trace: Trace, run: FlightRun
) -> tuple[Float[np.ndarray, " shown"], Float[np.ndarray, "shown 2"]]:
    """Time, and what was measured and predicted in the part of a run that moves most."""
    inside = _most_moved(trace.measured[run.rows], run)
    return run.time_s[inside], within_band(trace, run)[inside]


def _most_moved(values: Float[np.ndarray, " length"], run: FlightRun) -> slice:
    """The `SHOWN_S` of a run in which `values` vary most; all of a shorter run."""
    count = int(SHOWN_S / run.spectral.step_s)
    if values.size <= count:
        return slice(0, values.size)
    power = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    first = int(np.argmax(power[count:] - power[:-count]))
    return slice(first, first + count)


def draw_autocorrelation(axes: Axes, best: Candidate, runs: list[FlightRun]) -> None:
    """Autocorrelation of the residual that inference works on, sampled at twice the band's top."""
    found = residual_autocorrelation(best, runs)
    lags, correlation, band = found.shift_s, found.correlation, found.band
    axes.axhspan(-band, band, color=SHADE, alpha=0.18, lw=0, label="95 % band of white noise")
    axes.vlines(lags[1:], 0.0, correlation[1:], color=RESIDUAL, lw=1.6)
    axes.plot(lags[1:], correlation[1:], "o", color=RESIDUAL, ms=3)
    axes.axhline(0.0, color="black", lw=0.5)
    axes.set_title(f"Autocorrelation of the {found.what}", fontsize=9)
    axes.set_xlabel("shift [s]")
    axes.set_ylabel("correlation")
    limit = max(0.3, 1.15 * float(np.max(np.abs(correlation[1:]), initial=0.0)))
    axes.set_ylim(-limit, limit)
    axes.grid(alpha=0.25)
    legend(axes, place="upper right")


def draw_excitation(axes: Axes, traces: tuple[Trace, ...], runs: list[FlightRun]) -> None:
    """Amplitude of what the input does to each axis that it moves, of one unit, and of what is left."""
    traces = tuple(trace for trace in traces if trace.unit == traces[0].unit and trace.driven.any())
    for trace, style in zip(traces, cycle(STYLES), strict=False):
        of_axis = f" ({trace.axis})" if len(traces) > 1 else ""
        for values, colour, label in (
            (trace.driven, PREDICTED, f"input: {trace.drive}{of_axis}"),
            (trace.measured - trace.predicted, RESIDUAL, f"residual{of_axis}"),
        ):
            frequency, amplitude = spectrum(values, runs)
            axes.loglog(frequency, amplitude, color=colour, lw=1.2, ls=style, label=label)
    low, high = axes.get_ylim()
    axes.set_ylim(bottom=max(low, LEAST_AMPLITUDE * high))
    low, high = runs[0].spectral.band_hz
    axes.axvspan(low, high, color=SHADE, alpha=0.12, lw=0, label="band used")
    axes.set_title("Excitation", fontsize=9)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude [{traces[0].unit} per √Hz]", parse_math=False)
    axes.grid(alpha=0.25, which="both")
    legend(axes, size=8 if len(traces) == 1 else 6, place="lower left")
