"""Linear systems and their solvers; arrays only."""

from __future__ import annotations

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
    "Solution",
    "Solver",
    "TotalLeastSquares",
]
