"""Linear systems and their solvers; arrays only. A solver is loaded when it is first asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eivor.late import late_names

if TYPE_CHECKING:
    from eivor.linalg.fuller import Fuller
    from eivor.linalg.least_squares import AugmentedLeastSquares, LeastSquares
    from eivor.linalg.regularised import RegularisedLeastSquares, RegularisedTotalLeastSquares
    from eivor.linalg.system import LinearSystem, Solution, Solver
    from eivor.linalg.total_least_squares import AugmentedTotalLeastSquares, TotalLeastSquares

__all__ = [
    "AugmentedLeastSquares",
    "AugmentedTotalLeastSquares",
    "Fuller",
    "LeastSquares",
    "LinearSystem",
    "RegularisedLeastSquares",
    "RegularisedTotalLeastSquares",
    "Solution",
    "Solver",
    "TotalLeastSquares",
]

__getattr__ = late_names(
    __name__,
    {
        "AugmentedLeastSquares": "eivor.linalg.least_squares",
        "AugmentedTotalLeastSquares": "eivor.linalg.total_least_squares",
        "Fuller": "eivor.linalg.fuller",
        "LeastSquares": "eivor.linalg.least_squares",
        "LinearSystem": "eivor.linalg.system",
        "RegularisedLeastSquares": "eivor.linalg.regularised",
        "RegularisedTotalLeastSquares": "eivor.linalg.regularised",
        "Solution": "eivor.linalg.system",
        "Solver": "eivor.linalg.system",
        "TotalLeastSquares": "eivor.linalg.total_least_squares",
    },
)
