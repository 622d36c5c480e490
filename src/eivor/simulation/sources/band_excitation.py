"""Excitations that fill a band of frequencies: filtered white noise, chirp, multisine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.errors import ParameterError
from eivor.shapes import Bool, Float
from eivor.simulation.sources.excitation import Excitation
from eivor.simulation.sources.parameter_checks import non_negative, positive, require


@dataclass(frozen=True, slots=True)
class FilteredWhite(Excitation):
    """White noise with nothing outside a band, to rounding.

    Parameters
    ----------
    std : float
        Standard deviation in the mean over realisations.
    low_hz, high_hz : float
        The band [Hz], both ends included. It must hold a multiple of one over the record's duration,
        and end below half the rate.

    Notes
    -----
    Filtered in the frequency domain: the series is periodic with the record. Mean zero.
    """

    std: float
    low_hz: float
    high_hz: float

    def __post_init__(self) -> None:
        _check_size_and_band("std", self.std, self.low_hz, self.high_hz)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        spectrum = np.fft.rfft(rng.standard_normal(count))
        inside = _bins(count, step_s, self.low_hz, self.high_hz)
        spectrum[~inside] = 0.0
        return self.std * np.sqrt(0.5 * count / inside.sum()) * np.fft.irfft(spectrum, count)


@dataclass(frozen=True, slots=True)
class Chirp(Excitation):
    """A sinus whose frequency grows linearly from one end of a band to the other over the record.

    Parameters
    ----------
    amplitude : float
        Its peak.
    low_hz, high_hz : float
        The band [Hz], which must end below half the rate.
    """

    amplitude: float
    low_hz: float
    high_hz: float

    def __post_init__(self) -> None:
        _check_size_and_band("amplitude", self.amplitude, self.low_hz, self.high_hz)

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        _check_rate(self.high_hz, step_s)
        t, duration = step_s * np.arange(count), step_s * count
        turns = self.low_hz * t + 0.5 * (self.high_hz - self.low_hz) * t**2 / duration
        return self.amplitude * np.sin(2.0 * np.pi * turns)


@dataclass(frozen=True, slots=True)
class Multisine(Excitation):
    """Equal sinusoids at every multiple of one over the record's duration in a band.

    Schroeder's phases, -pi m (m - 1) / M for the m-th of M, keep the peak low: about 1.8 times the
    standard deviation, as a chirp's (1.41) rather than as noise's.

    Parameters
    ----------
    std : float
        Standard deviation of the sum over the record.
    low_hz, high_hz : float
        The band [Hz], both ends included, as of filtered white noise.
    """

    std: float
    low_hz: float
    high_hz: float

    def __post_init__(self) -> None:
        _check_size_and_band("std", self.std, self.low_hz, self.high_hz)

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        inside = _bins(count, step_s, self.low_hz, self.high_hz)
        lines = int(inside.sum())
        numbers = np.arange(1, lines + 1)
        spectrum = np.zeros(inside.size, dtype=np.complex128)
        spectrum[inside] = np.exp(-1j * np.pi * numbers * (numbers - 1) / lines)
        return self.std * count / np.sqrt(2.0 * lines) * np.fft.irfft(spectrum, count)


def _check_size_and_band(name: str, size: float, low_hz: float, high_hz: float) -> None:
    non_negative(name, size)
    non_negative("low_hz", low_hz)
    positive("high_hz", high_hz)
    require(low_hz <= high_hz, "a low_hz up to high_hz", f"low_hz={low_hz}, high_hz={high_hz}")


def _check_rate(high_hz: float, step_s: float) -> None:
    require(
        high_hz < 0.5 / step_s,
        "a band that ends below half the rate",
        f"high_hz={high_hz} at {1.0 / step_s:.6g} Hz",
        "Lower it, or raise the rate.",
    )


def _bins(count: int, step_s: float, low_hz: float, high_hz: float) -> Bool[np.ndarray, " bins"]:
    """Which bins of the real FFT lie in the band; never the mean."""
    _check_rate(high_hz, step_s)
    frequencies = np.fft.rfftfreq(count, step_s)
    tolerance = 1e-9 / (count * step_s)
    inside = (frequencies >= low_hz - tolerance) & (frequencies <= high_hz + tolerance) & (frequencies > 0.0)
    if not inside.any():
        raise ParameterError(
            f"a band that holds a multiple of {1.0 / (count * step_s):.6g} Hz, one over the duration",
            f"low_hz={low_hz}, high_hz={high_hz}",
            "Widen it, or make the record longer.",
        )
    return inside
