"""Least squares by QR of columns scaled to unit length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.errors import CollinearError
from eivor.linalg.system import LinearSystem, ScoreCorrection, Solution, Solver


@dataclass(frozen=True, slots=True)
class LeastSquares(Solver):
    """Minimise ||b - A theta||_2, the paper's (9), without squaring the condition number.

    Cost is O(m n^2); the forward error is governed by the condition number after column scaling.
    """

    def solve(self, system: LinearSystem) -> Solution:
        """Least squares solution, see `Solver.solve`."""
        scale = column_lengths(system.matrix)
        Q, R = np.linalg.qr(system.matrix / scale)
        condition = triangular_condition(R)
        theta = scipy.linalg.solve_triangular(R, Q.T @ system.right) / scale
        residual = system.right - system.matrix @ theta
        return Solution(theta, residual, float(residual @ residual), condition)

    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        error_scale: Float[np.ndarray, " n_plus_1"] | None,  # noqa: ARG002 - the interface's
    ) -> ScoreCorrection:
        """Zeros: least squares puts all of the residual into the response."""
        return ScoreCorrection(np.zeros((residual.size, theta.size)), np.zeros((theta.size, theta.size)))


def column_lengths(matrix: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " n"]:
    """Euclidean length of each column.

    Raises
    ------
    CollinearError
        When a column is zero.
    """
    lengths: Float[np.ndarray, " n"] = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    if not lengths.all():
        raise CollinearError(
            "regressors that vary",
            f"column {int(np.argmin(lengths))} is zero",
            "Remove it, or choose a window in which that channel moves.",
        )
    return lengths


def triangular_condition(R: Float[np.ndarray, "n n"]) -> float:
    """Condition number of the triangular factor of unit-length columns.

    Raises
    ------
    CollinearError
        When it exceeds 1/(n eps): one column is a combination of the others to rounding.
    """
    singular = np.linalg.svd(R, compute_uv=False)
    if singular[-1] <= singular[0] * R.shape[0] * np.finfo(np.float64).eps:
        raise CollinearError(
            "linearly independent regressors",
            f"columns of which one is a combination of the others (singular values {singular})",
            "Remove a column, or give data in which they move independently.",
        )
    return float(singular[0] / singular[-1])
