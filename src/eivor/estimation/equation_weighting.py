"""Weighted instrumental equations: two-stage least squares, and two-step GMM."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float

from eivor.errors import InstrumentError, UsageError
from eivor.estimation.moments import CrossMoments
from eivor.estimation.weighting import EquationWeighting, UnweightedEquations, WeightedEquations
from eivor.inference.covariances.bandwidth import newey_west_bandwidth
from eivor.inference.covariances.kernel import bartlett_covariance
from eivor.linalg.system import LinearSystem


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

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Equations divided by the Cholesky factor of mean(psi psi').

        Raises
        ------
        InstrumentError
            When instruments are combinations of one another.
        """
        if not isinstance(at.moments, CrossMoments) or at.moments.instruments is None:
            raise UsageError(
                "moments with the instruments' own products",
                type(at.moments).__name__,
                "Two-stage weighting goes with an instrumental assembler; make the moments with its method.",
            )
        return weighted(at.system, at.moments.instruments)


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

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Two-stage without theta; with it, divided by the Cholesky factor of the scores' covariance.

        Raises
        ------
        UsageError
            When the rows are not at hand: the weight needs a second pass over them.
        """
        if at.theta is None:
            return TwoStage().equations(at)
        if at.problem is None:
            raise UsageError(
                "the rows themselves for a robust weighting",
                "moments only",
                "Use two-stage weighting for data that do not fit in memory.",
            )
        rows = at.problem.rows()
        residual = rows.response - rows.regressors @ at.theta
        scores = rows.instruments * residual[:, None]
        if isinstance(at.moments, CrossMoments) and at.moments.noise is not None:
            noise = at.moments.noise
            scores = scores + (noise[:, :-1] @ at.theta - noise[:, -1])
        lags = newey_west_bandwidth(rows.response.size) if self.bandwidth is None else self.bandwidth
        return weighted(at.system, bartlett_covariance(scores, lags))


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
