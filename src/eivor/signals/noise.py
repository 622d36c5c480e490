"""Measurement noises: what is known of the error of a measured channel.

A noise says what covariance two samples of it have, `lag` apart, at each time since its record began:
fractional noise starts at zero with the record and is not stationary, so that sample averages over the
rows that are used have to take its age into account.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import NonFiniteError
from eivor.signals.fractional_growth import growth_table

#: Largest order, in absolute value, of a fractional measurement noise.
LARGEST_ORDER = 0.5


class MeasurementNoise(ABC):
    """Error that a sensor adds to a channel, independent of every signal."""

    @abstractmethod
    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        """E[x(m) x(m + lag)] for m = start .. start + count - 1 samples since the record began.

        In the square of the channel's unit; `lag` is zero or more.
        """


@dataclass(frozen=True, slots=True)
class WhiteNoise(MeasurementNoise):
    """Uncorrelated noise of constant variance.

    Parameters
    ----------
    std : float
        Standard deviation, in the channel's unit.

    Raises
    ------
    NonFiniteError
        When `std` is negative or not finite.
    """

    std: float

    def __post_init__(self) -> None:
        _check_std(self.std)

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2

    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        """`variance` at lag zero, nothing else."""
        del start
        return np.full(count, self.variance if lag == 0 else 0.0)


@dataclass(frozen=True, slots=True)
class FractionalNoise(MeasurementNoise):
    """Delta^order of white noise, started at zero with the record.

    Parameters
    ----------
    std : float
        Standard deviation of the white noise before the operator, in the channel's unit.
    order : float
        Exponent of Delta, from -0.5 (long memory) to 0.5.

    Raises
    ------
    NonFiniteError
        When `std` is negative or the order lies outside that range.
    """

    std: float
    order: float

    def __post_init__(self) -> None:
        _check_std(self.std)
        if not abs(self.order) <= LARGEST_ORDER:
            raise NonFiniteError(
                f"an order between -{LARGEST_ORDER} and {LARGEST_ORDER}",
                f"order={self.order}",
                "Integrate or differentiate the channel itself by whole orders first.",
            )

    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        """std^2 sum_{q <= m} a_q a_{q + lag}, from a table that is linear in the record."""
        return self.std**2 * growth_table(self.order, lag).stretch(start, count)


def _check_std(std: float) -> None:
    if not (np.isfinite(std) and std >= 0.0):
        raise NonFiniteError(
            "a standard deviation of zero or more", f"std={std}", "Give it in the channel's own unit."
        )
