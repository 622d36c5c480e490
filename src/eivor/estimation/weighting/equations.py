"""Weights of equations: as they are, two-stage least squares, and two-step GMM.

An instrumental method has equations m(theta) = psi'(y - Phi theta). A weighting gives a factor L, and L^-1 m
is made small.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from eivor import checks
from eivor.errors import InstrumentError, UsageError
from eivor.estimation.moments import CrossMoments, Moments
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class UnweightedEquations:
    """Equations of a method before they are weighted, and what a weight may be made of.

    Parameters
    ----------
    system : LinearSystem
        A and b, means over the rows.
    moments : Moments
        What they were made of.
    problem : LinearProblem or None
        The rows; None when only moments are at hand.
    theta : ndarray, shape (n,), or None
        Estimate of the pass before; None in the first.
    """

    system: LinearSystem
    moments: Moments
    problem: LinearProblem | None
    theta: Float[np.ndarray, " n"] | None


@dataclass(frozen=True, slots=True)
class WeightedEquations:
    """Equations after weighting.

    Parameters
    ----------
    system : LinearSystem
        L^-1 A theta = L^-1 b.
    factor : ndarray, shape (p, p), optional
        Lower triangular L; None for the identity.
    """

    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None = None


class EquationWeighting(ABC):
    """A way to weight equations."""

    @property
    @abstractmethod
    def passes(self) -> int:
        """Number of times the estimate is made; weights are renewed between passes."""

    @property
    @abstractmethod
    def needs_instrument_products(self) -> bool:
        """True when mean(psi psi') must be among the moments."""

    @abstractmethod
    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Equations weighted for the first pass, or by the residuals of the pass before."""


@dataclass(frozen=True, slots=True)
class Unweighted(EquationWeighting):
    """Every equation with weight one, as in the paper's (24) and (30)."""

    @property
    def passes(self) -> int:
        """One."""
        return 1

    @property
    def needs_instrument_products(self) -> bool:
        """No."""
        return False

    def equations(self, at: UnweightedEquations) -> WeightedEquations:
        """Return the equations as they are."""
        return WeightedEquations(at.system)


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

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            checks.whole("bandwidth", self.bandwidth)
            if self.bandwidth < 0:
                raise UsageError("a bandwidth of zero or more lags", f"{self.bandwidth}", "Zero sees no lag.")

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
        from eivor.inference.covariances.bandwidth import newey_west_bandwidth
        from eivor.inference.covariances.kernel import bartlett_covariance

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
        if isinstance(at.moments, CrossMoments):
            scores = scores + at.moments.shared_noise(at.theta)
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
