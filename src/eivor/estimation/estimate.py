"""Estimates: named parameters with everything that inference needs.

The vector of estimates is *joint*: the linear parameters and, where it was searched for, the actuator's
lag, so that every interval includes the lag's uncertainty. The delay takes a few discrete values; each
has its candidate, and an interval is the union over the candidates that the data cannot tell apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eivor.errors import UsageError
from eivor.estimation.nuisance import LagProfile
from eivor.inference.covariance import JointCovariance
from eivor.inference.quantiles import chi_square_quantile
from eivor.models.parameter import Parameter
from eivor.models.regression import Regression

#: A scalar function of a candidate's joint vector: its value and its gradient.
Quantity = Callable[["Candidate"], tuple[float, Float[np.ndarray, " n"]]]


@dataclass(frozen=True)
class Candidate:
    """The estimate at one delay.

    Parameters
    ----------
    delay_s : float
        Delay [s]; zero when none is searched.
    values : ndarray, shape (n,)
        Joint vector.
    covariance : JointCovariance
        Of the joint vector.
    criterion : float
        What delays are compared by, in units of a chi-square on one degree of freedom: J with
        instruments, the scaled objective without.
    over_identification : tuple of float
        J and its p-value; (0, 1) without instruments.
    first_stage : ndarray, shape (n,)
        Conditional first-stage F of each joint parameter; NaN without instruments.
    residual_variance : float
        s^2 of the weighted rows.
    condition : float
        Condition number of the scaled equations.
    rank : int
        Number of independent instruments; 0 without.
    rows : Regression
        Weighted rows at the estimate.
    profile : LagProfile
        Objective over the lags.
    """

    delay_s: float
    values: Float[np.ndarray, " n"]
    covariance: JointCovariance
    criterion: float
    over_identification: tuple[float, float]
    first_stage: Float[np.ndarray, " n"]
    residual_variance: float
    condition: float
    rank: int
    rows: Regression
    profile: LagProfile

    @property
    def theta(self) -> Float[np.ndarray, " m"]:
        """Linear parameters."""
        return self.values[: self.rows.regressors.shape[1]]

    @property
    def residuals(self) -> Float[np.ndarray, " rows"]:
        """Residuals of the weighted rows."""
        return self.rows.response - self.rows.regressors @ self.theta


@dataclass(frozen=True)
class Estimate:
    """Named parameters with units, intervals and what they rest on.

    Parameters
    ----------
    method : str
        Name of the method.
    joint_parameters : tuple of Parameter
        In the order of the joint vector.
    candidates : tuple of Candidate
        One for each delay, in increasing order.
    """

    method: str
    joint_parameters: tuple[Parameter, ...]
    candidates: tuple[Candidate, ...]

    @cached_property
    def best(self) -> Candidate:
        """Candidate with the least criterion."""
        return min(self.candidates, key=lambda candidate: candidate.criterion)

    def tenable(self, level: float = 0.95) -> tuple[Candidate, ...]:
        """Candidates whose criterion is within a chi-square quantile of the least one."""
        bound = self.best.criterion + chi_square_quantile(level)
        return tuple(candidate for candidate in self.candidates if candidate.criterion <= bound)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter."""
        return tuple(p.name for p in self.joint_parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint parameter."""
        return tuple(p.unit for p in self.joint_parameters)

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each joint parameter at the best delay."""
        return {name: float(value) for name, value in zip(self.names, self.best.values, strict=True)}

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance at the best delay, in the order of `names`: see `JointCovariance.matrix`."""
        return self.best.covariance.matrix

    @property
    def residuals(self) -> Float[np.ndarray, " rows"]:
        """Residuals of the weighted rows at the best delay."""
        return self.best.residuals

    @property
    def condition(self) -> float:
        """Condition number of the equations, columns scaled to unit length."""
        return self.best.condition

    def direction(self, name: str) -> Float[np.ndarray, " n"]:
        """Unit vector of a parameter.

        Raises
        ------
        UsageError
            When there is no parameter of that name.
        """
        if name not in self.names:
            raise UsageError(f"a parameter out of {', '.join(self.names)}", f"'{name}'", "Name one of them.")
        return np.eye(len(self.names))[self.names.index(name)]

    def std_error(self, name: str) -> float:
        """Largest of the standard errors at the best delay."""
        return self.best.covariance.std_error(self.direction(name))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter, a union over the delays that fit.

        Raises
        ------
        UsageError
            When there is no parameter of that name, or the level is not between 0 and 1.
        """
        direction = self.direction(name)
        return self.interval_of(lambda candidate: (float(direction @ candidate.values), direction), level)

    def interval_of(
        self,
        quantity: Quantity,
        level: float = 0.95,
        extra_variance: Callable[[Candidate], float] = lambda _: 0.0,
    ) -> tuple[float, float]:
        """Confidence interval of a function of the joint vector, by the delta method at each delay.

        Raises
        ------
        UsageError
            When the level is not between 0 and 1.
        """
        if not 0.0 < level < 1.0:
            raise UsageError("a confidence level between 0 and 1", f"{level}", "Use 0.95, for example.")
        ends: list[float] = []
        for candidate in self.tenable(level):
            value, gradient = quantity(candidate)
            half = candidate.covariance.half_width(gradient, level, extra_variance(candidate))
            ends.extend((value - half, value + half))
        return min(ends), max(ends)

    def summary(self) -> str:
        """Table of parameters, standard errors and 95 % intervals, as text."""
        lines = [
            f"{self.method}",
            f"{'parameter':<20}{'value':>12}{'std. error':>12}{'95 % interval':>26}  unit",
        ]
        for parameter in self.joint_parameters:
            low, high = self.interval(parameter.name)
            lines.append(
                f"{parameter.name:<20}{self.parameters[parameter.name]:>12.5g}"
                f"{self.std_error(parameter.name):>12.3g}{f'[{low:.5g}, {high:.5g}]':>26}  {parameter.unit}"
            )
        return "\n".join(lines)
