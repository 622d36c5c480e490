"""Search for nuisances by variable projection, and criteria over them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import msgspec
import numpy as np
import scipy

from eivor.errors import ConvergenceError
from eivor.linalg.system import Solution
from eivor.models.separable import ManyValues, Nuisance, Prior, Values
from eivor.tools import Float, Int

#: Axes of a box: one increasing array for each variable.
Box = Sequence[Float[np.ndarray, " _"]]
#: From a box to the values at its points, the last axis the fastest.
Objective = Callable[[Box], Float[np.ndarray, " points"]]

#: Points of a box on one axis, at most and at least; and of a box of several axes about so many.
MOST_POINTS, LEAST_POINTS, BOX_POINTS = 33, 5, 200
#: The search ends where a box's points are so close, as a share of the first box.
FINEST = 2.0**-17
#: Most boxes of a search, and the evaluations of the simplex search that follows.
BOX_ROUNDS, EVALUATIONS = 30, 1000


def argmin(objective: Objective, grid: Box) -> Float[np.ndarray, " axes"]:
    """Place of the least value between the ends of a grid."""
    axes = len(grid)
    if not axes:
        return np.empty(0)
    best = _best_point(objective, grid)
    low, high = (
        np.array(
            [axis[np.clip(index + step, 0, axis.size - 1)] for axis, index in zip(grid, best, strict=True)]
        )
        for step in (-1, 1)
    )
    bottom, top = (np.array([axis[end] for axis in grid]) for end in (0, -1))
    points = min(int(BOX_POINTS ** (1.0 / axes)), MOST_POINTS)
    points = max(points - 1 + points % 2, LEAST_POINTS)  # odd, so that the middle of a box is one of them
    first_width = high - low
    for _ in range(BOX_ROUNDS):
        box = [np.linspace(a, b, points) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
        best = _best_point(objective, box)
        position = np.array([axis[index] for axis, index in zip(box, best, strict=True)])
        spacing = (high - low) / (points - 1)
        at_edge = ((best == 0) & (low > bottom)) | ((best == points - 1) & (high < top))
        if not at_edge.any() and (spacing <= FINEST * first_width).all():
            return position
        half_width = np.where(at_edge, 1.0, 0.5) * (high - low) if at_edge.any() else spacing
        low, high = np.maximum(position - half_width, bottom), np.minimum(position + half_width, top)
    return _along_valley(objective, position, first_width, (bottom, top))


def _along_valley(
    objective: Objective,
    start: Float[np.ndarray, " axes"],
    unit: Float[np.ndarray, " axes"],
    ends: tuple[Float[np.ndarray, " axes"], Float[np.ndarray, " axes"]],
) -> Float[np.ndarray, " axes"]:
    """Least value from a start, where boxes along the axes are too slow."""
    inwards = np.where(start + 0.25 * unit > ends[1], -0.25, 0.25)
    result = scipy.optimize.minimize(
        lambda point: float(objective([*(point * unit)[:, None]])[0]),
        start / unit,
        method="Nelder-Mead",
        bounds=scipy.optimize.Bounds(*(end / unit for end in ends)),
        options={
            "initial_simplex": start / unit + np.vstack([np.zeros_like(start), np.diag(inwards)]),
            "xatol": FINEST,
            "fatol": np.inf,
            "maxfev": EVALUATIONS,
        },
    )
    if result.success:
        return np.asarray(result.x * unit)
    expected = f"a search of {start.size} variables that settles"
    remedy = "Give narrower grids, or more exciting data."
    raise ConvergenceError(expected, f"one that still moves after {result.nfev} evaluations", remedy)


def _best_point(objective: Objective, box: Box) -> Int[np.ndarray, " axes"]:
    index = int(np.argmin(objective(box)))
    return np.array(np.unravel_index(index, [axis.size for axis in box]))


#: Tolerances are so many times coarser where an estimate only gives weights.
COARSE = 10.0
#: Points of a product of grids; but no grid is thinned below three.
PRODUCT_POINTS = 200
#: Local minima of the grid that a search of several nuisances begins at.
STARTS = 2
#: A search of several nuisances ends where its points differ by less than this share of the objective.
LEAST_GAIN = 1e-7
#: Evaluations, for each nuisance, before it is given up.
MOST_EVALUATIONS = 400

#: Values of the nuisances that are sought, in their order.
Point = tuple[float, ...]


@dataclass(frozen=True)
class NuisanceProfile:
    """Objective over the grid of one nuisance, at the best of the others."""

    nuisance: Nuisance
    objective: Float[np.ndarray, " values"]


#: Result of a search: every nuisance's value, the linear parameters there, and the profiles.
Minimum = tuple[dict[str, float], Solution, tuple[NuisanceProfile, ...]]


class Trial(msgspec.Struct, frozen=True):
    """The objective at one point."""

    point: Point
    objective: float
    solution: Solution  # Linear parameters there


def minimised(
    nuisances: tuple[Nuisance, ...],
    solve: Callable[[Values], Solution],
    objectives: Callable[[Sequence[Values]], Float[np.ndarray, " points"]],
    unit: Callable[[Values], float] = lambda _: 0.0,
    *,
    coarse: bool = False,
    costly: bool = False,
    start: Values | None = None,
) -> Minimum:
    """Least objective over all nuisances: for weights only if `coarse`, of few trials if `costly`."""
    unknown = thinned(nuisances, PRODUCT_POINTS)
    names = [nuisance.name for nuisance in unknown]
    fixed = {nuisance.name: nuisance.first for nuisance in nuisances}

    def values_at(point: Point) -> dict[str, float]:
        return {**fixed, **dict(zip(names, point, strict=True))}

    def misfit(point: Point) -> float:
        values = values_at(point)
        return float(sum(nuisance.misfit(values) for nuisance in unknown))

    points: list[Point] = list(product(*(nuisance.grid.tolist() for nuisance in unknown)))
    fit_objectives = objectives([values_at(point) for point in points])
    misfits = np.array([misfit(point) for point in points])

    def from_grid(scale: float) -> tuple[Trial, Float[np.ndarray, " points"]]:
        def trial(point: Point) -> Trial:
            solution = solve(values_at(point))
            return Trial(point, solution.objective + scale * misfit(point), solution)

        objective = fit_objectives + scale * misfits
        lowest = _lowest(_table(objective, unknown), 1 if coarse else STARTS)
        starts = [points[number] for number in lowest]
        if initial is not None and len(unknown) > 1 and trial(initial).objective <= objective.min():
            elsewhere = [] if coarse else [item for item in starts if _apart(item, initial, unknown)]
            starts = [initial, *elsewhere]
        grid_unit = abs(float(objective.min()))
        search = partial(bounded_search, trial, unknown=unknown, unit=grid_unit, costly=costly)
        tried = (_refined(trial, item, unknown, coarse, search) for item in starts)
        best = min(tried, key=lambda item: item.objective)
        if len(unknown) > 1 and not coarse:
            steps = np.array([COARSE * nuisance.tolerance for nuisance in unknown])
            best = search(best, steps=steps, tolerance=1.0)
        return best, objective

    initial = None if start is None else tuple(start[name] for name in names)
    scale = 0.0
    if any(nuisance.prior for nuisance in unknown):
        # In units of the best fit to the data alone, and then of where that has led.
        scale = unit(values_at(points[int(np.argmin(fit_objectives))]))
        if not coarse:
            scale = unit(values_at(from_grid(scale)[0].point))
    best, objective = from_grid(scale)
    return values_at(best.point), best.solution, profiles_of(unknown, objective)


def _table(
    objective: Float[np.ndarray, " points"], nuisances: Sequence[Nuisance]
) -> Float[np.ndarray, "*grid"]:
    """Objective at the points of a product of grids, an axis for each nuisance."""
    return objective.reshape([nuisance.grid.size for nuisance in nuisances])


def _lowest(table: Float[np.ndarray, "*grid"], count: int) -> list[int]:
    """Places of the lowest local minima of a table, the least first."""
    if table.ndim < 2:
        return [int(np.argmin(table))]
    padded = np.pad(table, 1, constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3,) * table.ndim)
    lowest = np.flatnonzero(table <= windows.reshape(*table.shape, -1).min(axis=-1))
    return lowest[np.argsort(table.ravel()[lowest], kind="stable")][:count].tolist()


def _apart(point: Point, other: Point, unknown: tuple[Nuisance, ...]) -> bool:
    pairs = zip(unknown, point, other, strict=True)
    return any(abs(int(np.diff(np.searchsorted(item.grid, ends))[0])) > 1 for item, *ends in pairs)


def _refined(
    trial: Callable[[Point], Trial],
    start: Point,
    unknown: tuple[Nuisance, ...],
    coarse: bool,
    search: Callable[..., Trial],
) -> Trial:
    if not unknown:
        return trial(start)
    if len(unknown) > 1:
        steps = np.array([_step(item.grid, value) for item, value in zip(unknown, start, strict=True)])
        return search(trial(start), steps=steps, tolerance=COARSE)
    (nuisance,), (value,) = unknown, start
    grid, position = nuisance.grid, int(np.searchsorted(nuisance.grid, value))
    bounds = float(grid[max(position - 1, 0)]), float(grid[min(position + 1, grid.size - 1)])
    return brent_search(trial, trial(start), bounds, (COARSE if coarse else 1.0) * nuisance.tolerance)


def thinned(nuisances: tuple[Nuisance, ...], points: int) -> tuple[Nuisance, ...]:
    """Nuisances to be searched for; of several the product of their grids has about so many points."""
    unknown = tuple(nuisance for nuisance in nuisances if nuisance.searched)
    size = max(int(points ** (1.0 / max(len(unknown), 1))), 3)
    if len(unknown) < 2:
        return unknown
    kept = [np.linspace(0, item.grid.size - 1, size).round().astype(np.int64) for item in unknown]
    pairs = zip(unknown, kept, strict=True)
    return tuple(
        item if item.grid.size <= size else replace(item, grid=item.grid[index]) for item, index in pairs
    )


def profiles_of(
    unknown: tuple[Nuisance, ...], objective: Float[np.ndarray, " points"]
) -> tuple[NuisanceProfile, ...]:
    """Objective on a product of grids over each nuisance, at the best of the others."""
    table = _table(objective, unknown)
    every = (np.moveaxis(table, axis, 0).reshape(size, -1) for axis, size in enumerate(table.shape))
    return tuple(NuisanceProfile(item, part.min(axis=1)) for item, part in zip(unknown, every, strict=True))


def brent_search(
    trial: Callable[[Point], Trial], best: Trial, bounds: tuple[float, float], tolerance: float
) -> Trial:
    """Least trial between two values of one nuisance, by Brent's search; never worse than `best`."""
    lowest = best

    def objective(value: float) -> float:
        nonlocal lowest
        tried = trial((float(value),))
        lowest = min(tried, lowest, key=lambda item: item.objective)
        return tried.objective

    scipy.optimize.minimize_scalar(objective, bounds=bounds, method="bounded", options={"xatol": tolerance})
    return lowest


def bounded_search(
    trial: Callable[[Point], Trial],
    best: Trial,
    *,
    unknown: tuple[Nuisance, ...],
    steps: Float[np.ndarray, " q"],
    tolerance: float,
    unit: float,
    costly: bool,
) -> Trial:
    """Least trial within the grids, from a good one, never worse; gains are small as shares of a `unit`."""
    # no derivatives, since the objective has a kink where a delay is a whole sample
    low, high = (np.array([nuisance.grid[end] for nuisance in unknown]) for end in (0, -1))
    names = [nuisance.name for nuisance in unknown]
    units = tolerance * np.array([item.tolerance for item in unknown])
    limit = MOST_EVALUATIONS * len(unknown)
    lowest = best

    def objective(values: Float[np.ndarray, " q"]) -> float:
        nonlocal lowest
        tried = trial(tuple(np.clip(values, low, high).tolist()))
        lowest = min(lowest, tried, key=lambda item: item.objective)
        return tried.objective

    def by_simplices() -> scipy.optimize.OptimizeResult:
        to_sums = np.eye(len(unknown))
        for number, nuisance in enumerate(unknown):
            if nuisance.part_of in names:
                to_sums[names.index(nuisance.part_of), number] = 1.0
        to_values, first = np.linalg.inv(to_sums), to_sums @ np.array(best.point)
        simplex = np.vstack([first, first + np.diag(steps)]) / units
        limits = {"xatol": 1.0, "fatol": tolerance * LEAST_GAIN * unit, "maxfev": limit}
        options = {"initial_simplex": simplex, **limits}
        return scipy.optimize.minimize(
            lambda sums: objective(to_values @ (sums * units)),
            simplex[0],
            method="Nelder-Mead",
            options=options,
        )

    def by_quadratic_models() -> scipy.optimize.OptimizeResult:
        sizes, scale = np.abs(steps), unit or 1.0
        ends = float(min(0.1 * (units / sizes).min(), 1.0))
        return scipy.optimize.minimize(
            lambda position: objective(position * sizes) / scale,
            np.clip(best.point, low, high) / sizes,
            method="COBYQA",
            bounds=scipy.optimize.Bounds(low / sizes, high / sizes),
            options={"initial_tr_radius": 1.0, "final_tr_radius": ends, "maxfev": limit},
        )

    result = by_quadratic_models() if costly else by_simplices()
    if result.success:
        return lowest
    expected = f"a search of {', '.join(names)} that settles"
    remedy = "Give narrower grids, what is known of one of them, or more exciting data."
    raise ConvergenceError(expected, f"one that still gains after {result.nfev} evaluations", remedy)


def _step(grid: Float[np.ndarray, " _"], value: float) -> float:
    """Half the way from a value of a grid to its neighbour, inwards at the last."""
    position = min(int(np.searchsorted(grid, value)), grid.size - 1)
    neighbour = position + 1 if position + 1 < grid.size else position - 1
    return 0.5 * float(grid[neighbour] - value)


#: Nodes of one nuisance, at least; of several together about so many, at most.
FEWEST_NODES, MOST_NODES = 17, 400
#: Slices to a node, and nodes on each side of the estimate: with fewer, sets end between slices.
CLOSER, AROUND = 8, 1


@dataclass(frozen=True)
class Nodes:
    """Product of the nodes of several nuisances, the values of their grids; one node for none."""

    nuisances: tuple[Nuisance, ...]
    fixed: Values  # Of the nuisances that are not searched for

    @cached_property
    def places(self) -> list[Float[np.ndarray, " _"]]:
        """Nodes of each nuisance on its scale."""
        return [item.places_of(item.grid) for item in self.nuisances]

    @cached_property
    def splines(self) -> list[scipy.interpolate.CubicSpline]:
        """Weight of each node of a nuisance, at places between them."""
        return [scipy.interpolate.CubicSpline(places, np.eye(places.size)) for places in self.places]

    @property
    def points(self) -> list[dict[str, float]]:
        """The nuisances' values at every node."""
        return self._points({item.name: item.grid for item in self.nuisances})

    def _points(self, grids: Mapping[str, Float[np.ndarray, " _"]]) -> list[dict[str, float]]:
        every = product(*(grid.tolist() for grid in grids.values()))
        return [{**self.fixed, **dict(zip(grids, values, strict=True))} for values in every]

    def over(self, values: Float[np.ndarray, "T *shape"], box: Box) -> Float[np.ndarray, "points *shape"]:
        """Values at the points of a box, from those at the nodes."""
        sizes = [places.size for places in self.places]
        result = values.reshape(*sizes, *values.shape[1:])  # of which there may be none
        for number, (spline, points) in enumerate(zip(self.splines, box, strict=True)):
            interpolated = np.tensordot(spline(points), result, (1, number))
            result = np.moveaxis(interpolated, 0, number)
        return result.reshape(math.prod(result.shape[: len(sizes)]), *values.shape[1:])

    def weights(self, values: ManyValues) -> Float[np.ndarray, "points T"]:
        """Weight of each node at values of the nuisances."""
        result = np.ones((1, 1))
        for nuisance, spline in zip(self.nuisances, self.splines, strict=True):
            weights = spline(nuisance.places_of(values[nuisance.name]))
            result = (result[:, :, None] * weights[:, None]).reshape(len(weights), -1)
        return result

    def values_at(self, position: Float[np.ndarray, " axes"]) -> Values:
        return {name: float(value[0]) for name, value in self.values_over([*position[:, None]]).items()}

    def values_over(self, box: Box) -> dict[str, Float[np.ndarray, " points"]]:
        """Values of all nuisances at the points of a box."""
        pairs = zip(self.nuisances, box, strict=True)
        mesh = np.meshgrid(*(nuisance.values_at(places) for nuisance, places in pairs), indexing="ij")
        count = math.prod(item.size for item in box)
        values = {name: np.full(count, value) for name, value in self.fixed.items()}
        return values | {
            nuisance.name: item.ravel() for nuisance, item in zip(self.nuisances, mesh, strict=True)
        }

    def misfit(
        self, values: Mapping[str, Float[np.ndarray, "*shape"]], known: Mapping[str, Prior]
    ) -> Float[np.ndarray, "*shape"] | float:
        """Squared distance of values from their priors, in standard errors."""
        named = (nuisance for nuisance in self.nuisances if nuisance.name in known)
        return sum((known[item.name].misfit(item.with_others(values)) for item in named), 0.0)

    def slices(self, nuisance_values: Values) -> list[dict[str, float]]:
        """Values of all nuisances but the first, closer around some."""
        grids = {}
        for nuisance, nodes in zip(self.nuisances[1:], self.places[1:], strict=True):
            centre = float(np.interp(nuisance_values[nuisance.name], nuisance.grid, np.arange(nodes.size)))
            steps = centre + np.arange(-CLOSER * AROUND, CLOSER * AROUND + 1) / CLOSER
            steps = np.clip(steps, 0.0, nodes.size - 1.0)
            places = np.unique(np.append(np.interp(steps, np.arange(nodes.size), nodes), nodes))
            grids[nuisance.name] = nuisance.values_at(places)
        return self._points(grids)


def nodes_of(nuisances: tuple[Nuisance, ...], fewest: int = FEWEST_NODES) -> Nodes:
    """Nodes of the nuisances that are searched for between the values of their grids."""
    unknown = thinned(nuisances, MOST_NODES)
    fixed = {nuisance.name: nuisance.first for nuisance in nuisances if not nuisance.searched}
    fewest = min(fewest, int(MOST_NODES ** (1.0 / max(len(unknown), 1))))
    return Nodes(tuple(_subdivided(nuisance, fewest) for nuisance in unknown), fixed)


def _subdivided(nuisance: Nuisance, fewest: int) -> Nuisance:
    """A nuisance with values between those of its grid, so many or more in all."""
    count = nuisance.grid.size
    subdivisions = -((1 - fewest) // (count - 1))
    if subdivisions == 1:
        return nuisance
    steps = np.arange((count - 1) * subdivisions + 1) / subdivisions
    places = np.interp(steps, np.arange(count), nuisance.places_of(nuisance.grid))
    return replace(nuisance, grid=nuisance.values_at(places))
