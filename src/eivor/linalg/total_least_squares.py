"""Total least squares: errors in the regressors as well as in the response.

Columns without error are eliminated and the others whitened by the declared error covariance (see
`eivor.linalg.split_problem`); what is left is solved by the SVD or through the paper's augmented system.

Columns are never rescaled but by their declared errors, since every other scaling is another estimator;
without a covariance the solution changes with the units of the columns.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from eivor.linalg.augmented import solve_augmented
from eivor.linalg.split_problem import residual_weight, split_problem
from eivor.linalg.system import LinearSystem, ScoreCorrection, Solution, Solver
from eivor.shapes import Float


class ErrorsInColumns(Solver):
    """What ways to solve a problem with errors in its columns have in common: the correction of the score."""

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
        weight = residual_weight(theta, S)
        power = float(residual @ residual) / weight
        return ScoreCorrection(np.outer(residual, pull / weight), -power * W)


class GeneralizedTotalLeastSquares(ErrorsInColumns):
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
        split = split_problem(system)
        whitened = np.empty(0)
        if split.noisy.size:
            whitened = self.whitened_solution(split.R, split.right, split.smallest)
        return split.solution(split.theta(whitened))


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
