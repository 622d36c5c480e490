"""Linear systems and their solvers; arrays only. A solver is loaded when it is first asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eivor.late import late_names

if TYPE_CHECKING:
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
]

__getattr__ = late_names(
    __name__,
    {
        "AugmentedLeastSquares": "eivor.linalg.least_squares",
        "AugmentedTotalLeastSquares": "eivor.linalg.total_least_squares",
        "DiscrepancyPrinciple": "eivor.linalg.parameter_choice",
        "Fuller": "eivor.linalg.fuller",
        "GeneralizedCrossValidation": "eivor.linalg.parameter_choice",
        "GivenParameter": "eivor.linalg.parameter_choice",
        "ImplicitIteration": "eivor.linalg.regularisation",
        "LCurve": "eivor.linalg.parameter_choice",
        "LeastSquares": "eivor.linalg.least_squares",
        "LinearSystem": "eivor.linalg.system",
        "ParameterChoice": "eivor.linalg.parameter_choice",
        "Regularisation": "eivor.linalg.regularisation",
        "RegularisedLeastSquares": "eivor.linalg.regularised",
        "RegularisedTotalLeastSquares": "eivor.linalg.regularised",
        "Solution": "eivor.linalg.system",
        "Solver": "eivor.linalg.system",
        "Tikhonov": "eivor.linalg.regularisation",
        "TotalLeastSquares": "eivor.linalg.total_least_squares",
    },
)
