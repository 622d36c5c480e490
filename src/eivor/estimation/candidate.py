"""The estimate at one delay, with everything that inference needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eivor.errors import EstimationError
from eivor.estimation.inferred import Inference, Solved
from eivor.estimation.nuisance import LagProfile
from eivor.inference.covariances.covariance import JointCovariance
from eivor.inference.covariances.estimators import DEFAULT, CovarianceEstimator
from eivor.inference.estimating_equation import EstimatingEquation
from eivor.linalg.system import Solution
from eivor.models.regression import Regression


@dataclass(frozen=True)
class Candidate:
    """The estimate at one delay.

    Parameters
    ----------
    delay_s : float
        Delay [s]; zero when none is searched.
    values : ndarray, shape (n,)
        Joint vector.
    solution : Solution
        Linear parameters, and the condition of their equations.
    profile : LagProfile
        Objective over the lags; a single lag of zero when none was searched for.
    solved : Solved or None
        What inference needs; None for an estimate from moments, whose rows are gone.
    covariance_estimator : CovarianceEstimator
        How the covariance is estimated.
    streamed_covariance : JointCovariance, optional
        Covariance made by a second pass over chunks, for an estimate from moments.
    """

    delay_s: float
    values: Float[np.ndarray, " n"]
    solution: Solution
    profile: LagProfile
    solved: Solved | None
    covariance_estimator: CovarianceEstimator = DEFAULT
    streamed_covariance: JointCovariance | None = None

    @property
    def lag_s(self) -> float:
        """Lag of the actuator [s]; zero when none was searched for."""
        return self.profile.lag_s

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
        return self._solved().problem.rows()

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

    @property
    def inference(self) -> Inference:
        """Tests of the instruments, made by a second pass over the rows when they are first asked for.

        Raises
        ------
        EstimationError
            For an estimate from moments.
        """
        return self._solved().inference

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
    def has_covariance(self) -> bool:
        """Whether intervals can be had: the rows are at hand, or chunks were passed over."""
        return self.solved is not None or self.streamed_covariance is not None

    @property
    def criterion(self) -> float:
        """What delays are compared by, see `Inference.criterion`."""
        return self.inference.criterion

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

    def _solved(self) -> Solved:
        if self.solved is None:
            raise EstimationError(
                "an estimate with its rows at hand, for residuals and standard errors",
                "an estimate from moments, which do not keep the rows",
                "Pass over the chunks again with eivor.identify_chunks, or identify the whole problem.",
            )
        return self.solved
