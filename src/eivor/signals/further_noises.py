"""Measurement noises that are neither white and normal nor fractional."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.shapes import Float
from eivor.signals.noise import MeasurementNoise, UncorrelatedNoise, check_std


@dataclass(frozen=True, slots=True)
class AutoregressiveNoise(MeasurementNoise):
    """x(k) = coefficient x(k-1) + e(k), started at zero with the record.

    Parameters
    ----------
    std : float
        Standard deviation that x settles to, in the channel's unit.
    coefficient : float
        Between -1 and 1, both left out.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    ParameterError
        When the coefficient lies outside its range.
    """

    std: float
    coefficient: float

    def __post_init__(self) -> None:
        check_std(self.std)
        checks.number("coefficient", self.coefficient)
        if not abs(self.coefficient) < 1.0:
            raise ParameterError(
                "a coefficient between -1 and 1, both left out",
                f"coefficient={self.coefficient}",
                "Give FractionalNoise(std, -1) for a random walk.",
            )

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
        """Powers of the coefficient, times the standard deviation of e."""
        weights: Float[np.ndarray, " count"] = self.innovation_std * self.coefficient ** np.arange(count)
        return weights

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Normal innovations, filtered."""
        from scipy.signal import lfilter

        series: Float[np.ndarray, " count"] = lfilter(
            [self.innovation_std], [1.0, -self.coefficient], rng.standard_normal(count)
        )
        return series

    def with_std(self, std: float) -> AutoregressiveNoise:
        """Same coefficient."""
        return replace(self, std=std)


@dataclass(frozen=True, slots=True)
class HeavyTailedNoise(UncorrelatedNoise):
    """Uncorrelated noise with the tails of Student's t.

    Parameters
    ----------
    std : float
        Standard deviation, in the channel's unit.
    degrees : float
        Degrees of freedom, more than two: with fewer there is no standard deviation.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    ParameterError
        When there are too few degrees of freedom.
    """

    std: float
    degrees: float = 3.0

    def __post_init__(self) -> None:
        check_std(self.std)
        checks.number("degrees", self.degrees)
        if not 2.0 < self.degrees < np.inf:
            raise ParameterError(
                "more than two degrees of freedom, and finitely many",
                f"degrees={self.degrees}",
                "Give 3 for heavy tails, WhiteNoise for normal noise.",
            )

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Independent values of Student's t, scaled."""
        scale = self.std * np.sqrt((self.degrees - 2.0) / self.degrees)
        return scale * rng.standard_t(self.degrees, count)

    def with_std(self, std: float) -> HeavyTailedNoise:
        """Same tails."""
        return replace(self, std=std)


@dataclass(frozen=True, slots=True)
class RoundingNoise(UncorrelatedNoise):
    """What rounding to multiples of a step adds, as uncorrelated values between half a step down and up.

    The usual model of a converter's quantisation: it holds where the channel moves by more than a step from
    one sample to the next.

    Parameters
    ----------
    std : float
        Step over the root of twelve, in the channel's unit.

    Raises
    ------
    NonFiniteError
        When `std` is negative, not finite, or so large that it has no square.
    """

    std: float

    def __post_init__(self) -> None:
        check_std(self.std)

    @property
    def step(self) -> float:
        """Of the rounding, in the channel's unit."""
        return float(self.std * np.sqrt(12.0))

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Independent values, uniform over a step."""
        return self.step * (rng.random(count) - 0.5)

    def with_std(self, std: float) -> RoundingNoise:
        """Of another step."""
        return RoundingNoise(std)
