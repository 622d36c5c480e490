"""Weighted instrumental equations: two-stage least squares, and two-step GMM."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.errors import InstrumentError, UsageError
from eivor.estimation.moments import CrossMoments, Moments
from eivor.estimation.weighting import EquationWeighting, WeightedEquations
from eivor.inference.kernel import bartlett_covariance, newey_west_bandwidth
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem


@dataclass(frozen=True, slots=True)
class TwoStage(EquationWeighting):
    """Weight by the inverse of mean(psi psi'): two-stage least squares, efficient for white errors."""

    @property
    def passes(self) -> int:
        """One: the weight does not depend on the residuals."""
        return 1

    @property
    def needs_instrument_products(self) -> bool:
        """Yes."""
        return True

    def equations(
        self,
        system: LinearSystem,
        moments: Moments,
        problem: LinearProblem | None,
        theta: Float[np.ndarray, " n"] | None,
    ) -> WeightedEquations:
        """Equations divided by the Cholesky factor of mean(psi psi').

        Raises
        ------
        InstrumentError
            When instruments are combinations of one another.
        """
        del problem, theta
        if not isinstance(moments, CrossMoments) or moments.instruments is None:
            raise UsageError(
                "moments with the instruments' own products",
                type(moments).__name__,
                "Two-stage weighting goes with an instrumental assembler; make the moments with its method.",
            )
        return weighted(system, moments.instruments)


@dataclass(frozen=True, slots=True)
class TwoStepRobust(EquationWeighting):
    """Two-stage first, then weight by the covariance of the equations at its residuals: two-step GMM.

    Parameters
    ----------
    bandwidth : int or None
        Lags of the Bartlett kernel that allow for autocorrelated errors; 0 allows for
        heteroskedasticity only; None chooses by Newey and West's rule of thumb, 4 (N/100)^(2/9).
    """

    bandwidth: int | None = None

    @property
    def passes(self) -> int:
        """Two."""
        return 2

    @property
    def needs_instrument_products(self) -> bool:
        """Yes, for the first step."""
        return True

    def equations(
        self,
        system: LinearSystem,
        moments: Moments,
        problem: LinearProblem | None,
        theta: Float[np.ndarray, " n"] | None,
    ) -> WeightedEquations:
        """Two-stage without theta; with it, divided by the Cholesky factor of the scores' covariance.

        Raises
        ------
        UsageError
            When the rows are not at hand: the weight needs a second pass over them.
        """
        if theta is None:
            return TwoStage().equations(system, moments, problem, theta)
        if problem is None:
            raise UsageError(
                "the rows themselves for a robust weighting",
                "moments only",
                "Use two-stage weighting for data that do not fit in memory.",
            )
        rows = problem.rows()
        residual = rows.response - rows.regressors @ theta
        scores = rows.instruments * residual[:, None]
        if isinstance(moments, CrossMoments) and moments.noise is not None:
            scores = scores + (moments.noise[:, :-1] @ theta - moments.noise[:, -1])
        lags = newey_west_bandwidth(rows.response.size) if self.bandwidth is None else self.bandwidth
        return weighted(system, bartlett_covariance(scores, lags))


def weighted(system: LinearSystem, covariance: Float[np.ndarray, "p p"]) -> WeightedEquations:
    """Equations divided by the Cholesky factor of a covariance of theirs.

    Raises
    ------
    InstrumentError
        When it is singular.
    """
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale) if scale.all() else np.zeros_like(covariance)
    eigenvalues = np.linalg.eigvalsh(correlation)
    if eigenvalues[0] <= covariance.shape[0] * np.finfo(np.float64).eps * max(eigenvalues[-1], 0.0):
        raise InstrumentError(
            "linearly independent instruments",
            f"instruments of which one is a combination of the others (eigenvalues {eigenvalues})",
            "Remove one, or use an unweighted instrumental method.",
        )
    L = scale[:, None] * np.linalg.cholesky(correlation)
    stacked = np.column_stack([system.matrix, system.right])
    divided = scipy.linalg.solve_triangular(L, stacked, lower=True)
    return WeightedEquations(LinearSystem(divided[:, :-1], divided[:, -1]), L)
