"""Linear methods whose solver regularises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.method import Method, Problem
from eivor.linalg.least_squares import UnweightedLeastSquares
from eivor.linalg.regularised import RegularisedLeastSquares, RegularisedTotalLeastSquares, Tikhonov
from eivor.linalg.total_least_squares import GeneralizedTotalLeastSquares
from eivor.shapes import Float


@dataclass(frozen=True)
class PulledTowards(Method):
    """A method whose solution is pulled towards the estimate of another method on the same problem."""

    name: str
    method: LinearMethod
    parameter: float | None
    target: Method

    @property
    def needs_instruments(self) -> bool:
        """Whether either of them does."""
        return self.method.needs_instruments or self.target.needs_instruments

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate of the target first, see `Method.estimate`."""
        towards = self.target.estimate(problem).best.theta
        return _pulled(self.method, Tikhonov(self.parameter, towards)).estimate(problem)


def regularised(
    method: LinearMethod,
    parameter: float | None = None,
    towards: Float[np.ndarray, " n"] | Method | None = None,
) -> Method:
    """Return a linear method with Tikhonov's regularisation.

    On simulated records it gains nothing over generalized IV, see `docs/efficiency.md`. It serves comparison,
    and equations that are ill-conditioned for want of a better input.

    Parameters
    ----------
    method : LinearMethod
        Solved by least squares or total least squares, such as ``generalized_iv()``.
    parameter : float, optional
        Zero or more, in units of the mean squared singular value; generalized cross-validation by default.
    towards : ndarray, shape (n,), or Method, optional
        In the order and the units of the parameters; the estimate of another method; or zero.

    Returns
    -------
    Method
        Its estimate is biased. Intervals have the covariance without regularisation, with the square of the
        whole shift added: they are never shorter than those without.

    Raises
    ------
    UsageError
        When the method cannot be regularised, or an argument is of another kind.
    """
    check_linear(method)
    if isinstance(towards, Method):
        _pulled(method, Tikhonov(parameter))  # refuses what cannot be regularised
        return PulledTowards(f"{method.name}_tikhonov", method, parameter, towards)
    return _pulled(method, Tikhonov(parameter, towards))


def _pulled(method: LinearMethod, scheme: Tikhonov) -> LinearMethod:
    solver: RegularisedLeastSquares | RegularisedTotalLeastSquares
    if isinstance(method.solver, UnweightedLeastSquares):
        solver = RegularisedLeastSquares(scheme)
    elif isinstance(method.solver, GeneralizedTotalLeastSquares):
        solver = RegularisedTotalLeastSquares(scheme)
    else:
        raise UsageError(
            "a method that is solved by least squares or total least squares",
            f"{method.name}, which has {type(method.solver).__name__}",
            "Use generalized_iv(), extended_iv() or least_squares(), for example.",
        )
    return replace(method, name=f"{method.name}_tikhonov", solver=solver)
