"""Linear systems and their solvers; arrays only."""

from eivor.linalg.least_squares import AugmentedLeastSquares, LeastSquares
from eivor.linalg.system import LinearSystem, Solution, Solver
from eivor.linalg.total_least_squares import AugmentedTotalLeastSquares, TotalLeastSquares
from eivor.linalg.weighted_total_least_squares import weighted_total_least_squares

__all__ = [
    "AugmentedLeastSquares",
    "AugmentedTotalLeastSquares",
    "LeastSquares",
    "LinearSystem",
    "Solution",
    "Solver",
    "TotalLeastSquares",
    "weighted_total_least_squares",
]
