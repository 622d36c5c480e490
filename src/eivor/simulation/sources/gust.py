"""A stationary Ornstein-Uhlenbeck process: gusts along the wind, and whatever forgets exponentially."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.parameter_checks import non_negative, positive
from eivor.simulation.sources.recursion import autoregression, constant


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeck(Disturbance):
    """Normal series whose correlation falls exponentially; the longitudinal turbulence of MIL-F-8785C.

    Parameters
    ----------
    std : float
        Standard deviation, in the unit of what it disturbs.
    correlation_s : float
        Time in which the correlation falls to 1/e [s].

    Raises
    ------
    ParameterError
        When a number is out of range.
    """

    std: float
    correlation_s: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)
        positive("correlation_s", self.correlation_s)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation, stationary from its first sample."""
        decay = float(np.exp(-step_s / self.correlation_s))
        shocks = rng.standard_normal(count)
        shocks[1:] *= np.sqrt(1.0 - decay**2)
        return self.std * autoregression(shocks, constant((decay,), count))

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2
