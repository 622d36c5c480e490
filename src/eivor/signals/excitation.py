"""Excitations: inputs, and references, that make a machine tell its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


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

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation; w exists before the record."""
        w = np.sqrt(self.variance) * rng.standard_normal(count + 2)
        t = step_s * np.arange(count)
        return 0.7 * w[1:-1] + 0.49 * w[:-2] + np.sin(0.1 * t**1.1)
