"""Disturbances of the equation of motion: what moves the machine, or shifts its equation, beside the input.

Each is a recipe for a series; randomness enters only through the generator that is passed to `sample`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.parameter_checks import non_negative


class Disturbance(ABC):
    """A series e(t_k) that enters an equation or the dynamics."""

    @abstractmethod
    def sample(self, count: int, step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation on a grid of that step [s]."""

    @property
    @abstractmethod
    def variance(self) -> float | None:
        """Variance of the stationary series; None when it has none."""


@dataclass(frozen=True, slots=True)
class WhiteDisturbance(Disturbance):
    """Uncorrelated Gaussian series.

    Parameters
    ----------
    std : float
        Standard deviation, in the unit of the equation.

    Raises
    ------
    ParameterError
        When it is negative or not finite.
    """

    std: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Independent normal values."""
        return self.std * rng.standard_normal(count)

    @property
    def variance(self) -> float:
        """Square of `std`."""
        return self.std**2
