"""Measurement noises: what is known of the error of a measured channel."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.errors import NonFiniteError


class MeasurementNoise(ABC):
    """Error that a sensor adds to a channel, independent of every signal."""

    @property
    @abstractmethod
    def variance(self) -> float:
        """Variance of one sample, in the square of the channel's unit."""


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
        if not (np.isfinite(self.std) and self.std >= 0.0):
            raise NonFiniteError(
                "a standard deviation of zero or more",
                f"std={self.std}",
                "Give it in the channel's own unit.",
            )

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2
