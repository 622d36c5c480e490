"""Excitation and disturbance signals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
import scipy

from eivor.checks import finite, given, in_ranges, non_negative, positive, require
from eivor.errors import ParameterError
from eivor.tools import Bool, Float


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a count below `least`."""
    require(value >= least, f"{name} of {least} or more", f"{name}={value}")


def equally_many(name: str, values: tuple[object, ...], other_name: str, others: tuple[object, ...]) -> None:
    """Refuse lists of unequal length."""
    received = f"{len(others)} {other_name} and {len(values)} {name}"
    require(len(values) == len(others), f"as many {other_name} as {name}", received)


#: A number of zero or more, above zero, of any size; several of any size.
Size: TypeAlias = Annotated[float, non_negative]
Positive: TypeAlias = Annotated[float, positive]
Finite: TypeAlias = Annotated[float, finite]


class Excitation(ABC):
    """A series on a uniform grid."""

    def __post_init__(self) -> None:
        in_ranges(self)
        self._check()

    def _check(self) -> None:  # noqa: B027 - most have nothing to refuse
        """Refuse what ranges cannot say."""

    @abstractmethod
    def sample(self, count: int, step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation on a grid of that step [s]."""


@dataclass(frozen=True, slots=True)
class PaperInput(Excitation):
    """The paper's (35): u(t_k) = 0.7 w(t_{k-1}) + 0.49 w(t_{k-2}) + sin(0.1 t_k^1.1), t in seconds."""

    variance: Size = 0.02  # Variance of the white sequence w

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        w = np.sqrt(self.variance) * rng.standard_normal(count + 2)
        t = step_s * np.arange(count)
        return 0.7 * w[1:-1] + 0.49 * w[:-2] + np.sin(0.1 * t**1.1)


@dataclass(frozen=True, slots=True)
class WhiteExcitation(Excitation):
    """Independent normal values."""

    std: Size = 1.0  # Standard deviation

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        return self.std * rng.standard_normal(count)


@dataclass(frozen=True, slots=True)
class SteppedExcitation(Excitation):
    """Levels that are held one after the other, over and over."""

    levels: Annotated[tuple[float, ...], given, (finite, "level")]  # In the order in which they come
    dwell_s: Positive  # Time on each [s]

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        # A step that falls on a sample, but for rounding, is taken there.
        number = np.floor(np.arange(count) * (step_s / self.dwell_s) + 1e-9).astype(np.int64)
        return np.array(self.levels)[number % len(self.levels)]


@dataclass(frozen=True, slots=True)
class RandomSteps(Excitation):
    """Levels drawn one after the other: an amplitude up, down, or nothing."""

    amplitude: Size  # Of the levels that are not zero; those are two in three
    shortest_s: Positive = 0.5  # Between these, each level's time is drawn [s]
    longest_s: Finite = 1.5

    def _check(self) -> None:
        received = f"shortest_s={self.shortest_s}, longest_s={self.longest_s}"
        require(self.shortest_s <= self.longest_s, "a shortest_s up to longest_s", received)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        count_limit = int(count * step_s / self.shortest_s) + 1
        ends = np.cumsum(rng.uniform(self.shortest_s, self.longest_s, count_limit))
        levels = self.amplitude * rng.integers(-1, 2, count_limit + 1).astype(np.float64)
        levels[0] = 0.0
        return levels[np.searchsorted(ends, step_s * np.arange(count), side="right")]


@dataclass(frozen=True, slots=True)
class GivenSeries(Excitation):
    """A user's own series, from its beginning."""

    # At the rate of the record, at least as many as it has samples
    values: Annotated[tuple[float, ...], given, (finite, "value")]

    def sample(self, count: int, _step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        expected = f"a series of {count} values or more, as many as the record has samples"
        remedy = "Give a longer one, or ask for fewer samples."
        require(len(self.values) >= count, expected, f"{len(self.values)}", remedy)
        return np.array(self.values[:count])


@dataclass(frozen=True, slots=True)
class ScaledExcitation(Excitation):
    """Another excitation, scaled to a standard deviation that each realisation has exactly."""

    series: Excitation  # Its shape
    std: Size  # Standard deviation over the record

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        series = self.series.sample(count, step_s, rng)
        spread = float(series.std())
        require(spread > 0.0, "a series that varies, since it is to be scaled", "a constant one")
        return self.std / spread * series


class _Band(Excitation):
    """A series within a band of frequencies."""

    low_hz: float
    high_hz: float

    def _check(self) -> None:
        received = f"low_hz={self.low_hz}, high_hz={self.high_hz}"
        require(self.low_hz <= self.high_hz, "a low_hz up to high_hz", received)


@dataclass(frozen=True, slots=True)
class FilteredWhite(_Band):
    """White noise with nothing outside a band, to rounding.

    Filtered in the frequency domain: the series is periodic with the record. Mean zero.
    """

    std: Size  # Standard deviation in the mean over realisations
    # The band [Hz], both ends included. It must hold a multiple of one over the record's duration, and end
    # below half the rate
    low_hz: Size
    high_hz: Positive

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        spectrum = np.fft.rfft(rng.standard_normal(count))
        inside = _bins(count, step_s, self.low_hz, self.high_hz)
        spectrum[~inside] = 0.0
        return self.std * np.sqrt(0.5 * count / inside.sum()) * np.fft.irfft(spectrum, count)


@dataclass(frozen=True, slots=True)
class Chirp(_Band):
    """A sinus whose frequency grows linearly from one end of a band to the other over the record."""

    amplitude: Size  # Its peak
    low_hz: Size  # The band [Hz], which must end below half the rate
    high_hz: Positive

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        _check_rate(self.high_hz, step_s)
        t, duration = step_s * np.arange(count), step_s * count
        turns = self.low_hz * t + 0.5 * (self.high_hz - self.low_hz) * t**2 / duration
        return self.amplitude * np.sin(2.0 * np.pi * turns)


@dataclass(frozen=True, slots=True)
class Multisine(_Band):
    """Equal sinusoids at every multiple of one over the record's duration in a band.

    Schroeder's phases, -pi m (m - 1) / M for the m-th of M, keep the peak low: about 1.8 times the standard
    deviation, as a chirp's (1.41) rather than as noise's.
    """

    std: Size  # Standard deviation of the sum over the record
    low_hz: Size  # The band [Hz], both ends included, as of filtered white noise
    high_hz: Positive

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        inside = _bins(count, step_s, self.low_hz, self.high_hz)
        lines = int(inside.sum())
        numbers = np.arange(1, lines + 1)
        spectrum = np.zeros(inside.size, dtype=np.complex128)
        spectrum[inside] = np.exp(-1j * np.pi * numbers * (numbers - 1) / lines)
        return self.std * count / np.sqrt(2.0 * lines) * np.fft.irfft(spectrum, count)


def _check_rate(high_hz: float, step_s: float) -> None:
    expected = "a band that ends below half the rate"
    received = f"high_hz={high_hz} at {1.0 / step_s:.6g} Hz"
    require(high_hz < 0.5 / step_s, expected, received, "Lower it, or raise the rate.")


def _bins(count: int, step_s: float, low_hz: float, high_hz: float) -> Bool[np.ndarray, " bins"]:
    """Mask of the bins of the real FFT within the band, without the mean."""
    _check_rate(high_hz, step_s)
    frequencies = np.fft.rfftfreq(count, step_s)
    tolerance = 1e-9 / (count * step_s)
    inside = (frequencies >= low_hz - tolerance) & (frequencies <= high_hz + tolerance) & (frequencies > 0.0)
    if not inside.any():
        expected = f"a band that holds a multiple of {1.0 / (count * step_s):.6g} Hz, one over the duration"
        received = f"low_hz={low_hz}, high_hz={high_hz}"
        raise ParameterError(expected, received, "Widen it, or make the record longer.")
    return inside


#: Stages whose sum feeds the register besides the last, from its length: primitive polynomials modulo 2.
_TAPS = dict.fromkeys(range(2, 17), (1,)) | {
    5: (2,),
    8: (2, 3, 4),
    9: (4,),
    10: (3,),
    11: (2,),
    12: (1, 2, 8),
    13: (1, 2, 5),
    14: (1, 2, 12),
    16: (1, 3, 12),
}


@dataclass(frozen=True, slots=True)
class PseudoRandomBinary(Excitation):
    """Pseudo-random binary sequence of maximal length, at plus or minus an amplitude.

    The first value comes from the generator, by a shift along the period; the rest follows.
    """

    amplitude: Size  # Absolute value at every sample
    register: int = 10  # Stages of the shift register, 2 to 16; the period is 2^register - 1 values
    hold: int = 1  # Samples for which each value is held

    def _check(self) -> None:
        low, high = min(_TAPS), max(_TAPS)
        expected = f"a register of {low} to {high} stages"
        require(low <= self.register <= high, expected, f"register={self.register}")
        require(self.hold >= 1, "hold of 1 or more", f"hold={self.hold}")

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        period = maximal_sequence(self.register)
        start = int(rng.integers(period.size))
        return self.amplitude * period[(start + np.arange(count) // self.hold) % period.size]


def maximal_sequence(register: int) -> Float[np.ndarray, " period"]:
    """One period of the maximal binary sequence of plus and minus one. Performs no checks."""
    return 2.0 * scipy.signal.max_len_seq(register, taps=_TAPS[register])[0] - 1.0


class Disturbance(Excitation):
    """A series e(t_k) that enters an equation or the dynamics."""


@dataclass(frozen=True, slots=True)
class WhiteDisturbance(WhiteExcitation, Disturbance):
    """Uncorrelated Gaussian series."""

    std: Size  # Standard deviation, in the unit of the equation


def autoregression(
    shocks: Float[np.ndarray, "n *records"], coefficients: Float[np.ndarray, "n lags"]
) -> Float[np.ndarray, "n *records"]:
    """x[k] = shocks[k] + sum_i coefficients[k, i] x[k - 1 - i], with zeros before the record."""
    count, lags = shocks.shape[0], min(coefficients.shape[1], max(shocks.shape[0] - 1, 0))
    if lags == 0:
        return shocks.copy()
    band = np.zeros((lags + 1, count))
    band[0] = 1.0
    for i in range(1, lags + 1):
        band[i, : count - i] = -coefficients[i:, i - 1]
    right = shocks.reshape(count, -1)
    return np.asarray(scipy.linalg.lapack.dtbtrs(band, right, uplo="L", diag="U")[0]).reshape(shocks.shape)


def constant(coefficients: tuple[float, ...], count: int) -> Float[np.ndarray, "n lags"]:
    """Constant coefficients at every sample."""
    return np.broadcast_to(np.array(coefficients, dtype=np.float64), (count, len(coefficients)))


def largest_root(coefficients: Float[np.ndarray, " lags"]) -> float:
    """Modulus of the slowest mode of x[k] = sum_i c[i] x[k - 1 - i]; below one when it dies out."""
    if coefficients.size == 0:
        return 0.0
    return float(np.abs(np.roots(np.concatenate([[1.0], -coefficients]))).max(initial=0.0))


@dataclass(frozen=True, slots=True)
class DrydenGust(Disturbance):
    """Vertical turbulence that a vehicle flies through."""

    std: Size  # In the unit of the equation: a vertical wind of W [m/s] pushes with K W [m/s^2]
    length_m: Positive  # Scale length of the turbulence [m]; close to the ground, the height
    airspeed_mps: Positive  # Speed at which it is met [m/s]

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        x = step_s * self.airspeed_mps / self.length_m
        shocks = rng.standard_normal((2, count))
        # Covariance of the increments of (p, q) in a step: incomplete gamma functions, exact for small steps.
        covariance = np.array([0.5, 0.25, 0.25]) * scipy.special.gammainc([1.0, 2.0, 3.0], 2.0 * x)
        std = np.sqrt(covariance[0])
        cross = covariance[1] / std
        remainder = np.sqrt(max(covariance[2] - cross**2, 0.0))
        decay = float(np.exp(-x))
        driven = std * shocks[0]
        driven[0] = np.sqrt(0.5) * shocks[0, 0]
        first = autoregression(driven, constant((decay,), count))
        driven = cross * shocks[0] + remainder * shocks[1]
        driven[1:] += x * decay * first[:-1]
        driven[0] = np.sqrt(0.125) * (shocks[0, 0] + shocks[1, 0])
        second = autoregression(driven, constant((decay,), count))
        return self.std * (np.sqrt(3.0) * first + (1.0 - np.sqrt(3.0)) * second)
