"""Estimates of linearisable problems: every unknown is one of the method's own linear equations.

The nuisances are searched for like any others, by the least objective of the method (variable projection).
There the equation is linear in small changes of them, with columns whose noise is known; the same method,
given those columns too, must answer that nothing is to be changed. Steps are made until it does, and its
last equations are those that inference reads: a total least squares fit or a compensated one takes the noise
of the nuisances' columns into account just as that of all others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.errors import ConvergenceError, EstimationError
from eivor.estimation.search import Search
from eivor.estimation.solved import Solved
from eivor.linalg.system import Solution
from eivor.models.linearisable import LinearisableProblem
from eivor.models.regression import LinearProblem
from eivor.models.separable import Values
from eivor.shapes import Float

#: Steps after the search: they shrink by a factor each, of which the noise decides.
MOST_STEPS = 60
#: A change of a nuisance that is none, as a share of the span in which it is looked for.
SETTLED = 1e-9

#: A method, from a linear problem to its solution.
Solve = Callable[[LinearProblem], Solved]


@dataclass(frozen=True)
class SettledSolution:
    """Where a method's own equations ask for no change of the nuisances.

    Parameters
    ----------
    at : dict of str to float
        Values of the nuisances.
    solved : Solved
        Solution of the problem beside them: the linear parameters, and changes of the nuisances, none.
    origin : ndarray, shape (n,)
        What the changes are changes of: zero for each linear parameter, and the nuisances' values.
    """

    at: dict[str, float]
    solved: Solved
    origin: Float[np.ndarray, " n"]


def nearly(problem: LinearisableProblem, solve: Solve) -> dict[str, float]:
    """Values of the nuisances with the least objective of a method, to coarse tolerances.

    Raises
    ------
    EstimationError
        When at no value of the nuisances the linear parameters have a unique solution.
    """
    refused: list[EstimationError] = []

    def solution(at: Values) -> Solution:
        return solve(problem.regression(at)).solution

    def objective(at: Values) -> float:
        try:
            return solution(at).objective
        except (
            EstimationError
        ) as error:  # here the columns are those of another order, somewhere they are not
            refused.append(error)
            return np.inf

    def objectives(points: Sequence[Values]) -> Float[np.ndarray, " points"]:
        values = np.array([objective(at) for at in points])
        if not np.isfinite(values).any():
            raise refused[0]
        return values

    return Search(problem.nuisances, {}, solution, objectives, lambda _: 0.0).minimum(coarse=True).at


def settled(problem: LinearisableProblem, solve: Solve, start: Values) -> SettledSolution:
    """Solution beside the values at which a method changes nothing.

    Raises
    ------
    ConvergenceError
        When the steps lead out of the range of a nuisance, or do not end.
    EstimationError
        When the equations have no unique solution.
    """
    low = np.array([nuisance.first for nuisance in problem.nuisances])
    high = np.array([float(nuisance.grid[-1]) for nuisance in problem.nuisances])
    names = [nuisance.name for nuisance in problem.nuisances]
    values = np.array([start[name] for name in names])
    for _ in range(MOST_STEPS):
        at = dict(zip(names, values.tolist(), strict=True))
        theta = solve(problem.regression(at)).solution.theta
        solved = solve(problem.linearised(at, theta))
        change = solved.solution.theta[theta.size :]
        if (np.abs(change) <= SETTLED * (high - low)).all():
            return SettledSolution(at, solved, np.concatenate([np.zeros(theta.size), values]))
        following = np.clip(values + change, low, high)
        if (following == values).any():
            stuck = [name for name, same in zip(names, following == values, strict=True) if same]
            raise ConvergenceError(
                f"a least misfit inside the range of {', '.join(stuck)}",
                f"one at its end, {', '.join(f'{at[name]:g}' for name in stuck)}, or beyond",
                "Give a wider range, or leave out a term that the data do not show.",
            )
        values = following
    raise ConvergenceError(
        f"steps of {', '.join(names)} that end",
        f"some that go on after {MOST_STEPS}",
        "Give a narrower range, a longer record, or less noise: the data hardly tell it.",
    )
