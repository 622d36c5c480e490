"""Least squares: by QR, and through the paper's augmented system.

Columns are scaled to unit length before they are factorised and the solution is scaled back, which does
not change a least squares problem and makes its condition independent of units. Rows are where there are as
many as unknowns: all of them are met, whatever weight each has.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtrs

from eivor.errors import CollinearError
from eivor.linalg.augmented import solve_augmented
from eivor.linalg.system import LinearSystem, ScoreCorrection, Solution, Solver
from eivor.linalg.triangular import triangular_root
from eivor.shapes import Float

#: Share of a solution, and of its standard errors, that rounding may take. A condition number times the
#: rounding of a number is about what it does take.
LARGEST_ROUNDING = 1e-3


class UnweightedScore(Solver):
    """What solvers that put all of the residual into the response have in common."""

    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        _error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None,
        /,
    ) -> ScoreCorrection:
        """Zeros: least squares puts all of the residual into the response."""
        return ScoreCorrection(np.zeros((residual.size, theta.size)), np.zeros((theta.size, theta.size)))


class UnweightedLeastSquares(UnweightedScore):
    """What the ways to solve a least squares problem have in common: all but the last step."""

    @abstractmethod
    def triangular_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], smallest: float, /
    ) -> Float[np.ndarray, " n"]:
        """Solution of R theta = right, given R's smallest singular value."""

    def solve(self, system: LinearSystem) -> Solution:
        """Least squares solution, see `Solver.solve`."""
        unknowns = system.matrix.shape[1]
        scale = column_lengths(system.matrix)
        scaled = np.column_stack([system.matrix / scale, system.right])
        root = triangular_root(scaled / row_lengths(system.matrix)[:, None])
        R = root[:unknowns, :unknowns]
        smallest, condition = smallest_singular_value(R)
        theta = self.triangular_solution(R, root[:unknowns, -1], smallest) / scale
        residual = system.right - system.matrix @ theta
        return Solution(theta, residual, float(residual @ residual), condition)

    def objectives(self, systems: Float[np.ndarray, "systems m n_plus_1"]) -> Float[np.ndarray, " systems"]:
        """Squares of what is left of b, by one QR of all, see `Solver.objectives`."""
        if systems.shape[1] < systems.shape[2]:
            return np.zeros(systems.shape[0])  # as many equations as unknowns are met exactly
        roots = np.asarray(np.linalg.qr(systems, mode="r"))
        return np.asarray(roots[:, -1, -1] ** 2)


@dataclass(frozen=True, slots=True)
class LeastSquares(UnweightedLeastSquares):
    """Minimise ||b - A theta||_2 by QR. O(m n^2); never squares the condition number."""

    def triangular_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], _smallest: float, /
    ) -> Float[np.ndarray, " n"]:
        """Back substitution, by LAPACK itself: a search solves thousands of small systems."""
        solution: Float[np.ndarray, " n"] = dtrtrs(R, right)[0]
        return solution


@dataclass(frozen=True, slots=True)
class AugmentedLeastSquares(UnweightedLeastSquares):
    """Minimise ||b - A theta||_2 through the augmented system, the paper's (10), (25), (31).

    [[s I, A], [A', 0]] [r/s; theta] = [b; 0] with s = sigma_min(A)/sqrt(2). An orthogonal reduction of
    [A b] leaves solution and conditioning as they are and shrinks the system from m + n to 2 n.
    """

    def triangular_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], smallest: float
    ) -> Float[np.ndarray, " n"]:
        """Solution of the reduced augmented system."""
        return solve_augmented(R, right, smallest / np.sqrt(2.0), 0.0)


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
            "Leave that column out, or give rows in which it moves.",
        )
    return lengths


def row_lengths(matrix: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """Euclidean lengths of the rows of a square matrix whose columns are given unit length.

    Ones where there are more rows than columns: their units are their weights. Ones for zero rows too.
    """
    if matrix.shape[0] != matrix.shape[1]:
        return np.ones(matrix.shape[0])
    columns = np.einsum("ij,ij->j", matrix, matrix)
    rows = (matrix * matrix) @ (1.0 / np.where(columns > 0.0, columns, 1.0))
    return np.asarray(np.sqrt(np.where(rows > 0.0, rows, 1.0)))


def smallest_singular_value(R: Float[np.ndarray, "n n"]) -> tuple[float, float]:
    """Smallest singular value and condition number of the triangular factor of unit-length columns.

    Raises
    ------
    CollinearError
        When the condition exceeds .001/(n eps), 2e12 for two columns: one of them is a combination of the
        others but for rounding, which three digits of the solution do not survive.
    """
    singular = np.linalg.svd(R, compute_uv=False)
    if lost_to_rounding(singular, R.shape[0]):
        raise CollinearError(
            "linearly independent regressors",
            f"columns of which one is a combination of the others (singular values {singular})",
            "Remove a column, or give data in which they move independently.",
        )
    return float(singular[-1]), float(singular[0] / singular[-1])


def lost_to_rounding(singular: Float[np.ndarray, " n"], size: int) -> bool:
    """Whether rounding takes more than its share of what a matrix of these singular values is solved for.

    Parameters
    ----------
    singular : ndarray, shape (n,)
        Of the matrix with columns of unit length, in descending order.
    size : int
        Its larger dimension.
    """
    return bool(singular[-1] * LARGEST_ROUNDING <= singular[0] * size * np.finfo(np.float64).eps)
