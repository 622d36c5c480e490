"""Solvers that regularise: least squares, and total least squares, pulled towards a vector.

A regularisation (`eivor.linalg.regularisation`) says how, a choice of its parameter (`parameter_choice`) how
far. A solution that is pulled is biased; `Solution.shrinkage` says how far it was moved, and intervals count
that whole move. Columns that are combinations of one another but for rounding are refused as by every other
solver.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from eivor import checks
from eivor.errors import NonFiniteError, ShapeError
from eivor.linalg.least_squares import UnweightedScore, column_lengths, smallest_singular_value
from eivor.linalg.parameter_choice import GeneralizedCrossValidation, ParameterChoice, check_choice
from eivor.linalg.regularisation import ReducedProblem, Regularisation, Tikhonov
from eivor.linalg.shrinkage_path import shrinkage_path
from eivor.linalg.split_problem import split_problem
from eivor.linalg.system import LinearSystem, Shrinkage, Solution
from eivor.linalg.total_least_squares import ErrorsInColumns
from eivor.linalg.triangular import triangular_root
from eivor.shapes import Float


@dataclass(frozen=True)
class RegularisedLeastSquares(UnweightedScore):
    """Least squares, pulled towards a vector through the shifted augmented system.

    Columns are scaled to unit length first, so that the result does not depend on their units. Every column
    is pulled, an intercept's as well: give its value in `towards`, or leave it out of the model.

    Parameters
    ----------
    scheme : Regularisation
        How; `Tikhonov` by default.
    choice : ParameterChoice
        How far; `GeneralizedCrossValidation` by default.
    towards : ndarray, shape (n,), optional
        In the units of theta; zero by default.

    Raises
    ------
    UsageError, NonFiniteError
        When an argument is of another kind, or a number is not finite.
    """

    scheme: Regularisation = field(default_factory=Tikhonov)
    choice: ParameterChoice = field(default_factory=GeneralizedCrossValidation)
    towards: Float[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "towards", _checked(self.scheme, self.choice, self.towards))

    def solve(self, system: LinearSystem) -> Solution:
        """Regularised solution, see `Solver.solve`.

        Raises
        ------
        EstimationError
            When the choice needs more equations than unknowns and there are not.
        ShapeError
            When there is another number of unknowns than numbers in `towards`.
        """
        n = system.matrix.shape[1]
        scale = column_lengths(system.matrix)
        root = triangular_root(np.column_stack([system.matrix / scale, system.right]))
        _, condition = smallest_singular_value(root[:n, :n])
        outside = float(root[n, n] ** 2) if root.shape[0] > n else 0.0
        towards = _of_length(self.towards, n) * scale
        problem = ReducedProblem(root[:n, :n], root[:n, -1], outside, 0.0, towards, system.equations, 0.0)
        theta, shrinkage = _regularised(problem, self.scheme, self.choice, lambda found: found / scale)
        residual = system.right - system.matrix @ theta
        return Solution(theta, residual, float(residual @ residual), condition, shrinkage)


@dataclass(frozen=True)
class RegularisedTotalLeastSquares(ErrorsInColumns):
    """Generalized total least squares, pulled towards a vector through the shifted augmented system.

    (R'R - sigma^2 I + a I) theta = R' right + a towards, with sigma = sigma_min([A b]), in the coordinates in
    which the declared errors are alike; see `GeneralizedTotalLeastSquares` for them. Columns without error
    are not pulled.

    Parameters
    ----------
    scheme, choice, towards
        As of `RegularisedLeastSquares`.

    Raises
    ------
    UsageError, NonFiniteError
        When an argument is of another kind, or a number is not finite.
    """

    scheme: Regularisation = field(default_factory=Tikhonov)
    choice: ParameterChoice = field(default_factory=GeneralizedCrossValidation)
    towards: Float[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "towards", _checked(self.scheme, self.choice, self.towards))

    def solve(self, system: LinearSystem) -> Solution:
        """Regularised solution, see `RegularisedLeastSquares.solve` and `GeneralizedTotalLeastSquares.solve`.

        Raises
        ------
        TooFewSamplesError, NoUniqueSolutionError, CovarianceError, EstimationError, ShapeError
            As they do.
        """
        split = split_problem(system)
        if not split.noisy.size:
            return split.solution(split.theta(np.empty(0)))
        towards = split.whitened(_of_length(self.towards, system.matrix.shape[1]))
        left = system.equations - split.exact.size
        problem = ReducedProblem(split.R, split.right, split.outside, split.smallest**2, towards, left, 1.0)
        theta, shrinkage = _regularised(problem, self.scheme, self.choice, split.theta)
        return split.solution(theta, shrinkage)


def _regularised(
    problem: ReducedProblem,
    scheme: Regularisation,
    choice: ParameterChoice,
    back: Callable[[Float[np.ndarray, " q"]], Float[np.ndarray, " n"]],
) -> tuple[Float[np.ndarray, " n"], Shrinkage]:
    """Theta at the chosen parameter, and what was done to it."""
    path = shrinkage_path(problem, scheme, choice.parameters(scheme))
    place = choice.chosen(path)
    parameter = float(path.parameters[place])
    theta = back(scheme.solution(problem, parameter))
    unmoved = back(problem.pulled(0.0, problem.towards))
    return theta, Shrinkage(scheme.name, choice.name, parameter, float(path.kept[place]), theta - unmoved)


def _checked(
    scheme: object, choice: object, towards: Float[np.ndarray, " n"] | None
) -> Float[np.ndarray, " n"] | None:
    checks.kind("scheme", scheme, Regularisation, "a regularisation", "Make one: Tikhonov().")
    check_choice(choice)
    if towards is None:
        return None
    vector = checks.real_array("towards", towards)
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise NonFiniteError("a vector of finite numbers", f"{vector}", "Give one number for each parameter.")
    return vector


def _of_length(towards: Float[np.ndarray, " _"] | None, unknowns: int) -> Float[np.ndarray, " n"]:
    if towards is None:
        return np.zeros(unknowns)
    if towards.size != unknowns:
        raise ShapeError(
            f"{unknowns} numbers to be pulled towards, one for each parameter",
            f"{towards.size}",
            "Give them in the order of the parameters.",
        )
    return towards
