"""Dryden gusts: the vertical turbulence of MIL-F-8785C, sampled exactly.

With tau = length / airspeed, white noise behind

    H(s) ~ (1 + sqrt(3) tau s) / (1 + tau s)^2

has the variance std^2 and the correlation exp(-t/tau) (1 - t / (2 tau)). Its state is that of two equal
lags in series, p' = (n - p) / tau and q' = (p - q) / tau, and the gust is sqrt(3) p + (1 - sqrt(3)) q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.parameter_checks import non_negative, positive
from eivor.simulation.sources.recursion import autoregression, constant


@dataclass(frozen=True, slots=True)
class DrydenGust(Disturbance):
    """Vertical turbulence that a vehicle flies through.

    Parameters
    ----------
    std : float
        In the unit of the equation: a vertical wind of W [m/s] pushes with K W [m/s^2].
    length_m : float
        Scale length of the turbulence [m]; close to the ground, the height.
    airspeed_mps : float
        Speed at which it is met [m/s].

    Raises
    ------
    ParameterError
        When a number is out of range.
    """

    std: float
    length_m: float
    airspeed_mps: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)
        positive("length_m", self.length_m)
        positive("airspeed_mps", self.airspeed_mps)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation, stationary from its first sample."""
        from scipy.special import gammainc

        x = step_s * self.airspeed_mps / self.length_m
        shocks = rng.standard_normal((2, count))
        # Covariance of what one step adds to (p, q): incomplete gamma functions, exact for small steps.
        added = np.array([0.5, 0.25, 0.25]) * gammainc([1.0, 2.0, 3.0], 2.0 * x)
        own = np.sqrt(added[0])
        shared = added[1] / own
        rest = np.sqrt(max(added[2] - shared**2, 0.0))
        decay = float(np.exp(-x))
        driven = own * shocks[0]
        driven[0] = np.sqrt(0.5) * shocks[0, 0]
        first = autoregression(driven, constant((decay,), count))
        driven = shared * shocks[0] + rest * shocks[1]
        driven[1:] += x * decay * first[:-1]
        driven[0] = np.sqrt(0.125) * (shocks[0, 0] + shocks[1, 0])
        second = autoregression(driven, constant((decay,), count))
        return self.std * (np.sqrt(3.0) * first + (1.0 - np.sqrt(3.0)) * second)

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2
