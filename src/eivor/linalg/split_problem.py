"""A total least squares problem, split into columns with errors and columns without.

Columns without error are eliminated first by an orthogonal reduction (Golub, Hoffman and Stewart 1987;
Van Huffel and Vandewalle 1991), so that they absorb no correction. The rest is right-multiplied by the
inverse Cholesky factor of the declared error covariance, which makes the errors alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from eivor.errors import CovarianceError, NoUniqueSolutionError, TooFewSamplesError
from eivor.linalg.least_squares import column_lengths, smallest_singular_value
from eivor.linalg.system import LinearSystem, Shrinkage, Solution
from eivor.linalg.triangular import triangular_root
from eivor.shapes import Float, Int

#: sigma_min([A b]) must lie below sigma_min(A) by this share.
SEPARATION = 1e-12


@dataclass(frozen=True)
class SplitProblem:
    """Whitened columns with errors, and the way back.

    Notation: with S = L L' the covariance of the noisy columns' errors and the response's, the rows
    [A b] L^-T have errors of covariance I, and [theta; -1] becomes L' [theta; -1] up to a factor.

    Parameters
    ----------
    system : LinearSystem
        The problem.
    covariance : ndarray, shape (n + 1, n + 1)
        S, of all columns.
    exact, noisy : ndarray of int
        Columns without and with errors.
    root : ndarray, shape (k, n + 1)
        Triangular root of [A b], exact columns first.
    factor : ndarray, shape (q + 1, q + 1)
        L of the noisy columns and the response.
    R : ndarray, shape (q, q)
        Triangular factor of the whitened regressors.
    right : ndarray, shape (q,)
        Right-hand side in its coordinates.
    outside : float
        Square of the whitened right-hand side that no regressor reaches.
    smallest : float
        Smallest singular value of the whitened [A b].
    condition : float
        Condition number of A, columns scaled to unit length.
    """

    system: LinearSystem
    covariance: Float[np.ndarray, "n_plus_1 n_plus_1"]
    exact: Int[np.ndarray, " k"]
    noisy: Int[np.ndarray, " q"]
    root: Float[np.ndarray, "rows n_plus_1"]
    factor: Float[np.ndarray, "q_plus_1 q_plus_1"]
    R: Float[np.ndarray, "q q"]
    right: Float[np.ndarray, " q"]
    outside: float
    smallest: float
    condition: float

    def theta(self, whitened: Float[np.ndarray, " q"]) -> Float[np.ndarray, " n"]:
        """All unknowns, from those of the whitened columns."""
        known, unknowns = self.exact.size, self.exact.size + self.noisy.size
        found = np.empty(unknowns)
        if self.noisy.size:
            direction = scipy.linalg.solve_triangular(
                self.factor, np.append(whitened, -1.0), lower=True, trans="T"
            )
            found[self.noisy] = -direction[:-1] / direction[-1]
        if known:
            right = self.root[:known, -1] - self.root[:known, known:unknowns] @ found[self.noisy]
            found[self.exact] = scipy.linalg.solve_triangular(self.root[:known, :known], right)
        return found

    def whitened(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " q"]:
        """Unknowns of the whitened columns, from all unknowns."""
        direction = self.factor.T @ np.append(theta[self.noisy], -1.0)
        return np.asarray(-direction[:-1] / direction[-1])

    def solution(self, theta: Float[np.ndarray, " n"], shrinkage: Shrinkage | None = None) -> Solution:
        """Solution with these unknowns."""
        residual = self.system.right - self.system.matrix @ theta
        power = float(residual @ residual) / residual_weight(theta, self.covariance)
        return Solution(theta, residual, power, self.condition, shrinkage)


def split_problem(system: LinearSystem) -> SplitProblem:
    """Split and whiten a problem.

    Raises
    ------
    TooFewSamplesError
        With fewer than n + 1 equations.
    NoUniqueSolutionError
        When sigma_min([A b]) is not below sigma_min(A).
    CovarianceError
        When the errors of the noisy columns have a singular covariance.
    """
    rows, unknowns = system.matrix.shape
    if rows < unknowns + 1:
        raise TooFewSamplesError(
            f"at least {unknowns + 1} equations for total least squares with {unknowns} unknowns",
            f"{rows}",
            "Give more equations, or use least squares.",
        )
    S = np.eye(unknowns + 1) if system.error_covariance is None else system.error_covariance
    if not (np.diag(S) >= 0.0).all():
        raise CovarianceError(
            "variances of zero or more", f"{np.diag(S)}", "Check the covariance of the columns' errors."
        )
    exact = np.flatnonzero(np.diag(S)[:-1] == 0.0)
    noisy = np.flatnonzero(np.diag(S)[:-1] > 0.0)
    order = np.concatenate([exact, noisy])
    lengths = column_lengths(system.matrix)
    root = triangular_root(np.column_stack([system.matrix[:, order], system.right]))
    _, condition = smallest_singular_value(root[:unknowns, :unknowns] / lengths[order])
    if not noisy.size:
        none = np.empty((0, 0))
        return SplitProblem(system, S, exact, noisy, root, none, none, np.empty(0), 0.0, 0.0, condition)
    both = np.append(noisy, unknowns)
    L = _cholesky(S[np.ix_(both, both)])
    left = _whitened_root(root[exact.size :, exact.size :], L)
    q = noisy.size
    smallest = _smallest(left, q)
    outside = float(left[q, q] ** 2) if left.shape[0] > q else 0.0
    return SplitProblem(
        system, S, exact, noisy, root, L, left[:q, :q], left[:q, -1], outside, smallest, condition
    )


def residual_weight(theta: Float[np.ndarray, " n"], S: Float[np.ndarray, "n_plus_1 n_plus_1"]) -> float:
    """[theta; -1]' S [theta; -1]: variance of a row's residual; one when every column is exact."""
    direction = np.append(theta, -1.0)
    return float(direction @ S @ direction) or 1.0


def _whitened_root(
    stacked: Float[np.ndarray, "m q_plus_1"], L: Float[np.ndarray, "q_plus_1 q_plus_1"]
) -> Float[np.ndarray, "k q_plus_1"]:
    whitened = scipy.linalg.solve_triangular(L, stacked.T, lower=True).T
    return triangular_root(whitened)


def _smallest(root: Float[np.ndarray, "k q_plus_1"], unknowns: int) -> float:
    """sigma_min([A b]), which must lie below sigma_min(A)."""
    singular = np.linalg.svd(root, compute_uv=False)
    regressors_only = np.linalg.svd(root[:unknowns, :unknowns], compute_uv=False)
    smallest = float(singular[-1]) if singular.size > unknowns else 0.0
    if smallest >= float(regressors_only[-1]) * (1.0 - SEPARATION):
        raise NoUniqueSolutionError(
            "sigma_min([A b]) below sigma_min(A)",
            f"{smallest:.6g} and {regressors_only[-1]:.6g}",
            "Total least squares has no unique solution here: the regressors alone explain the "
            "smallest direction. Use least squares, or more and better excited data.",
        )
    return smallest


def _cholesky(S: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    scale = np.sqrt(np.diag(S))
    if not scale.all():
        raise NoUniqueSolutionError(
            "a response with noise",
            "an exact response beside noisy regressors",
            "Declare the response's noise, or exchange response and regressor.",
        )
    try:
        return np.asarray(scale[:, None] * np.linalg.cholesky(S / np.outer(scale, scale)))
    except np.linalg.LinAlgError as error:
        raise CovarianceError(
            "a positive definite covariance of the noisy columns' errors",
            "one that is singular or indefinite",
            "Errors of two columns must not be exact multiples of each other; check signs and sizes.",
        ) from error
