"""Search for nuisance parameters by variable projection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from eivor.errors import ConvergenceError
from eivor.linalg.system import Solution
from eivor.models.separable import Nuisance, Values
from eivor.tools import Float, Int

# -- Box search --

#: Axes of a box: one increasing array for each variable.
Box = Sequence[Float[np.ndarray, " _"]]
#: From a box to the values at its points, the last axis the fastest.
Objective = Callable[[Box], Float[np.ndarray, " points"]]

#: Points of a box on one axis, at most and at least; and of a box of several axes about so many.
MOST, LEAST, BOX_POINTS = 33, 5, 200
#: The search ends where a box's points are so close, as a share of the first box.
FINEST = 2.0**-17
#: Boxes before a search is given up.
BOX_ROUNDS = 100


def argmin(objective: Objective, grid: Box) -> Float[np.ndarray, " axes"]:
    """Place of the least value between the ends of a grid."""
    axes = len(grid)
    if not axes:
        return np.empty(0)
    best = _best_point(objective, grid)
    low, high = (
        np.array(
            [axis[np.clip(item + step, 0, axis.size - 1)] for axis, item in zip(grid, best, strict=True)]
        )
        for step in (-1, 1)
    )
    bottom, top = (np.array([axis[end] for axis in grid]) for end in (0, -1))
    first, points = high - low, _points(axes)
    for _ in range(BOX_ROUNDS):
        box = [np.linspace(a, b, points) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
        best = _best_point(objective, box)
        position = np.array([axis[item] for axis, item in zip(box, best, strict=True)])
        spacing = (high - low) / (points - 1)
        at_edge = ((best == 0) & (low > bottom)) | ((best == points - 1) & (high < top))
        if not at_edge.any() and (spacing <= FINEST * first).all():
            return position
        reach = np.where(at_edge, 1.0, 0.5) * (high - low) if at_edge.any() else spacing
        low, high = np.maximum(position - reach, bottom), np.minimum(position + reach, top)
    raise ConvergenceError(
        f"a search of {axes} variables that settles",
        f"one that still moves after {BOX_ROUNDS} boxes",
        "Give narrower grids, or more exciting data.",
    )


def _points(axes: int) -> int:
    """Points of a box on each axis, an odd number, so that its middle is one of them."""
    points = min(int(BOX_POINTS ** (1.0 / axes)), MOST)
    return max(points - 1 + points % 2, LEAST)


def _best_point(objective: Objective, box: Box) -> Int[np.ndarray, " axes"]:
    index = int(np.argmin(objective(box)))
    return np.array(np.unravel_index(index, [axis.size for axis in box]))


# -- Search --

#: Where only weights are made of an estimate, tolerances are so many times coarser.
COARSE = 100.0
#: Points of a product of grids; but no grid is thinned below three.
PRODUCT_POINTS = 200
#: A search of several nuisances has settled when beginning again gains less than this share of the
#: objective; so often it may begin.
LEAST_GAIN = 1e-10
RESTARTS = 20

#: Values of the nuisances that are sought, in their order.
Point = tuple[float, ...]


@dataclass(frozen=True)
class NuisanceProfile:
    """Objective over the grid of one nuisance, at the best of the others."""

    nuisance: Nuisance
    grid: Float[np.ndarray, " values"]
    objective: Float[np.ndarray, " values"]


@dataclass(frozen=True)
class Minimum:
    """What a search determined."""

    nuisances: dict[str, float]  # Every nuisance's value
    solution: Solution  # Linear parameters there
    profiles: tuple[NuisanceProfile, ...]


@dataclass(frozen=True, slots=True)
class Trial:
    """The objective at one point."""

    point: Point
    objective: float
    solution: Solution  # Linear parameters there


def minimised(
    unknown: tuple[Nuisance, ...],
    fixed: Values,
    solve: Callable[[Values], Solution],
    objectives: Callable[[Sequence[Values]], Float[np.ndarray, " points"]],
    unit: Callable[[Values], float] = lambda _: 0.0,
    *,
    coarse: bool = False,
) -> Minimum:
    """Minimise the objective over nuisances, the others `fixed`; where `coarse` to make weights only."""
    names = [nuisance.name for nuisance in unknown]
    grids = product_grids(unknown)

    def at(point: Point) -> dict[str, float]:
        return {**fixed, **dict(zip(names, point, strict=True))}

    def misfit(point: Point) -> float:
        values = at(point)
        return float(sum(nuisance.misfit(values) for nuisance in unknown))

    points: list[Point] = list(product(*(tuple(grid.tolist()) for grid in grids)))
    left = objectives([at(point) for point in points])
    misfits = np.array([misfit(point) for point in points])

    def from_grid(scale: float) -> tuple[Trial, Float[np.ndarray, " points"]]:
        def trial(point: Point) -> Trial:
            solution = solve(at(point))
            return Trial(point, solution.objective + scale * misfit(point), solution)

        objective = left + scale * misfits
        index = int(np.argmin(objective))
        best = Trial(points[index], float(objective[index]), solve(at(points[index])))
        return _refined(trial, best, unknown, grids, COARSE if coarse else 1.0), objective

    if any(nuisance.prior for nuisance in unknown):
        # In units of the best fit to the data alone, and then of where that has led.
        first, _ = from_grid(unit(at(points[int(np.argmin(left))])))
        best, objective = from_grid(unit(at(first.point)))
    else:
        best, objective = from_grid(0.0)
    return Minimum(at(best.point), best.solution, profiles_of(unknown, grids, objective))


def _refined(
    trial: Callable[[Point], Trial],
    best: Trial,
    unknown: tuple[Nuisance, ...],
    grids: list[Float[np.ndarray, " _"]],
    tolerance: float,
) -> Trial:
    """Least trial between the grid's points, never worse than the best of these."""
    if not unknown:
        return best
    if len(unknown) > 1:
        return bounded_search(trial, best, unknown, grids, tolerance)
    (nuisance,), (grid,), (value,) = unknown, grids, best.point
    position = int(np.searchsorted(grid, value))
    bounds = float(grid[max(position - 1, 0)]), float(grid[min(position + 1, grid.size - 1)])
    return between(trial, best, bounds, tolerance * nuisance.tolerance)


def product_grids(
    unknown: tuple[Nuisance, ...], points: int = PRODUCT_POINTS
) -> list[Float[np.ndarray, " _"]]:
    """Grid of each nuisance, thinned where there are several so that their product has so many points."""
    if len(unknown) < 2:
        return [nuisance.grid for nuisance in unknown]
    most = max(int(points ** (1.0 / len(unknown))), 3)
    return [
        grid if grid.size <= most else grid[np.linspace(0, grid.size - 1, most).round().astype(np.int64)]
        for grid in (nuisance.grid for nuisance in unknown)
    ]


def profiles_of(
    unknown: tuple[Nuisance, ...],
    grids: list[Float[np.ndarray, " _"]],
    objective: Float[np.ndarray, " points"],
) -> tuple[NuisanceProfile, ...]:
    """Objective on a product of grids over each nuisance, at the best of the others."""
    table = objective.reshape([grid.size for grid in grids])
    return tuple(
        NuisanceProfile(nuisance, grid, np.moveaxis(table, number, 0).reshape(grid.size, -1).min(axis=1))
        for number, (nuisance, grid) in enumerate(zip(unknown, grids, strict=True))
    )


def between(
    trial: Callable[[Point], Trial], best: Trial, bounds: tuple[float, float], tolerance: float
) -> Trial:
    """Least trial between two values of one nuisance, by Brent's search; never worse than `best`."""
    from scipy.optimize import minimize_scalar

    least = best

    def objective(value: float) -> float:
        nonlocal least
        tried = trial((float(value),))
        least = min(tried, least, key=lambda item: item.objective)
        return tried.objective

    minimize_scalar(objective, bounds=bounds, method="bounded", options={"xatol": tolerance})
    return least


def bounded_search(
    trial: Callable[[Point], Trial],
    best: Trial,
    unknown: tuple[Nuisance, ...],
    grids: list[Float[np.ndarray, " _"]],
    tolerance: float,
) -> Trial:
    """Least trial of several nuisances within their grids, from a good one; never worse than that."""
    from scipy.optimize import minimize

    ends = np.array([[nuisance.grid[0], nuisance.grid[-1]] for nuisance in unknown])
    ratios = np.array([nuisance.positive for nuisance in unknown])

    def scaled(values: Float[np.ndarray, " q"]) -> Float[np.ndarray, " q"]:
        logs = np.where(ratios, np.log(np.where(ratios, values, 1.0)), values)
        return np.asarray(logs)

    low, high = scaled(ends[:, 0]), scaled(ends[:, 1])

    def point_of(position: Float[np.ndarray, " q"]) -> Point:
        values = low + np.clip(position, 0.0, 1.0) * (high - low)
        values = np.clip(np.where(ratios, np.exp(np.where(ratios, values, 0.0)), values), *ends.T)
        return tuple(values.tolist())

    result = best

    def left_at(index: Float[np.ndarray, " q"]) -> float:
        nonlocal result
        tried = trial(point_of(index))
        result = min(result, tried, key=lambda item: item.objective)
        return tried.objective

    steepest = np.where(ratios, ends[:, 1], 1.0) * (high - low)
    accuracy = float(np.min([n.tolerance for n in unknown] / steepest)) * tolerance
    spacing = float(np.mean([0.5 / (grid.size - 1) for grid in grids]))
    for _ in range(RESTARTS):
        before = result
        minimize(
            left_at,
            (scaled(np.array(before.point)) - low) / (high - low),
            method="COBYQA",
            bounds=[(0.0, 1.0)] * len(unknown),
            options={
                "initial_tr_radius": max(spacing, accuracy),
                "final_tr_radius": accuracy,
                "maxfev": 400 * len(unknown),
            },
        )
        if before.objective - result.objective <= LEAST_GAIN * abs(result.objective):
            return result
        spacing = max(0.1 * spacing, 10.0 * accuracy)
    raise ConvergenceError(
        f"a search of {', '.join(nuisance.name for nuisance in unknown)} that settles",
        f"one that still gains after {RESTARTS} beginnings",
        "Give narrower grids, what is known of one of them, or more exciting data.",
    )
