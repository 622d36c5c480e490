"""Linear methods whose solver regularises, and what is told of an estimate that was pulled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.method import Method, Problem
from eivor.linalg.least_squares import UnweightedLeastSquares
from eivor.linalg.parameter_choice import GeneralizedCrossValidation, ParameterChoice
from eivor.linalg.regularisation import Regularisation, Tikhonov
from eivor.linalg.regularised import RegularisedLeastSquares, RegularisedTotalLeastSquares
from eivor.linalg.total_least_squares import GeneralizedTotalLeastSquares
from eivor.shapes import Float


@dataclass(frozen=True)
class PulledTowards(Method):
    """A method whose solution is pulled towards the estimate of another one on the same problem.

    Parameters
    ----------
    name : str
        The word that results use.
    method : LinearMethod
        What is pulled.
    scheme : Regularisation
        How.
    choice : ParameterChoice
        How far.
    target : Method
        Whose estimate is pulled towards.
    """

    name: str
    method: LinearMethod
    scheme: Regularisation
    choice: ParameterChoice
    target: Method

    @property
    def needs_instruments(self) -> bool:
        """When one of the two does."""
        return self.method.needs_instruments or self.target.needs_instruments

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate by the target first, then by the method."""
        towards = self.target.estimate(problem).best.theta
        return _pulled(self.method, self.scheme, self.choice, towards).estimate(problem)


def regularised(
    method: LinearMethod,
    scheme: Regularisation | None = None,
    choice: ParameterChoice | None = None,
    towards: Float[np.ndarray, " n"] | Method | None = None,
) -> Method:
    """Return a linear method with its solution pulled towards a vector.

    On simulated records it gains nothing over generalized IV, see the table in `docs/efficiency.md`: it is
    there to be compared, and for equations that are ill-conditioned for want of a better input.

    Parameters
    ----------
    method : LinearMethod
        Solved by least squares or total least squares, such as ``generalized_iv()``.
    scheme : Regularisation, optional
        `Tikhonov` (default) or `ImplicitIteration`.
    choice : ParameterChoice, optional
        `GeneralizedCrossValidation` (default), `DiscrepancyPrinciple`, `LCurve` or `GivenParameter`.
    towards : ndarray, shape (n,), or Method, optional
        In the order and the units of the parameters; the estimate of another method; or zero.

    Returns
    -------
    Method
        A pulled estimate is biased. Its intervals have the covariance of the method without regularisation
        with the square of the whole move added: they are never shorter than those without.

    Raises
    ------
    UsageError
        When the method is none that can be regularised, or an argument is of another kind.
    """
    check_linear(method)
    how = Tikhonov() if scheme is None else scheme
    how_far = GeneralizedCrossValidation() if choice is None else choice
    if isinstance(towards, Method):
        _pulled(method, how, how_far, None)  # refuses what cannot be regularised
        return PulledTowards(f"{method.name}_{how.name}", method, how, how_far, towards)
    return _pulled(method, how, how_far, towards)


def _pulled(
    method: LinearMethod,
    scheme: Regularisation,
    choice: ParameterChoice,
    towards: Float[np.ndarray, " n"] | None,
) -> LinearMethod:
    solver: RegularisedLeastSquares | RegularisedTotalLeastSquares
    if isinstance(method.solver, UnweightedLeastSquares):
        solver = RegularisedLeastSquares(scheme, choice, towards)
    elif isinstance(method.solver, GeneralizedTotalLeastSquares):
        solver = RegularisedTotalLeastSquares(scheme, choice, towards)
    else:
        raise UsageError(
            "a method that is solved by least squares or total least squares",
            f"{method.name}, which has {type(method.solver).__name__}",
            "Use generalized_iv(), extended_iv() or least_squares(), for example.",
        )
    return replace(method, name=f"{method.name}_{scheme.name}", solver=solver)
