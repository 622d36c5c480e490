"""Measurement noises: what is known of the error of a measured channel.

A noise says what covariance two samples of it have, `lag` apart, at each time since its record began:
fractional noise starts at zero with the record and is not stationary, so that sample averages over the
rows that are used have to take its age into account.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from eivor import checks
from eivor.errors import NonFiniteError
from eivor.shapes import Float
from eivor.signals.fractional import fractional_difference, fractional_weights
from eivor.signals.fractional_growth import growth_table

#: Least and largest order of a fractional measurement noise: a random walk, and differences yet invertible.
LEAST_ORDER, LARGEST_ORDER = -1.0, 0.5
#: Largest standard deviation: its square is a number yet.
LARGEST_STD = 1e150


class MeasurementNoise(ABC):
    """Error that a sensor adds to a channel, independent of every signal."""

    std: float
    """Its size, in the channel's unit: the standard deviation of the white noise that it is made of."""

    @abstractmethod
    def autocovariance(self, lag: int, start: int, count: int, /) -> Float[np.ndarray, " count"]:
        """E[x(m) x(m + lag)] for m = start .. start + count - 1 samples since the record began.

        In the square of the channel's unit; `lag` is zero or more.
        """

    @abstractmethod
    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        """w_0 ... w_{count-1} with x(k) = sum_{m <= k} w_m e(k - m), e white of unit variance, k from 0."""

    @abstractmethod
    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation of the noise of a record that begins with its first sample.

        Equal generators give noises that are proportional to their std, sample by sample.
        """

    @abstractmethod
    def with_std(self, std: float) -> MeasurementNoise:
        """Noise of the same shape with another `std`, see the class for what that is the std of."""


class UncorrelatedNoise(MeasurementNoise):
    """Noise without memory, whatever its distribution."""

    __slots__ = ()

    def autocovariance(self, lag: int, _start: int, count: int, /) -> Float[np.ndarray, " count"]:
        """std^2 at lag zero, nothing else."""
        return np.full(count, self.std**2 if lag == 0 else 0.0)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        """`std`, and zeros."""
        weights: Float[np.ndarray, " count"] = np.zeros(count)
        weights[0] = self.std
        return weights


@dataclass(frozen=True, slots=True)
class WhiteNoise(UncorrelatedNoise):
    """Uncorrelated noise of constant variance.

    Parameters
    ----------
    std : float
        Standard deviation, in the channel's unit.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    """

    std: float

    def __post_init__(self) -> None:
        check_std(self.std)

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Independent normal values."""
        return self.std * rng.standard_normal(count)

    def with_std(self, std: float) -> WhiteNoise:
        """White noise of that standard deviation."""
        return WhiteNoise(std)


@dataclass(frozen=True, slots=True)
class FractionalNoise(MeasurementNoise):
    """Delta^order of white noise, started at zero with the record.

    Parameters
    ----------
    std : float
        Standard deviation of the white noise before the operator, in the channel's unit.
    order : float
        Exponent of Delta, from -1 (a random walk) over -0.5 (long memory) to 0.5.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square; or the order lies outside
        that range.
    """

    std: float
    order: float

    def __post_init__(self) -> None:
        check_std(self.std)
        checks.number("order", self.order)
        if not LEAST_ORDER <= self.order <= LARGEST_ORDER:
            raise NonFiniteError(
                f"an order between {LEAST_ORDER} and {LARGEST_ORDER}",
                f"order={self.order}",
                "Integrate or differentiate the channel itself by whole orders first.",
            )

    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        """std^2 sum_{q <= m} a_q a_{q + lag}, from a table that is linear in the record."""
        return self.std**2 * growth_table(self.order, lag).stretch(start, count)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        """Weights of Delta^order, times `std`."""
        return self.std * fractional_weights(self.order, count)

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Delta^order of independent normal values, zero before the record."""
        return self.std * fractional_difference(rng.standard_normal(count), self.order)

    def with_std(self, std: float) -> FractionalNoise:
        """Same order; `std` is that of the white noise before the operator."""
        return replace(self, std=std)


def check_std(std: float) -> None:
    """Check a standard deviation: finite, zero or more, and with a square."""
    checks.number("std", std)
    if not (np.isfinite(std) and std >= 0.0):
        raise NonFiniteError(
            "a standard deviation of zero or more", f"std={std}", "Give it in the channel's own unit."
        )
    if std > LARGEST_STD:
        raise NonFiniteError(
            f"a standard deviation up to {LARGEST_STD:g}", f"std={std}", "Give it in the channel's own unit."
        )
