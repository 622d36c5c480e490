"""Linear systems and their solvers; arrays only."""

from eivor.linalg.least_squares import LeastSquares
from eivor.linalg.system import LinearSystem, Solution, Solver
from eivor.linalg.total_least_squares import TotalLeastSquares

__all__ = ["LeastSquares", "LinearSystem", "Solution", "Solver", "TotalLeastSquares"]
