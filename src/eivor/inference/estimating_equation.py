"""Estimating equations: what inference needs to know of an estimate, whatever method made it.

The estimate solves ``sum_t s_t(theta) = 0`` with scores s_t = p_t e_t + constant: test functions p_t times
the residual e_t, and for compensated equations what the measurement noises add to the product on
average, C theta - c. To first order theta_hat - theta = M^-1 sum_t s_t, where the sensitivity M is minus
the derivative of the sum by theta.

Rows come in blocks, in their order, so that nothing as long as the record need be kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class EquationRows:
    """Successive rows of an estimating equation.

    Parameters
    ----------
    test : ndarray, shape (rows, n)
        P, test functions.
    residual : ndarray, shape (rows,)
        e.
    scores : ndarray, shape (samples, n)
        Terms of the equation in time order; as many as rows when rows are samples.
    flight_of_row : ndarray of int, shape (rows,)
        Flight of each row.
    constant : ndarray, shape (n,), optional
        What each row's score has beside p_t e_t; none unless the equations are compensated.
    """

    test: Float[np.ndarray, "rows n"]
    residual: Float[np.ndarray, " rows"]
    scores: Float[np.ndarray, "samples n"]
    flight_of_row: Int[np.ndarray, " rows"]
    constant: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True)
class EstimatingEquation:
    """Sensitivity of an estimating equation, and its rows.

    Parameters
    ----------
    sensitivity : ndarray, shape (n, n)
        M, minus the derivative of the sum of scores by the joint vector.
    sample_count : int
        Number of scores.
    blocks : callable
        Gives the rows in blocks, in order; each call starts anew.
    """

    sensitivity: Float[np.ndarray, "n n"]
    sample_count: int
    blocks: Callable[[], Iterable[EquationRows]]

    @cached_property
    def rows(self) -> EquationRows:
        """All rows at once."""
        parts = list(self.blocks())
        if len(parts) == 1:
            return parts[0]
        return EquationRows(
            np.concatenate([part.test for part in parts]),
            np.concatenate([part.residual for part in parts]),
            np.concatenate([part.scores for part in parts]),
            np.concatenate([part.flight_of_row for part in parts]),
            parts[0].constant,
        )

    @property
    def test(self) -> Float[np.ndarray, "rows n"]:
        """Test functions P of all rows."""
        return self.rows.test

    @property
    def residual(self) -> Float[np.ndarray, " rows"]:
        """Residual e of all rows."""
        return self.rows.residual

    @property
    def scores(self) -> Float[np.ndarray, "samples n"]:
        """Scores of all samples, in time order."""
        return self.rows.scores

    @property
    def flight_of_row(self) -> Int[np.ndarray, " rows"]:
        """Flight of each row."""
        return self.rows.flight_of_row

    @cached_property
    def variance(self) -> float:
        """Residual variance s^2 on rows - n degrees of freedom."""
        count, power = 0, 0.0
        for rows in self.blocks():
            count += rows.residual.size
            power += float(rows.residual @ rows.residual)
        return power / max(count - self.sensitivity.shape[0], 1)
