"""The figure of a flight's result: what was measured, what the model says, and what the verdict rests on.

Five panels: measured against predicted acceleration; the residual below it; its autocorrelation; the
objective against the lag; what excites the vehicle, by frequency. Matplotlib's
object interface only: nothing here touches the global state of pyplot. Text is never parsed for
mathematics, so that a log's name cannot be taken for a formula.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.flights.motion import Trace
from eivor.flights.result import FlightEstimate
from eivor.inference.quantiles import chi_square_quantile
from eivor.inference.verdict import Status
from eivor.models.spectral import BinRows, SpectralRun
from eivor.report.figure_without_estimate import draw_flight
from eivor.report.printable import printable
from eivor.report.wording import NO_NUMBER, numbers
from eivor.whole_file import whole_file

SIZE_INCHES = (11.0, 8.5)
#: What each further axis adds to the height.
AXIS_INCHES = 4.0
DPI = 110
MEASURED, PREDICTED, RESIDUAL, SHADE = "#333333", "#d1495b", "#66717e", "#2e86ab"
TITLE_COLOURS = {
    Status.IDENTIFIED: "#1b7f3b",
    Status.WEAK: "#a06a00",
    Status.PROVISIONAL: "#7b3f9e",
    Status.REFUSED: "#b3261e",
}
#: At most so much of a flight is drawn over time [s].
SHOWN_S = 40.0
#: Lags of the autocorrelation: so many samples at twice the band's highest frequency.
AUTOCORRELATION_LAGS = 30
#: The lag profile is drawn up to so many times the height that bounds a delay, or higher; linear up to
#: that height and logarithmic above it.
PROFILE_HEIGHT = 5.0
#: Length of the segments that spectra are averaged over [s].
SEGMENT_S = 10.0
LONGEST_NAME = 48
#: Line styles of several axes in one panel.
STYLES = ("-", "--", ":")


@dataclass(frozen=True)
class _Run:
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


def flight_figure(result: FlightEstimate) -> Figure:
    """Figure of a result; without an estimate it shows the flight itself and says why.

    Parameters
    ----------
    result : FlightEstimate
        Of one flight or of a pool.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own; save it with `save_figure` or `Figure.savefig`.
    """
    figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    _title(figure, result)
    if result.fit is None:
        draw_flight(figure, result)
        return figure
    traces = result.motion.traces(result.fit.problem, result.fit.estimate)
    runs, axes_of = _runs(result), len(traces)
    figure.set_size_inches(SIZE_INCHES[0], SIZE_INCHES[1] + AXIS_INCHES * (axes_of - 1))
    grid = GridSpec(2 * axes_of + 1, 3, figure=figure, height_ratios=(*(2.0, 0.9) * axes_of, 2.2))
    for place, trace in enumerate(traces):
        top = figure.add_subplot(grid[2 * place, :])
        _draw_fit(top, figure.add_subplot(grid[2 * place + 1, :], sharex=top), trace, runs)
    _draw_autocorrelation(figure.add_subplot(grid[-1, 0]), result.fit.estimate.best, runs)
    _draw_lag_profile(figure.add_subplot(grid[-1, 1]), result, result.fit.estimate)
    _draw_excitation(figure.add_subplot(grid[-1, 2]), traces, runs)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, told by the ending; whole, and the same result gives the same bytes.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    kind = path.suffix.lower().lstrip(".")
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with warnings.catch_warnings():
        # a log's name may hold letters that the font does not have; they become boxes
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        with whole_file(path) as file:
            figure.savefig(file, format=kind, metadata=metadata)


def _title(figure: Figure, result: FlightEstimate) -> None:
    names = [printable(flight.recording.name) for flight in result.prepared]
    shown = _short(names[0])
    if len(names) > 1:
        shown = f"{len(names)} flights: {shown}, …"
    parts = []
    for name in result.motion.rows:
        wording = result.motion.wording[name]
        value, interval = numbers(result.quantities[name], wording)
        if value != NO_NUMBER:
            bounds = "" if interval == NO_NUMBER else f" {interval}"
            parts.append(f"{wording.words} {value}{bounds} {wording.shown_unit}".rstrip())
    lines = [f"{shown} — {result.verdict.status.value}", "; ".join(parts[:2]), "; ".join(parts[2:])]
    figure.suptitle(
        "\n".join(line for line in lines if line),
        fontsize=11,
        color=TITLE_COLOURS[result.verdict.status],
        parse_math=False,
    )


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def _runs(result: FlightEstimate) -> list[_Run]:
    """Every run, in the order of the samples of a trace."""
    found: list[_Run] = []
    first = 0
    flying = [flight for flight in result.prepared if flight.runs]
    for number, flight in enumerate(flying):
        seconds = flight.grid.time_s
        for run in flight.runs:
            length = run.stop - run.start
            time = seconds[run]
            spectral = SpectralRun(number, length, flight.signals.step_s, flight.band_hz)
            name = printable(flight.recording.name)
            found.append(_Run(name, time, slice(first, first + length), spectral))
            first += length
    return found


# -- measured against predicted ----------------------------------------------------------------------


def _draw_fit(axes: Axes, below: Axes, trace: Trace, runs: list[_Run]) -> None:
    run = max(runs, key=lambda candidate: candidate.time_s.size)
    inside = _most_moved(trace.measured[run.rows], run)
    columns = np.column_stack([trace.measured, trace.predicted])[run.rows]
    band = run.spectral.series(run.spectral.spectrum(columns))[inside]
    time = run.time_s[inside]
    low, high = _band(run.spectral)
    axes.plot(time, band[:, 0], color=MEASURED, lw=0.9, label="measured")
    axes.plot(time, band[:, 1], color=PREDICTED, lw=1.1, label=f"predicted: {trace.model}")
    axes.set_ylabel(f"{trace.axis}\n[{trace.unit}]", parse_math=False)
    count = len(runs)
    what = "the whole run" if count == 1 else f"the longest of {count} runs"
    if time.size < run.time_s.size:
        what = f"the liveliest {time[-1] - time[0]:.0f} s of {what.replace('the whole', 'the')}"
    axes.set_title(
        f"Measured and predicted, both band-passed {low:.2f} to {high:.0f} Hz: {what}, {_short(run.name)}",
        fontsize=9,
        parse_math=False,
    )
    _legend(axes)
    below.plot(time, band[:, 0] - band[:, 1], color=RESIDUAL, lw=0.9)
    below.axhline(0.0, color="black", lw=0.5)
    below.set_ylabel(f"residual\n[{trace.unit}]", parse_math=False)
    below.set_xlabel("time from the log's start [s]")
    axes.tick_params(labelbottom=False)
    for each in (axes, below):
        each.margins(x=0.005)
        each.grid(alpha=0.25)


def _most_moved(values: Float[np.ndarray, " length"], run: _Run) -> slice:
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


def _legend(
    axes: Axes,
    place: Literal["best", "upper right", "upper left", "lower left"] = "best",
    *,
    columns: int = 1,
) -> None:
    legend = axes.legend(fontsize=8 if columns == 1 else 7, framealpha=0.85, loc=place, ncols=columns)
    for text in legend.get_texts():
        text.set_parse_math(False)


# -- autocorrelation ---------------------------------------------------------------------------------


def _draw_autocorrelation(axes: Axes, best: Candidate, runs: list[_Run]) -> None:
    """Autocorrelation of the residual that inference works on, sampled at twice the band's top."""
    layout = best.rows.layout
    if isinstance(layout, BinRows):
        blocks = [block[:, 0] for block in layout.complex_blocks(best.residuals[:, None])]
        spectral, what = list(layout.runs), "whitened residual"
    else:
        spectral, what = [run.spectral for run in runs], "residual, band-passed"
        blocks = [
            run.spectral.spectrum(best.residuals[run.rows][:, None])[:, 0]
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
    _legend(axes, "upper right")


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


# -- lag profile -------------------------------------------------------------------------------------


def _draw_lag_profile(axes: Axes, result: FlightEstimate, estimate: Estimate) -> None:
    axes.set_title("How well each lag fits", fontsize=9)
    if not estimate.best.profiles:
        axes.text(
            0.5,
            0.5,
            result.motion.words.no_lag,
            ha="center",
            va="center",
            transform=axes.transAxes,
        )
        axes.set_axis_off()
        return
    quantile = chi_square_quantile(0.95)
    tallest = PROFILE_HEIGHT * quantile
    lowest = min(candidate.criterion for candidate in estimate.candidates)
    for candidate in estimate.tenable():
        profile = candidate.profiles[0]
        least = candidate.solution.objective
        # J of a method with instruments; for a direct one the logarithm's slope at its minimum
        height = candidate.criterion if candidate.inference.rank else candidate.rows.response.size
        scale = height / least if least > 0.0 and height > 0.0 else 1.0
        # the refined minimum lies between points of the grid: without it a sharp valley has no bottom
        lags = np.append(profile.grid, candidate.at[profile.nuisance.name])
        excess = scale * (np.append(profile.objective, least) - least) + candidate.criterion - lowest
        order = np.argsort(lags)
        tallest = max(tallest, float(excess.max()))
        axes.plot(
            lags[order] * 1e3,
            excess[order],
            "-o",
            ms=2,
            lw=1.1,
            label=_choice(candidate, result),
        )
    name = estimate.best.profiles[0].nuisance.name
    lag, wording = result.quantities[name], result.motion.wording[name]
    low, high = (1e3 * end for end in lag.interval)
    axes.axvspan(max(low, 1e-3), high, color=SHADE, alpha=0.18, lw=0, label="95 % interval")
    axes.axvline(1e3 * lag.value, color=SHADE, lw=0.7)
    axes.axhline(quantile, color="black", lw=0.7, ls="--")
    axes.set_xscale("log")
    grid = estimate.best.profiles[0].grid
    axes.set_xlim(0.9e3 * float(grid[0]), 1.1e3 * float(grid[-1]))
    axes.set_xticks([2, 5, 10, 20, 50, 100, 200], labels=["2", "5", "10", "20", "50", "100", "200"])
    axes.minorticks_off()
    axes.set_yscale("symlog", linthresh=quantile)
    axes.set_ylim(-0.15 * quantile, 60.0 * tallest)  # room for the legend above the curves
    axes.set_xlabel(f"{wording.words} {wording.symbol} [ms]", parse_math=False)
    axes.set_ylabel("objective above its least (χ² units)")
    axes.grid(alpha=0.25)
    _legend(axes, "upper left", columns=2)


def _choice(candidate: Candidate, result: FlightEstimate) -> str:
    """Values of the discrete nuisances, in the motion's words: "delay 10 ms"."""
    refined = {profile.nuisance.name for profile in candidate.profiles}
    told = [
        (result.motion.wording[name], value) for name, value in candidate.at.items() if name not in refined
    ]
    return ", ".join(f"{one.words} {value * one.scale:.0f} {one.shown_unit}".rstrip() for one, value in told)


# -- excitation --------------------------------------------------------------------------------------


def _draw_excitation(axes: Axes, traces: tuple[Trace, ...], runs: list[_Run]) -> None:
    """Amplitude of what the input does to each axis, and of what the model leaves."""
    for trace, style in zip(traces, cycle(STYLES), strict=False):
        of_axis = f" ({trace.axis})" if len(traces) > 1 else ""
        for values, colour, label in (
            (trace.driven, PREDICTED, f"input: {trace.drive}{of_axis}"),
            (trace.measured - trace.predicted, RESIDUAL, f"residual{of_axis}"),
        ):
            frequency, amplitude = _spectrum(values, runs)
            axes.loglog(frequency, amplitude, color=colour, lw=1.2, ls=style, label=label)
    low, high = runs[0].spectral.band_hz
    axes.axvspan(low, high, color=SHADE, alpha=0.12, lw=0, label="band used")
    axes.set_title("Excitation", fontsize=9)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude [{traces[0].unit} per √Hz]", parse_math=False)
    axes.grid(alpha=0.25, which="both")
    _legend(axes, "lower left")


def _spectrum(
    values: Float[np.ndarray, " rows"], runs: list[_Run]
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
