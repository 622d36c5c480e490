"""Excitations: inputs, and references, that make a machine tell its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import ParameterError
from eivor.signals.parameter_checks import finite, given, non_negative, positive, require


class Excitation(ABC):
    """A series on a uniform grid."""

    @abstractmethod
    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation on a grid of that step [s]."""


@dataclass(frozen=True, slots=True)
class PaperInput(Excitation):
    """The paper's (35): u(t_k) = 0.7 w(t_{k-1}) + 0.49 w(t_{k-2}) + sin(0.1 t_k^1.1), t in seconds.

    Parameters
    ----------
    variance : float
        Variance of the white sequence w.
    """

    variance: float = 0.02

    def __post_init__(self) -> None:
        non_negative("variance", self.variance)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation; w exists before the record."""
        w = np.sqrt(self.variance) * rng.standard_normal(count + 2)
        t = step_s * np.arange(count)
        return 0.7 * w[1:-1] + 0.49 * w[:-2] + np.sin(0.1 * t**1.1)


@dataclass(frozen=True, slots=True)
class WhiteExcitation(Excitation):
    """Independent normal values.

    Parameters
    ----------
    std : float
        Standard deviation.
    """

    std: float = 1.0

    def __post_init__(self) -> None:
        non_negative("std", self.std)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        del step_s
        return self.std * rng.standard_normal(count)


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
        non_negative("std", self.std)
        _check_band(self.low_hz, self.high_hz)

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
        non_negative("amplitude", self.amplitude)
        _check_band(self.low_hz, self.high_hz)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        del rng
        _check_rate(self.high_hz, step_s)
        t, duration = step_s * np.arange(count), step_s * count
        turns = self.low_hz * t + 0.5 * (self.high_hz - self.low_hz) * t**2 / duration
        return self.amplitude * np.sin(2.0 * np.pi * turns)


@dataclass(frozen=True, slots=True)
class Multisine(Excitation):
    """Equal sinusoids at every multiple of one over the record's duration in a band.

    Schroeder's phases, -pi m (m - 1) / M for the m-th of M, keep the peak low: about 1.7 times the
    standard deviation, as a chirp's (1.41) rather than as noise's.

    Parameters
    ----------
    std : float
        Standard deviation of the sum over the record.
    low_hz, high_hz : float
        The band [Hz], both ends included, see `FilteredWhite`.
    """

    std: float
    low_hz: float
    high_hz: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)
        _check_band(self.low_hz, self.high_hz)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        del rng
        inside = _bins(count, step_s, self.low_hz, self.high_hz)
        lines = int(inside.sum())
        numbers = np.arange(1, lines + 1)
        spectrum = np.zeros(inside.size, dtype=np.complex128)
        spectrum[inside] = np.exp(-1j * np.pi * numbers * (numbers - 1) / lines)
        return self.std * count / np.sqrt(2.0 * lines) * np.fft.irfft(spectrum, count)


@dataclass(frozen=True, slots=True)
class PseudoRandomBinary(Excitation):
    """Pseudo-random binary sequence of maximal length, at plus or minus an amplitude.

    Parameters
    ----------
    amplitude : float
        Absolute value at every sample.
    register : int
        Stages of the shift register, 2 to 16; the period is 2^register - 1 values.
    hold : int
        Samples for which each value is held.

    Notes
    -----
    The first value comes from the generator, by a shift along the period; the rest follows.
    """

    amplitude: float
    register: int = 10
    hold: int = 1

    def __post_init__(self) -> None:
        non_negative("amplitude", self.amplitude)
        least, most = min(_FEEDBACK), max(_FEEDBACK)
        require(
            least <= self.register <= most,
            f"a register of {least} to {most} stages",
            f"register={self.register}",
        )
        require(self.hold >= 1, "hold of 1 or more", f"hold={self.hold}")

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """A stretch of the sequence."""
        del step_s
        period = maximal_sequence(self.register)
        start = int(rng.integers(period.size))
        return self.amplitude * period[(start + np.arange(count) // self.hold) % period.size]


@dataclass(frozen=True, slots=True)
class Steps(Excitation):
    """Levels that are held one after the other, over and over.

    Parameters
    ----------
    levels : tuple of float
        In the order in which they come.
    dwell_s : float
        Time on each [s].
    """

    levels: tuple[float, ...]
    dwell_s: float

    def __post_init__(self) -> None:
        given("levels", self.levels)
        finite("level", *self.levels)
        positive("dwell_s", self.dwell_s)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        del rng
        # A step that falls on a sample, but for rounding, is taken there.
        number = np.floor(np.arange(count) * (step_s / self.dwell_s) + 1e-9).astype(np.int64)
        return np.array(self.levels)[number % len(self.levels)]


@dataclass(frozen=True, slots=True)
class GivenSeries(Excitation):
    """A user's own series, from its beginning.

    Parameters
    ----------
    values : tuple of float
        At the rate of the record, at least as many as it has samples.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        given("values", self.values)
        finite("value", *self.values)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        del step_s, rng
        require(
            len(self.values) >= count,
            f"a series of {count} values or more, as many as the record has samples",
            f"{len(self.values)}",
            "Give a longer one, or ask for fewer samples.",
        )
        return np.array(self.values[:count])


@dataclass(frozen=True, slots=True)
class ScaledExcitation(Excitation):
    """Another excitation, scaled to a standard deviation that each realisation has exactly.

    Parameters
    ----------
    series : Excitation
        Its shape.
    std : float
        Standard deviation over the record.
    """

    series: Excitation
    std: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        series = self.series.sample(count, step_s, rng)
        spread = float(series.std())
        require(spread > 0.0, "a series that varies, since it is to be scaled", "a constant one")
        return self.std / spread * series


#: Stages whose sum feeds the register, from its length: primitive polynomials over the integers modulo 2.
_FEEDBACK = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 11, 10, 4),
    13: (13, 12, 11, 8),
    14: (14, 13, 12, 2),
    15: (15, 14),
    16: (16, 15, 13, 4),
}


def maximal_sequence(register: int) -> Float[np.ndarray, " period"]:
    """One period of the maximal binary sequence of plus and minus one. Performs no checks."""
    stages = [1] * register
    period = np.empty((1 << register) - 1)
    for k in range(period.size):
        period[k] = 2.0 * stages[-1] - 1.0
        fed = 0
        for stage in _FEEDBACK[register]:
            fed ^= stages[stage - 1]
        stages = [fed, *stages[:-1]]
    return period


def _check_band(low_hz: float, high_hz: float) -> None:
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


def _bins(count: int, step_s: float, low_hz: float, high_hz: float) -> np.ndarray:
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
