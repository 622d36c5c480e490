"""Variable projection: the lag that minimises what is left after the linear parameters are solved for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.estimation.method import Method
from eivor.estimation.solve import solve
from eivor.estimation.weighting import Weights
from eivor.linalg.system import Solution
from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem

#: Lags are refined to this accuracy [s]; to the coarse one where only weights are made from them.
LAG_TOLERANCE_S = 1e-6
COARSE_TOLERANCE_S = 1e-3
#: Relative half-step of the numerical derivative by the lag.
LAG_DIFFERENCE = 1e-3


@dataclass(frozen=True)
class LagProfile:
    """Objective over the grid of lags, and its refined minimum, at one delay.

    Parameters
    ----------
    lags_s, objective : ndarray, shape (lags,)
        Grid [s] and what is left at each lag.
    lag_s : float
        Minimiser [s].
    solution : Solution
        Linear parameters there.
    """

    lags_s: Float[np.ndarray, " lags"]
    objective: Float[np.ndarray, " lags"]
    lag_s: float
    solution: Solution


def no_lag(solution: Solution) -> LagProfile:
    """Profile of a problem without a lag to search for."""
    return LagProfile(np.zeros(1), np.array([solution.objective]), 0.0, solution)


def search_lag(
    problem: SeparableProblem, method: Method, weights: Weights, delay_s: float, tolerance_s: float
) -> LagProfile:
    """Profile the objective over the grid of lags and refine the minimum between its neighbours.

    Parameters
    ----------
    problem : SeparableProblem
        What to estimate.
    method : Method
        Its assembler and solver are used.
    weights : Weights
        Fixed during the search.
    delay_s, tolerance_s : float
        Delay, and accuracy of the lag [s].

    Notes
    -----
    The minimum on the grid is refined between its neighbours by golden sections.
    """

    def solved(lag_s: float) -> Solution:
        return solve(method, weights.regression(problem, lag_s, delay_s)).solution

    grid = problem.lag_grid_s
    solutions = [solved(float(lag)) for lag in grid]
    objective = np.array([solution.objective for solution in solutions])
    best = int(np.argmin(objective))
    lag_s, solution = float(grid[best]), solutions[best]
    if grid.size > 1:
        bounds = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)]))
        lag_s, solution = golden_section(solved, bounds, (lag_s, solution), tolerance_s)
    return LagProfile(grid, objective, lag_s, solution)


def golden_section(
    solved: Callable[[float], Solution],
    bounds: tuple[float, float],
    best: tuple[float, Solution],
    tolerance_s: float,
) -> tuple[float, Solution]:
    """Lag of the least objective between two bounds, and its solution; never worse than `best`."""
    low, high = bounds
    share = 0.5 * (np.sqrt(5.0) - 1.0)
    lags = [high - share * (high - low), low + share * (high - low)]
    solutions = [solved(lag) for lag in lags]
    while high - low > tolerance_s:
        if solutions[0].objective <= solutions[1].objective:
            high, lags[1], solutions[1] = lags[1], lags[0], solutions[0]
            lags[0] = high - share * (high - low)
            solutions[0] = solved(lags[0])
        else:
            low, lags[0], solutions[0] = lags[0], lags[1], solutions[1]
            lags[1] = low + share * (high - low)
            solutions[1] = solved(lags[1])
    pairs = [best, *zip(lags, solutions, strict=True)]
    return min(pairs, key=lambda pair: pair[1].objective)


def lag_column(
    problem: SeparableProblem,
    weights: Weights,
    theta: Float[np.ndarray, " n"],
    lag_s: float,
    delay_s: float,
) -> tuple[Regression, Float[np.ndarray, " rows"]]:
    """Weighted rows at a lag, and the derivative of Phi theta by the lag, by a central difference."""
    step = LAG_DIFFERENCE * lag_s
    above = weights.regression(problem, lag_s + step, delay_s).regressors
    below = weights.regression(problem, lag_s - step, delay_s).regressors
    return weights.regression(problem, lag_s, delay_s), (above - below) @ theta / (2.0 * step)
