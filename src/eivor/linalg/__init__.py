"""Linear systems and their solvers; arrays only. Solvers load when they are first used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eivor.tools import late_names

if TYPE_CHECKING:
    from eivor.lab.regularised import RegularisedLeastSquares, RegularisedTotalLeastSquares
    from eivor.linalg.system import LinearSystem, Solution, Solver
    from eivor.linalg.total_least_squares import (
        AugmentedLeastSquares,
        AugmentedTotalLeastSquares,
        Fuller,
        LeastSquares,
        TotalLeastSquares,
    )


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
        "AugmentedLeastSquares": "eivor.linalg.total_least_squares",
        "AugmentedTotalLeastSquares": "eivor.linalg.total_least_squares",
        "Fuller": "eivor.linalg.total_least_squares",
        "LeastSquares": "eivor.linalg.total_least_squares",
        "LinearSystem": "eivor.linalg.system",
        "RegularisedLeastSquares": "eivor.lab.regularised",
        "RegularisedTotalLeastSquares": "eivor.lab.regularised",
        "Solution": "eivor.linalg.system",
        "Solver": "eivor.linalg.system",
        "TotalLeastSquares": "eivor.linalg.total_least_squares",
    },
)
