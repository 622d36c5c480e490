"""What pictures of a fit are drawn of: runs, spectra, autocorrelation of the residual, profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.search import NuisanceProfile
from eivor.flights.result import FlightEstimate
from eivor.flights.shown import Trace
from eivor.models.spectral import BinRows, SpectralRun
from eivor.report.printable import printable
from eivor.shapes import Complex, Float

#: Lags of the autocorrelation: so many samples at twice the band's highest frequency.
AUTOCORRELATION_LAGS = 30
#: Length of the segments that spectra are averaged over [s].
SEGMENT_S = 10.0
#: Amplitudes below this share of the largest are not drawn: outside of the band there may be none at all.
LEAST_AMPLITUDE = 1e-6


@dataclass(frozen=True)
class FlightRun:
    """One run of the time rows.

    Parameters
    ----------
    flight : int
        Number of its flight among all that were prepared.
    name : str
        Its log.
    time_s : ndarray, shape (length,)
        On the log's clock.
    rows : slice
        Its rows among all.
    spectral : SpectralRun
        Its bins.
    """

    flight: int
    name: str
    time_s: Float[np.ndarray, " length"]
    rows: slice
    spectral: SpectralRun


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of a residual.

    Parameters
    ----------
    what : str
        Whose, in words.
    shift_s, correlation : ndarray, shape (lags,)
        Shifts from zero on [s], and the correlation at each.
    band : float
        White noise keeps 95 % of its correlations within plus and minus this.
    """

    what: str
    shift_s: Float[np.ndarray, " lags"]
    correlation: Float[np.ndarray, " lags"]
    band: float


@dataclass(frozen=True)
class ProfileCurve:
    """How well each value of a continuous nuisance fits, with the discrete ones at one of their choices.

    Parameters
    ----------
    choice : str
        Values of the discrete ones, in the motion's words: "delay 10 ms".
    values, excess : ndarray, shape (values,)
        Values in SI units, and the objective above the least of all curves, in units of chi-square.
    """

    choice: str
    values: Float[np.ndarray, " values"]
    excess: Float[np.ndarray, " values"]


def flight_runs(result: FlightEstimate) -> list[FlightRun]:
    """Every run, in the order of the samples of a trace."""
    found: list[FlightRun] = []
    first = 0
    flying = [(place, flight) for place, flight in enumerate(result.prepared) if flight.runs]
    for number, (place, flight) in enumerate(flying):
        seconds, name = flight.grid.time_s, printable(flight.recording.name)
        for samples, spectral in zip(flight.samples_of_runs, flight.spectral_runs(number), strict=True):
            rows = slice(first, first + samples.size)
            found.append(FlightRun(place, name, seconds[samples], rows, spectral))
            first = rows.stop
    return found


def band_of(trace: Trace, run: FlightRun) -> tuple[float, float]:
    """Band that a trace is shown in [Hz]."""
    frequency, (low, high) = run.spectral.frequency_hz, run.spectral.band_hz
    return trace.band_hz or (float(frequency[0]) if frequency.size else low, high)


def within_band(trace: Trace, run: FlightRun) -> Float[np.ndarray, "length 2"]:
    """Measured and predicted over a run, both within the band."""
    return run.spectral.band_passed(np.column_stack([trace.measured, trace.predicted])[run.rows])


def residual_autocorrelation(best: Candidate, runs: list[FlightRun]) -> Autocorrelation:
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
    correlation, shift_s = _autocorrelation(blocks, spectral)
    band = 1.96 / np.sqrt(max(2.0 * sum(block.size for block in blocks), 1.0))
    return Autocorrelation(what, shift_s, correlation, float(band))


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


def spectrum(
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


def profile_curves(result: FlightEstimate, estimate: Estimate, number: int) -> list[ProfileCurve]:
    """Objective against one nuisance, a curve for each combination of discrete ones that fits."""
    lowest = min(candidate.criterion for candidate in estimate.candidates)
    curves = []
    for candidate in estimate.tenable():
        values, height = _curve(candidate, candidate.profiles[number])
        curves.append(ProfileCurve(_choice(candidate, result), values, height + candidate.criterion - lowest))
    return curves


def _curve(
    candidate: Candidate, profile: NuisanceProfile
) -> tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]:
    """Values of a nuisance, and the objective above its least there, as chi-square."""
    least = candidate.solution.objective
    # J of a method with instruments; for a direct one the logarithm's slope at its minimum
    height = candidate.criterion if candidate.inference.rank else candidate.rows.response.size
    scale = height / least if least > 0.0 and height > 0.0 else 1.0
    # the refined minimum lies between points of the grid: without it a sharp valley has no bottom
    values = np.append(profile.grid, candidate.at[profile.nuisance.name])
    excess = scale * (np.append(profile.objective, least) - least)
    order = np.argsort(values)
    return values[order], excess[order]


def _choice(candidate: Candidate, result: FlightEstimate) -> str:
    """Values of the discrete nuisances, in the motion's words: "delay 10 ms"."""
    refined = {profile.nuisance.name for profile in candidate.profiles}
    told = [
        (result.motion.wording[name], value) for name, value in candidate.at.items() if name not in refined
    ]
    return ", ".join(f"{one.words} {value * one.scale:.3g} {one.shown_unit}".rstrip() for one, value in told)
