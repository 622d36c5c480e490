"""Panels of a flight's figure that are drawn of its runs: the fit, its residual, what excites it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes

from eivor.estimation.candidate import Candidate
from eivor.flights.motion import Trace
from eivor.flights.result import FlightEstimate
from eivor.models.spectral import BinRows, SpectralRun
from eivor.report.plain_figure import fitting, legend
from eivor.report.printable import printable
from eivor.shapes import Complex, Float

MEASURED, PREDICTED, RESIDUAL, SHADE = "#333333", "#d1495b", "#66717e", "#2e86ab"
#: At most so much of a flight is drawn over time [s].
SHOWN_S = 40.0
#: Lags of the autocorrelation: so many samples at twice the band's highest frequency.
AUTOCORRELATION_LAGS = 30
#: Length of the segments that spectra are averaged over [s].
SEGMENT_S = 10.0
LONGEST_NAME = 48
#: Amplitudes below this share of the largest are not drawn: outside of the band there may be none at all.
LEAST_AMPLITUDE = 1e-6
#: Line styles of several axes in one panel.
STYLES = ("-", "--", ":")


@dataclass(frozen=True)
class FlightRun:
    """One run of the time rows.

    Parameters
    ----------
    name : str
        Its log.
    time_s : ndarray, shape (length,)
        On the log's clock.
    rows : slice
        Its rows among all.
    spectral : SpectralRun
        Its bins.
    """

    name: str
    time_s: Float[np.ndarray, " length"]
    rows: slice
    spectral: SpectralRun


def flight_runs(result: FlightEstimate) -> list[FlightRun]:
    """Every run, in the order of the samples of a trace."""
    found: list[FlightRun] = []
    first = 0
    flying = [flight for flight in result.prepared if flight.runs]
    for number, flight in enumerate(flying):
        seconds, name = flight.grid.time_s, printable(flight.recording.name)
        for samples, spectral in zip(flight.samples_of_runs, flight.spectral_runs(number), strict=True):
            rows = slice(first, first + samples.size)
            found.append(FlightRun(name, seconds[samples], rows, spectral))
            first = rows.stop
    return found


def short_name(name: str) -> str:
    """Name of a log, cut where it is too long for a title."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def draw_fit(axes: Axes, trace: Trace, runs: list[FlightRun]) -> None:
    """Draw what was measured along one axis and what the model says, both within the band."""
    run = _longest(runs)
    time, band = _within_the_band(trace, run)
    low, high = trace.band_hz or _band(run.spectral)
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
    columns = np.column_stack([trace.measured, trace.predicted])[run.rows]
    return run.time_s[inside], run.spectral.band_passed(columns)[inside]


def _most_moved(values: Float[np.ndarray, " length"], run: FlightRun) -> slice:
    """The `SHOWN_S` of a run in which `values` vary most; all of a shorter run."""
    count = int(SHOWN_S / run.spectral.step_s)
    if values.size <= count:
        return slice(0, values.size)
    power = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    first = int(np.argmax(power[count:] - power[:-count]))
    return slice(first, first + count)


def _band(run: SpectralRun) -> tuple[float, float]:
    frequency = run.frequency_hz
    return (float(frequency[0]), run.band_hz[1]) if frequency.size else run.band_hz


def draw_autocorrelation(axes: Axes, best: Candidate, runs: list[FlightRun]) -> None:
    """Autocorrelation of the residual that inference works on, sampled at twice the band's top."""
    layout = best.rows.layout
    if isinstance(layout, BinRows):
        blocks = [block[:, 0] for block in layout.complex_blocks(best.residuals[:, None])]
        spectral, what = list(layout.runs), "whitened residual"
    else:
        spectral, what = [run.spectral for run in runs], "residual, band-passed"
        blocks = [
            run.spectral.spectrum(run.spectral.spread(best.residuals[run.rows][:, None]))[:, 0]
            for run in runs
            if run.rows.stop <= best.residuals.size
        ]
    correlation, lags = _autocorrelation(blocks, spectral)
    band = 1.96 / np.sqrt(max(2.0 * sum(block.size for block in blocks), 1.0))
    axes.axhspan(-band, band, color=SHADE, alpha=0.18, lw=0, label="95 % band of white noise")
    axes.vlines(lags[1:], 0.0, correlation[1:], color=RESIDUAL, lw=1.6)
    axes.plot(lags[1:], correlation[1:], "o", color=RESIDUAL, ms=3)
    axes.axhline(0.0, color="black", lw=0.5)
    axes.set_title(f"Autocorrelation of the {what}", fontsize=9)
    axes.set_xlabel("shift [s]")
    axes.set_ylabel("correlation")
    limit = max(0.3, 1.15 * float(np.max(np.abs(correlation[1:]), initial=0.0)))
    axes.set_ylim(-limit, limit)
    axes.grid(alpha=0.25)
    legend(axes, place="upper right")


def _autocorrelation(
    blocks: list[Complex[np.ndarray, " _"]], runs: list[SpectralRun]
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Correlation at multiples of half a period of the band's top, from the power of the bins."""
    step = 1.0 / (2.0 * max(run.band_hz[1] for run in runs))
    lags = step * np.arange(AUTOCORRELATION_LAGS + 1)
    power = np.concatenate([np.abs(block) ** 2 for block in blocks])
    frequency = np.concatenate([run.frequency_hz for run, _ in zip(runs, blocks, strict=False)])
    total = float(power.sum())
    if total <= 0.0:
        return np.zeros(lags.size), lags
    correlation: Float[np.ndarray, " lags"] = np.cos(2.0 * np.pi * np.outer(lags, frequency)) @ power / total
    return correlation, lags


def draw_excitation(axes: Axes, traces: tuple[Trace, ...], runs: list[FlightRun]) -> None:
    """Amplitude of what the input does to each axis of one unit, and of what the model leaves."""
    traces = tuple(trace for trace in traces if trace.unit == traces[0].unit)
    for trace, style in zip(traces, cycle(STYLES), strict=False):
        of_axis = f" ({trace.axis})" if len(traces) > 1 else ""
        for values, colour, label in (
            (trace.driven, PREDICTED, f"input: {trace.drive}{of_axis}"),
            (trace.measured - trace.predicted, RESIDUAL, f"residual{of_axis}"),
        ):
            frequency, amplitude = _spectrum(values, runs)
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


def _spectrum(
    values: Float[np.ndarray, " rows"], runs: list[FlightRun]
) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Amplitude density, averaged over half-overlapping Hann segments of every run at one rate."""
    step = min(run.spectral.step_s for run in runs)
    alike = [run for run in runs if run.spectral.step_s == step]
    longest = max(run.time_s.size for run in alike)
    length = min(int(SEGMENT_S / step), longest)
    window = np.hanning(length + 1)[:length] if length > 1 else np.ones(length)
    total, count = np.zeros(length // 2 + 1), 0
    for run in alike:
        series = values[run.rows]
        for first in range(0, series.size - length + 1, max(length // 2, 1)):
            segment = series[first : first + length]
            total += np.abs(np.fft.rfft((segment - segment.mean()) * window)) ** 2
            count += 1
    density = 2.0 * step * total / (max(count, 1) * float(window @ window))
    frequency = np.fft.rfftfreq(length, step)
    return frequency[1:], np.sqrt(np.maximum(density[1:], 1e-20))
