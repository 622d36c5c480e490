"""The estimate at one combination of discrete nuisances, with everything that inference needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eivor.estimation.inferred import Inference
from eivor.estimation.search import NuisanceProfile
from eivor.estimation.solved import Solved
from eivor.inference.covariances.covariance import JointCovariance
from eivor.inference.covariances.estimators import DEFAULT, CovarianceEstimator
from eivor.inference.estimating_equation import EstimatingEquation
from eivor.linalg.system import Solution
from eivor.models.regression import Regression
from eivor.shapes import Float


@dataclass(frozen=True)
class Candidate:
    """The estimate at one combination of discrete nuisances.

    Parameters
    ----------
    at : mapping of str to float
        Value of every nuisance; empty for a problem without any.
    solved : Solved
        Linear parameters, and how they were found.
    profiles : tuple of NuisanceProfile
        One for each continuous nuisance that was searched for.
    covariance_estimator : CovarianceEstimator
        How the covariance is estimated.
    streamed_covariance : JointCovariance, optional
        Covariance made elsewhere: by a second pass over chunks, for an estimate from moments; or by a pool.
    own_criterion : float, optional
        What it is compared by, in place of `Inference.criterion`: of the pool that it is a part of, or a
        likelihood with spectra of its own.
    origin : ndarray, shape (n,), optional
        What the solution's unknowns are changes of, where the equations were made linear. Default: zero.
    """

    at: Mapping[str, float]
    solved: Solved
    profiles: tuple[NuisanceProfile, ...] = ()
    covariance_estimator: CovarianceEstimator = DEFAULT
    streamed_covariance: JointCovariance | None = field(default=None, repr=False)
    own_criterion: float | None = None
    origin: Float[np.ndarray, " n"] | None = None

    @cached_property
    def values(self) -> Float[np.ndarray, " n"]:
        """Joint vector: the linear parameters, then the continuous nuisances that were searched for."""
        if self.origin is not None:
            return self.origin + self.theta
        nuisances = [self.at[profile.nuisance.name] for profile in self.profiles]
        return np.append(self.solution.theta, nuisances)

    @property
    def solution(self) -> Solution:
        """Linear parameters, and the condition of their equations."""
        return self.solved.solution

    @property
    def theta(self) -> Float[np.ndarray, " m"]:
        """Linear parameters."""
        return self.solution.theta

    @property
    def rows(self) -> Regression:
        """Weighted rows at the estimate.

        Raises
        ------
        EstimationError
            For an estimate from moments.
        """
        return self.solved.rows

    @property
    def residuals(self) -> Float[np.ndarray, " rows"]:
        """Residuals of the weighted rows.

        Raises
        ------
        EstimationError
            For an estimate from moments.
        """
        rows = self.rows
        return rows.response - rows.regressors @ self.theta

    @cached_property
    def inference(self) -> Inference:
        """Tests of the instruments, made by a second pass over the rows when they are first asked for."""
        return Inference(self.solved)

    @property
    def equation(self) -> EstimatingEquation:
        """The estimating equation: test functions, residual, scores in time, sensitivity.

        Raises
        ------
        EstimationError
            For an estimate from moments.
        """
        return self.inference.equation

    @property
    def has_rows(self) -> bool:
        """Whether the rows are at hand; they are not for an estimate from moments."""
        return self.solved.problem is not None

    @property
    def has_covariance(self) -> bool:
        """Whether intervals can be had: the rows are at hand, or chunks were passed over."""
        return self.has_rows or self.streamed_covariance is not None

    @property
    def criterion(self) -> float:
        """What candidates are compared by, see `Inference.criterion`."""
        return self.inference.criterion if self.own_criterion is None else self.own_criterion

    @cached_property
    def covariance(self) -> JointCovariance:
        """Of the joint vector.

        Raises
        ------
        EstimationError
            For an estimate from moments over whose chunks no second pass was made.
        """
        if self.streamed_covariance is not None:
            return self.streamed_covariance
        return self.covariance_estimator.joint(self.equation)
