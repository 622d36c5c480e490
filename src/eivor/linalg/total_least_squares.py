"""Total least squares: errors in the regressors as well as in the response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.errors import NoUniqueSolutionError, TooFewSamplesError
from eivor.linalg.least_squares import column_lengths, triangular_condition
from eivor.linalg.system import LinearSystem, ScoreCorrection, Solution, Solver
from eivor.linalg.triangular import triangular_root


@dataclass(frozen=True, slots=True)
class TotalLeastSquares(Solver):
    """Minimise ||b - A theta||^2 / (s_b^2 + sum_j s_j^2 theta_j^2), the paper's (13) with W = diag(s_j^2).

    Columns with error scale zero are eliminated first by an orthogonal reduction (Golub, Hoffman and
    Stewart 1987; Van Huffel and Vandewalle 1991), so they may not absorb any correction; the rest is
    divided by its error scale and solved through the smallest right singular vector, as in (14).

    Notes
    -----
    Columns are never rescaled but by their declared errors, since every other scaling is another
    estimator. Without error scales the solution changes with the units of the columns. O(m n^2).
    """

    def solve(self, system: LinearSystem) -> Solution:
        """Total least squares solution, see `Solver.solve`.

        Raises
        ------
        TooFewSamplesError
            With fewer than n + 1 equations.
        NoUniqueSolutionError
            When sigma_min([A b]) is not below sigma_min(A), or the response has no part in it.
        """
        rows, unknowns = system.matrix.shape
        if rows < unknowns + 1:
            raise TooFewSamplesError(
                f"at least {unknowns + 1} equations for total least squares with {unknowns} unknowns",
                f"{rows}",
                "Give more equations, or use least squares.",
            )
        scale = np.ones(unknowns + 1) if system.error_scale is None else system.error_scale
        exact = np.flatnonzero(scale[:-1] == 0.0)
        noisy = np.flatnonzero(scale[:-1] > 0.0)
        order = np.concatenate([exact, noisy])
        lengths = column_lengths(system.matrix)
        stacked = np.column_stack([system.matrix[:, order], system.right])
        R = triangular_root(stacked)
        condition = triangular_condition(R[:unknowns, :unknowns] / lengths[order])
        lower = R[exact.size :, exact.size :]
        theta_noisy = _smallest_vector_solution(lower, scale[noisy], scale[-1])
        right = R[: exact.size, -1] - R[: exact.size, exact.size : unknowns] @ theta_noisy
        theta = np.empty(unknowns)
        theta[noisy] = theta_noisy
        if exact.size:
            theta[exact] = scipy.linalg.solve_triangular(R[: exact.size, : exact.size], right)
        residual = system.right - system.matrix @ theta
        weight = float(scale[-1] ** 2 + np.sum((scale[:-1] * theta) ** 2))
        return Solution(theta, residual, float(residual @ residual) / weight, condition)

    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        error_scale: Float[np.ndarray, " n_plus_1"] | None,
    ) -> ScoreCorrection:
        """e_t W theta / s beside the regressors and -(e'e / s) W beside G'G, s = s_b^2 + theta' W theta.

        The score of (13) is sum of e_t (x_t + e_t W theta / s); its derivative follows because e'e / s
        is stationary at the solution.
        """
        scale = np.ones(theta.size + 1) if error_scale is None else error_scale
        W = scale[:-1] ** 2
        weight = float(scale[-1] ** 2 + theta @ (W * theta))
        power = float(residual @ residual) / weight
        return ScoreCorrection(np.outer(residual, W * theta / weight), -power * np.diag(W))


def _smallest_vector_solution(
    stacked: Float[np.ndarray, "m n_plus_1"], scale: Float[np.ndarray, " n"], response_scale: float
) -> Float[np.ndarray, " n"]:
    """Unknowns from the smallest right singular vector of the scaled [A b]."""
    if scale.size == 0:
        return np.empty(0)
    if response_scale == 0.0:
        raise NoUniqueSolutionError(
            "a response with an error scale above zero",
            "an exact response beside noisy regressors",
            "Declare the response's noise, or exchange response and regressor.",
        )
    columns = np.append(scale, response_scale)
    scaled = stacked / columns
    singular, right_vectors = np.linalg.svd(scaled)[1:]
    regressors_only = np.linalg.svd(scaled[:, :-1], compute_uv=False)
    vector = right_vectors[-1]
    tied = singular[-1] >= regressors_only[-1] * (1.0 - 1e-12)
    if tied or abs(vector[-1]) < np.sqrt(np.finfo(np.float64).eps):
        raise NoUniqueSolutionError(
            "sigma_min([A b]) below sigma_min(A)",
            f"{singular[-1]:.6g} and {regressors_only[-1]:.6g}",
            "Total least squares has no unique solution here: the regressors alone explain the "
            "smallest direction. Use least squares, or more and better excited data.",
        )
    return np.asarray(-vector[:-1] / vector[-1] * response_scale / scale)
