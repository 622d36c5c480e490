"""Noise models, fractional differences and long memory."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, cast

import msgspec
import numpy as np
import scipy

from eivor import checks
from eivor.errors import NonFiniteError, ParameterError, ShapeError, TooFewSamplesError
from eivor.tools import Complex, Float

#: Longest record whose weights' spectrum is kept for the next one: studies draw many of one length.
KEPT = 1 << 16


def fractional_weights(order: float, count: int) -> Float[np.ndarray, " count"]:
    """Return a_0 ... a_{count-1}. Performs no checks."""
    lags = np.arange(1.0, count)
    return np.concatenate([[1.0], np.cumprod((lags - 1.0 - order) / lags)])


def order_slope(order: float, count: int) -> Float[np.ndarray, " count"]:
    """Derivatives of a_0 ... a_{count-1} by the order: the weights of log(1 - z) Delta^order."""
    logarithm = np.zeros((count, 1))
    logarithm[1:, 0] = -1.0 / np.arange(1.0, count)
    return fractional_difference(logarithm, order)[:, 0]


def fractional_difference(
    values: Float[np.ndarray, "n *columns"], order: float
) -> Float[np.ndarray, "n *columns"]:
    """Fractional difference of each column along the first axis."""
    count = values.shape[0]
    length = padded_length(count)
    response = _kept_response(order, count) if count <= KEPT else _response(order, count)
    spectrum = np.fft.rfft(values, length, axis=0)
    spectrum *= response.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.fft.irfft(spectrum, length, axis=0)[:count])


def padded_length(count: int) -> int:
    """Length without large prime factors at which a convolution of records that long does not wrap around."""
    return int(scipy.fft.next_fast_len(2 * count, real=True))


def _response(order: float, count: int) -> Complex[np.ndarray, " bins"]:
    response = np.fft.rfft(fractional_weights(order, count), padded_length(count))
    response.flags.writeable = False
    return response


_kept_response = lru_cache(maxsize=16)(_response)

BLOCK = 4_096


@dataclass(slots=True)
class GrowthTable:
    """Autocovariance of one order at one lag, block by block."""

    order: float  # Exponent of Delta
    lag: int  # Samples between the two factors
    states: list[tuple[float, float, float]] = field(default_factory=list)  # Before each block

    def stretch(self, start: int, count: int) -> Float[np.ndarray, " count"]:
        """Values for m = start .. start + count - 1."""
        first, last = start // BLOCK, (start + count - 1) // BLOCK
        for number in range(max(len(self.states) - 1, 0), first):
            self._block(number)
        values = np.concatenate([self._block(number) for number in range(first, last + 1)])
        return values[start - first * BLOCK :][:count]

    def _block(self, number: int) -> Float[np.ndarray, " block"]:
        """Values of a block, and the state before the next one."""
        if not self.states:
            self.states.append((0.0, 1.0, float(self._weights(0, 1.0, self.lag + 1)[-1])))
        total, a, a_lagged = self.states[number]
        weights = self._weights(number * BLOCK, a)
        lagged = self._weights(number * BLOCK + self.lag, a_lagged)
        products = weights[:BLOCK] * lagged[:BLOCK]
        if len(self.states) == number + 1:
            self.states.append((total + float(np.sum(products)), float(weights[BLOCK]), float(lagged[BLOCK])))
        return np.asarray(total + np.cumsum(products))

    def _weights(self, first: int, value: float, count: int = BLOCK + 1) -> Float[np.ndarray, " count"]:
        j = np.arange(first + 1, first + count)
        return np.cumprod(np.concatenate([[value], (j - 1 - self.order) / j]))


#: Table of an order and a lag, shared by all who ask: its content does not depend on who did.
growth_table = lru_cache(maxsize=256)(GrowthTable)


#: Least and largest order of a fractional measurement noise: a random walk, and differences yet invertible.
LEAST_ORDER, LARGEST_ORDER = -1.0, 0.5
#: Largest standard deviation: its square is a number yet.
LARGEST_STD = 1e150


class MeasurementNoise(ABC):
    """Error that a sensor adds to a channel, independent of every signal.

    A `NonFiniteError` says that `std` or an order is outside its range, a `ParameterError` any other number.
    """

    std: float
    """Its size, in the channel's unit: the standard deviation of the white noise that it is made of."""

    def __post_init__(self) -> None:
        checks.number("std", self.std)
        is_valid = np.isfinite(self.std) and self.std >= 0.0
        if not is_valid or self.std > LARGEST_STD:
            expected = f"a standard deviation {f'up to {LARGEST_STD:g}' if is_valid else 'of zero or more'}"
            raise NonFiniteError(expected, f"std={self.std}", "Give it in the channel's own unit.")

    @abstractmethod
    def autocovariance(self, lag: int, start: int, count: int, /) -> Float[np.ndarray, " count"]:
        """E[x(m) x(m + lag)] for m = start .. start + count - 1 samples since the record began."""

    @abstractmethod
    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        """w_0 ... w_{count-1} with x(k) = sum_{m <= k} w_m e(k - m), e white of unit variance, k from 0."""

    @abstractmethod
    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation of the noise of a record that begins with its first sample."""

    def with_std(self, std: float) -> MeasurementNoise:
        """Noise of the same shape with another `std`, see the class for what that is the std of."""
        return cast("MeasurementNoise", replace(cast("Any", self), std=std))


class UncorrelatedNoise(MeasurementNoise):
    """Noise without memory, whatever its distribution."""

    __slots__ = ()

    def autocovariance(self, lag: int, _start: int, count: int, /) -> Float[np.ndarray, " count"]:
        return np.full(count, self.std**2 if lag == 0 else 0.0)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        weights: Float[np.ndarray, " count"] = np.zeros(count)
        weights[0] = self.std
        return weights


@dataclass(frozen=True, slots=True)
class WhiteNoise(UncorrelatedNoise):
    """Uncorrelated noise of constant variance."""

    std: float  # Standard deviation, in the channel's unit

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        return self.std * rng.standard_normal(count)


@dataclass(frozen=True, slots=True)
class FractionalNoise(MeasurementNoise):
    """Delta^order of white noise, started at zero with the record.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square; or the order lies outside
        that range.
    """

    std: float  # Standard deviation of the white noise before the operator, in the channel's unit
    order: float  # Exponent of Delta, from -1 (a random walk) over -0.5 (long memory) to 0.5

    def __post_init__(self) -> None:
        MeasurementNoise.__post_init__(self)
        checks.number("order", self.order)
        if not LEAST_ORDER <= self.order <= LARGEST_ORDER:
            expected = f"an order between {LEAST_ORDER} and {LARGEST_ORDER}"
            remedy = "Integrate or differentiate the channel itself by whole orders first."
            raise NonFiniteError(expected, f"order={self.order}", remedy)

    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        """std^2 sum_{q <= m} a_q a_{q + lag}, from a table that is linear in the record."""
        return self.std**2 * growth_table(self.order, lag).stretch(start, count)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        return self.std * fractional_weights(self.order, count)

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        return self.std * fractional_difference(rng.standard_normal(count), self.order)


@dataclass(frozen=True, slots=True)
class AutoregressiveNoise(MeasurementNoise):
    """x(k) = coefficient x(k-1) + e(k), started at zero with the record.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    ParameterError
        When the coefficient lies outside its range.
    """

    std: float  # Standard deviation that x settles to, in the channel's unit
    coefficient: float  # Between -1 and 1, both left out

    def __post_init__(self) -> None:
        MeasurementNoise.__post_init__(self)
        checks.number("coefficient", self.coefficient)
        if not abs(self.coefficient) < 1.0:
            expected = "a coefficient between -1 and 1, both left out"
            received = f"coefficient={self.coefficient}"
            raise ParameterError(expected, received, "Give FractionalNoise(std, -1) for a random walk.")

    @property
    def innovation_std(self) -> float:
        """Standard deviation of e."""
        return float(self.std * np.sqrt(1.0 - self.coefficient**2))

    def autocovariance(self, lag: int, start: int, count: int, /) -> Float[np.ndarray, " count"]:
        """std^2 coefficient^lag (1 - coefficient^(2 m + 2)) at the m-th sample."""
        ages = np.arange(start + 1.0, start + count + 1.0)
        grown: Float[np.ndarray, " count"] = 1.0 - (self.coefficient**2) ** ages
        return self.std**2 * self.coefficient**lag * grown

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        return np.asarray(self.innovation_std * self.coefficient ** np.arange(count))

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        return np.asarray(
            scipy.signal.lfilter([self.innovation_std], [1.0, -self.coefficient], rng.standard_normal(count))
        )


@dataclass(frozen=True, slots=True)
class HeavyTailedNoise(UncorrelatedNoise):
    """Uncorrelated noise with the tails of Student's t.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    ParameterError
        When there are too few degrees of freedom.
    """

    std: float  # Standard deviation, in the channel's unit
    degrees: float = 3.0  # Degrees of freedom, more than two: with fewer there is no standard deviation

    def __post_init__(self) -> None:
        MeasurementNoise.__post_init__(self)
        checks.number("degrees", self.degrees)
        if not 2.0 < self.degrees < np.inf:
            expected = "more than two degrees of freedom, and finitely many"
            received = f"degrees={self.degrees}"
            raise ParameterError(expected, received, "Give 3 for heavy tails, WhiteNoise for normal noise.")

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        scale = self.std * np.sqrt((self.degrees - 2.0) / self.degrees)
        return scale * rng.standard_t(self.degrees, count)


@dataclass(frozen=True, slots=True)
class RoundingNoise(UncorrelatedNoise):
    """What rounding to multiples of a step adds, as uncorrelated values between half a step down and up.

    The usual model of a converter's quantisation: it holds where the channel moves by more than a step from
    one sample to the next.
    """

    std: float  # Step over the root of twelve, in the channel's unit

    @property
    def step(self) -> float:
        """Of the rounding, in the channel's unit."""
        return float(self.std * np.sqrt(12.0))

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        return self.step * (rng.random(count) - 0.5)


#: Fewest frequencies from which an order is estimated.
LEAST_BANDWIDTH = 8
#: Share of the record's length, as an exponent, that the default number of frequencies has.
BANDWIDTH_EXPONENT = 0.65
#: Orders that are searched: twice what a measurement noise may have.
SEARCHED = (-1.0, 1.0)
#: Accuracy of the one that is found.
CONVERGED = 1e-14
#: Steps of the search at most, and a variance that is none.
MOST_STEPS, TINY = 100, sys.float_info.min


class LongMemory(msgspec.Struct, frozen=True):
    """Estimate of a fractional noise."""

    order: float  # Exponent of Delta
    order_error: float  # Its standard error
    std: float  # Standard deviation of the white noise before the operator, in the channel's unit
    std_error: float  # Its standard error, the order being estimated too
    bandwidth: int  # Number of frequencies that were used

    @property
    def memory(self) -> float:
        """Memory parameter d = -order of the literature."""
        return -self.order

    def noise(self) -> FractionalNoise:
        """Noise to declare of the channel: the estimate, with an order that a noise can have."""
        return FractionalNoise(self.std, float(np.clip(self.order, LEAST_ORDER, LARGEST_ORDER)))


def estimate_long_memory(values: Float[np.ndarray, " n"], *, bandwidth: int | None = None) -> LongMemory:
    """Estimate order and strength of a fractional noise from a record at rest.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Uniformly sampled record of a machine that does not move.
    bandwidth : int, optional
        Number m of lowest frequencies, up to (n - 1) // 2. Default: n^0.65, which keeps away from what
        else shapes the spectrum at high frequencies. If the noise is fractional and nothing else, every
        frequency is best.

    Raises
    ------
    DataError, ShapeError
        When the values are no real numbers, or not those of one record.
    NonFiniteError
        When a value is not finite.
    TooFewSamplesError
        When the record has fewer than 8 frequencies.
    ParameterError
        When the bandwidth is out of range, or the record constant.

    Notes
    -----
    One FFT and a convex search: 1e6 samples take a quarter of a second.
    """
    values = checks.real_array("values", values)
    if values.ndim != 1:
        raise ShapeError("a record of shape (n,)", f"shape {values.shape}", "Give one channel at a time.")
    if bandwidth is not None:
        checks.whole("bandwidth", bandwidth)
    if not np.isfinite(values).all():
        remedy = "Cut the record to a stretch without gaps."
        raise NonFiniteError("a record of finite values", "NaN or infinity in it", remedy)
    last = (values.size - 1) // 2
    if last < LEAST_BANDWIDTH:
        expected = f"{2 * LEAST_BANDWIDTH + 1} samples or more"
        raise TooFewSamplesError(expected, f"{values.size}", "Record the machine at rest for longer.")
    m = max(LEAST_BANDWIDTH, int(values.size**BANDWIDTH_EXPONENT)) if bandwidth is None else bandwidth
    if not LEAST_BANDWIDTH <= m <= last:
        raise ParameterError(
            f"a bandwidth from {LEAST_BANDWIDTH} to {last} frequencies", f"bandwidth={m}", "Choose another."
        )
    power = np.abs(np.fft.rfft(values - values.mean())[1 : m + 1]) ** 2 / values.size
    if not power.max() > (np.finfo(np.float64).eps * np.abs(values).max()) ** 2:
        received = "a constant one"
        raise ParameterError("a record that varies", received, "Use one with the sensor's full resolution.")
    return _whittle(power, np.log(2.0 * np.sin(np.pi * np.arange(1, m + 1) / values.size)))


def _whittle(power: Float[np.ndarray, " m"], log_gain: Float[np.ndarray, " m"]) -> LongMemory:
    """Minimum of the concentrated likelihood, log mean(power g^(-2 order)) + 2 order mean(log g)."""
    nu = log_gain - log_gain.mean()
    log_power = np.log(np.maximum(power, TINY))
    order, (low, high) = 0.0, SEARCHED
    for _ in range(MOST_STEPS):  # of Newton, or to the middle of where the slope changes its sign
        weights = log_power - 2.0 * order * nu
        weights = np.exp(weights - weights.max())
        weights /= weights.sum()
        slope = float(weights @ nu)
        low, high = (order, high) if slope > 0.0 else (low, order)
        previous, order = order, order + 0.5 * slope / max(float(weights @ (nu - slope) ** 2), TINY)
        if not low <= order <= high:
            order = 0.5 * (low + high)
        if abs(order - previous) <= CONVERGED:
            break
    scaled = log_power - 2.0 * order * log_gain
    top = float(scaled.max())
    variance = float(np.exp(top)) * float(np.exp(scaled - top).mean())
    information = float(nu @ nu)
    relative = np.sqrt(1.0 / power.size + float(log_gain.mean()) ** 2 / information)
    std = float(np.sqrt(variance))
    return LongMemory(order, 0.5 / float(np.sqrt(information)), std, 0.5 * std * float(relative), power.size)
