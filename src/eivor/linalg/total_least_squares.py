"""Total least squares: errors in the regressors as well as in the response.

Columns without error are eliminated first by an orthogonal reduction (Golub, Hoffman and Stewart 1987;
Van Huffel and Vandewalle 1991), so that they absorb no correction. The rest is right-multiplied by the
inverse Cholesky factor of the declared error covariance, which makes the errors alike, and solved by the
SVD or through the paper's augmented system.

Columns are never rescaled but by their declared errors, since every other scaling is another estimator;
without a covariance the solution changes with the units of the columns.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from eivor.errors import CovarianceError, NoUniqueSolutionError, TooFewSamplesError
from eivor.linalg.augmented import solve_augmented
from eivor.linalg.least_squares import column_lengths, smallest_singular_value
from eivor.linalg.system import LinearSystem, ScoreCorrection, Solution, Solver
from eivor.linalg.triangular import triangular_root
from eivor.shapes import Float

#: sigma_min([A b]) must lie below sigma_min(A) by this share.
SEPARATION = 1e-12


class GeneralizedTotalLeastSquares(Solver):
    """Minimise ||b - A theta||^2 / ([theta; -1]' S [theta; -1]), the paper's (13) with any covariance S.

    What the ways to solve it have in common: all but the last step, for whitened errors.
    """

    @abstractmethod
    def whitened_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], smallest: float
    ) -> Float[np.ndarray, " n"]:
        """Theta of (R'R - smallest^2 I) theta = R' right."""

    def solve(self, system: LinearSystem) -> Solution:
        """Total least squares solution, see `Solver.solve`.

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
        known, split = exact.size, slice(exact.size, None)
        theta = np.empty(unknowns)
        noisy_and_response = np.append(noisy, unknowns)
        theta[noisy] = self._noisy_part(root[split, split], S[np.ix_(noisy_and_response, noisy_and_response)])
        if known:
            right = root[:known, -1] - root[:known, known:unknowns] @ theta[noisy]
            theta[exact] = scipy.linalg.solve_triangular(root[:known, :known], right)
        residual = system.right - system.matrix @ theta
        power = float(residual @ residual) / _weight(theta, S)
        return Solution(theta, residual, power, condition)

    def _noisy_part(
        self, stacked: Float[np.ndarray, "m n_plus_1"], S: Float[np.ndarray, "n_plus_1 n_plus_1"]
    ) -> Float[np.ndarray, " n"]:
        """Unknowns of the columns with errors, whose covariance together with the response's is S.

        With S = L L' the rows [A b] L^-T have errors of covariance I, and [theta; -1] becomes
        L' [theta; -1] up to a factor.
        """
        unknowns = S.shape[0] - 1
        if unknowns == 0:
            return np.empty(0)
        L = _cholesky(S)
        whitened = scipy.linalg.solve_triangular(L, stacked.T, lower=True).T
        root = triangular_root(whitened)
        singular = np.linalg.svd(root, compute_uv=False)
        R = root[:unknowns, :unknowns]
        regressors_only = np.linalg.svd(R, compute_uv=False)
        smallest = float(singular[-1]) if singular.size > unknowns else 0.0
        if smallest >= float(regressors_only[-1]) * (1.0 - SEPARATION):
            raise NoUniqueSolutionError(
                "sigma_min([A b]) below sigma_min(A)",
                f"{smallest:.6g} and {regressors_only[-1]:.6g}",
                "Total least squares has no unique solution here: the regressors alone explain the "
                "smallest direction. Use least squares, or more and better excited data.",
            )
        whitened_theta = self.whitened_solution(R, root[:unknowns, -1], smallest)
        direction = scipy.linalg.solve_triangular(L, np.append(whitened_theta, -1.0), lower=True, trans="T")
        return np.asarray(-direction[:-1] / direction[-1])

    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None,
    ) -> ScoreCorrection:
        """e_t (W theta - w) / s beside the regressors and -(e'e / s) W beside G'G.

        W is the covariance of the regressors' errors, w that with the response's, s the weight of the
        residual. The score of (13) is the sum of e_t (x_t + e_t (W theta - w) / s); its derivative follows
        because e'e / s is stationary at the solution.
        """
        S = np.eye(theta.size + 1) if error_covariance is None else error_covariance
        W, pull = S[:-1, :-1], S[:-1, :-1] @ theta - S[:-1, -1]
        weight = _weight(theta, S)
        power = float(residual @ residual) / weight
        return ScoreCorrection(np.outer(residual, pull / weight), -power * W)


@dataclass(frozen=True, slots=True)
class TotalLeastSquares(GeneralizedTotalLeastSquares):
    """Generalized total least squares by the SVD. O(m n^2)."""

    def whitened_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], smallest: float
    ) -> Float[np.ndarray, " n"]:
        """Theta by the SVD of R: V diag(s_i / (s_i^2 - sigma^2)) U' right."""
        U, singular, Vt = np.linalg.svd(R)
        gains = singular / ((singular - smallest) * (singular + smallest))
        return np.asarray(Vt.T @ (gains * (U.T @ right)))


@dataclass(frozen=True, slots=True)
class AugmentedTotalLeastSquares(GeneralizedTotalLeastSquares):
    """Generalized total least squares through the augmented system, the paper's (16), (27), (33).

    [[s I, A], [A', s I]] [r/s; theta] = [b; 0] with s = sigma_min([A b]), reduced to 2 n.
    """

    def whitened_solution(
        self, R: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"], smallest: float
    ) -> Float[np.ndarray, " n"]:
        """Theta of the reduced augmented system."""
        if smallest == 0.0:
            return np.asarray(scipy.linalg.solve_triangular(R, right))
        return solve_augmented(R, right, smallest, smallest)


def _weight(theta: Float[np.ndarray, " n"], S: Float[np.ndarray, "n_plus_1 n_plus_1"]) -> float:
    """[theta; -1]' S [theta; -1]: variance of a row's residual; one when every column is exact."""
    direction = np.append(theta, -1.0)
    return float(direction @ S @ direction) or 1.0


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
