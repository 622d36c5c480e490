"""Linear systems and their solvers; arrays only."""

from eivor.linalg.fuller import Fuller
from eivor.linalg.least_squares import AugmentedLeastSquares, LeastSquares
from eivor.linalg.parameter_choice import (
    DiscrepancyPrinciple,
    GeneralizedCrossValidation,
    GivenParameter,
    LCurve,
    ParameterChoice,
)
from eivor.linalg.regularisation import ImplicitIteration, Regularisation, Tikhonov
from eivor.linalg.regularised import RegularisedLeastSquares, RegularisedTotalLeastSquares
from eivor.linalg.system import LinearSystem, Solution, Solver
from eivor.linalg.total_least_squares import AugmentedTotalLeastSquares, TotalLeastSquares
from eivor.linalg.weighted_total_least_squares import weighted_total_least_squares

__all__ = [
    "AugmentedLeastSquares",
    "AugmentedTotalLeastSquares",
    "DiscrepancyPrinciple",
    "Fuller",
    "GeneralizedCrossValidation",
    "GivenParameter",
    "ImplicitIteration",
    "LCurve",
    "LeastSquares",
    "LinearSystem",
    "ParameterChoice",
    "Regularisation",
    "RegularisedLeastSquares",
    "RegularisedTotalLeastSquares",
    "Solution",
    "Solver",
    "Tikhonov",
    "TotalLeastSquares",
    "weighted_total_least_squares",
]
