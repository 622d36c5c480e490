"""Weighted total least squares: every row has an error covariance of its own (York's problem)."""

from __future__ import annotations

import numpy as np

from eivor import checks
from eivor.errors import ConvergenceError, CovarianceError, ShapeError
from eivor.linalg.least_squares import LeastSquares, column_lengths
from eivor.linalg.system import LinearSystem, Solution
from eivor.shapes import Float

#: Relative change of theta at which the iteration stops, and its longest run.
TOLERANCE = 1e-14
ITERATIONS = 500


def weighted_total_least_squares(
    system: LinearSystem, row_covariances: Float[np.ndarray, "m n_plus_1 n_plus_1"]
) -> Solution:
    """Minimise sum_t e_t^2 / w_t, w_t = [theta; -1]' S_t [theta; -1], e = b - A theta.

    At the minimum sum_t (e_t / w_t) x_t = 0 with x_t the regressors adjusted for their estimated errors,
    x_t = a_t + e_t (W_t theta - v_t) / w_t (W_t, v_t the blocks of S_t; York 1966 for a straight line).
    The iteration solves that equation for theta with x_t and w_t from the theta before.

    Parameters
    ----------
    system : LinearSystem
        A and b; its own error covariance is not used.
    row_covariances : ndarray, shape (m, n + 1, n + 1)
        Covariance S_t of the errors in each row of [A b].

    Raises
    ------
    ShapeError, CovarianceError
        When the covariances do not fit, or a row's residual has no variance.
    ConvergenceError
        When the iteration does not settle.
    """
    checks.kind("system", system, LinearSystem, "a LinearSystem", "Make one: LinearSystem(A, b).")
    A, b, S = system.matrix, system.right, checks.real_array("row_covariances", row_covariances)
    if S.shape != (*A.shape[:1], A.shape[1] + 1, A.shape[1] + 1):
        raise ShapeError(
            f"covariances of shape {(A.shape[0], A.shape[1] + 1, A.shape[1] + 1)}", f"{S.shape}", "One a row."
        )
    start = LeastSquares().solve(system)
    # Rows [A b] in units in which every column has length one: neither the stopping rule nor the solve
    # then depends on the user's.
    lengths = np.append(column_lengths(A), 1.0)
    A, S = A / lengths[:-1], S / np.outer(lengths, lengths)
    theta = start.theta * lengths[:-1]
    for _ in range(ITERATIONS):
        weight, adjusted = _adjusted(A, b, S, theta)
        projected = adjusted / weight[:, None]
        renewed = np.linalg.solve(projected.T @ A, projected.T @ b)
        change = float(np.max(np.abs(renewed - theta)))
        theta = renewed
        if change <= TOLERANCE * float(np.max(np.abs(theta))):
            break
    else:
        raise ConvergenceError(
            f"a settled weighted total least squares iteration within {ITERATIONS} steps",
            f"a last relative change of {change / float(np.max(np.abs(theta))):.2g}",
            "The data hardly determine a parameter, or the weights are extreme: check the covariances.",
        )
    residual = b - A @ theta
    weight, _ = _adjusted(A, b, S, theta)
    return Solution(theta / lengths[:-1], residual, float(np.sum(residual**2 / weight)), start.condition)


def _adjusted(
    A: Float[np.ndarray, "m n"],
    b: Float[np.ndarray, " m"],
    S: Float[np.ndarray, "m n_plus_1 n_plus_1"],
    theta: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n"]]:
    """Variance of each row's residual, and its regressors adjusted for their estimated errors."""
    pull = S @ np.append(theta, -1.0)
    weight = pull @ np.append(theta, -1.0)
    if not (weight > 0.0).all():
        raise CovarianceError(
            "a positive variance of every row's residual",
            f"{float(weight.min()):.3g} in row {int(np.argmin(weight))}",
            "Give every row an error in the response or in a regressor.",
        )
    residual = b - A @ theta
    return weight, A + (residual / weight)[:, None] * pull[:, :-1]
