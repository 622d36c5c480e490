"""Estimating equations at a solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.errors import CollinearError
from eivor.tools import Float, Int


@dataclass(frozen=True)
class EquationRows:
    """Successive rows of an estimating equation, in coordinates of its own."""

    test_functions: Float[np.ndarray, "rows n"]
    residual: Float[np.ndarray, " rows"]
    scores: Float[np.ndarray, "samples n"]  # Terms of the equation in time order
    flight_of_row: Int[np.ndarray, " rows"]
    constant: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True)
class EstimatingEquation:
    """Sensitivity of an estimating equation, and its rows."""

    root: Float[np.ndarray, "n n"]  # R, upper triangular
    slope: Float[np.ndarray, "n n"]
    sample_count: int  # Number of scores
    blocks: Callable[[], Iterable[EquationRows]]
    #: What is known beforehand adds so much to the covariance of the sum of scores.
    prior_covariance: Float[np.ndarray, "n n"] | float = 0.0
    move: Float[np.ndarray, " n"] | None = None

    @property
    def unknowns(self) -> int:
        """Length of the joint vector, n."""
        return self.root.shape[0]

    @property
    def sensitivity(self) -> Float[np.ndarray, "n n"]:
        """M, minus the derivative of the sum of the method's own scores by the joint vector."""
        return np.asarray(self.root.T @ self.slope)

    @cached_property
    def rows(self) -> EquationRows:
        """All rows at once, in orthonormal coordinates."""
        parts = list(self.blocks())
        if len(parts) == 1:
            return parts[0]
        names = ("test_functions", "residual", "scores", "flight_of_row")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return EquationRows(**joined, constant=parts[0].constant)

    @property
    def test_functions(self) -> Float[np.ndarray, "rows n"]:
        """The method's own test functions of all rows."""
        return np.asarray(self.rows.test_functions @ self.root)

    @property
    def residual(self) -> Float[np.ndarray, " rows"]:
        """Residual e of all rows."""
        return self.rows.residual

    @property
    def scores(self) -> Float[np.ndarray, "samples n"]:
        """The method's own scores of all samples, in time order."""
        return np.asarray(self.rows.scores @ self.root)

    @cached_property
    def variance(self) -> float:
        """Residual variance s^2 on rows - n degrees of freedom."""
        count, power = 0, 0.0
        for rows in self.blocks():
            count += rows.residual.size
            power += float(rows.residual @ rows.residual)
        return power / max(count - self.unknowns, 1)


def singular_sensitivity() -> CollinearError:
    """Refusal of equations that do not distinguish the parameters from one another."""
    return CollinearError(
        "equations that distinguish every parameter from the others",
        "equations that one of them, or a combination of them, hardly enters",
        "Give data in which response and regressors move, each in its own way.",
    )
