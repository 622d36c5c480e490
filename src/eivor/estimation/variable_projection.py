"""Search for nuisances: continuous ones by variable projection, discrete ones on nested grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from eivor.errors import ConvergenceError
from eivor.inference.distributions import chi_square_quantile
from eivor.linalg.system import Solution
from eivor.models.separable import Nuisance, Prior, Values, combinations
from eivor.tools import Float, Int

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


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
    points = min(int(BOX_POINTS ** (1.0 / axes)), MOST)
    points = max(points - 1 + points % 2, LEAST)  # odd, so that the middle of a box is one of them
    first = high - low
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
    expected = f"a search of {axes} variables that settles"
    remedy = "Give narrower grids, or more exciting data."
    raise ConvergenceError(expected, f"one that still moves after {BOX_ROUNDS} boxes", remedy)


def _best_point(objective: Objective, box: Box) -> Int[np.ndarray, " axes"]:
    index = int(np.argmin(objective(box)))
    return np.array(np.unravel_index(index, [axis.size for axis in box]))


# -- Search --

#: Where only weights are made of an estimate, tolerances are so many times coarser.
COARSE = 10.0
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
    expected = f"a search of {', '.join(nuisance.name for nuisance in unknown)} that settles"
    remedy = "Give narrower grids, what is known of one of them, or more exciting data."
    raise ConvergenceError(expected, f"one that still gains after {RESTARTS} beginnings", remedy)


# -- Model comparison --

#: Sums that agree to so many decimals are one value [in the nuisances' unit].
DECIMALS = 9


def bounded_sums(nuisances: Iterable[Nuisance]) -> tuple[tuple[str, ...], ...]:
    """Names of the nuisances whose sum is known between bounds, for each such sum."""
    return tuple(
        (nuisance.name, *nuisance.known_with) for nuisance in nuisances if nuisance.bounds is not None
    )


def least_comparable_criteria(
    bounded: Sequence[Sequence[str]], points: Sequence[Values], criteria: Sequence[float]
) -> list[float]:
    """Return for each candidate the least criterion of those it competes with, itself among them."""
    classes = [
        tuple(round(sum(point[name] for name in names), DECIMALS) for names in bounded) for point in points
    ]
    least: dict[tuple[float, ...], float] = {}
    for kind, criterion in zip(classes, criteria, strict=True):
        least[kind] = min(criterion, least.get(kind, math.inf))
    return [least[kind] for kind in classes]


# -- Discrete nuisances --

#: Values of a discrete nuisance fit within this quantile of what the best leaves.
FITTING_LEVEL = 0.95
#: Values explain clearly more where their criterion is below this share of what it was.
CLEARLY_LESS = 0.5

Made = TypeVar("Made")
#: Candidates with the values of nuisances at which they were made.
Found = list[tuple[dict[str, float], Made]]
#: Place of a combination on the grids of nuisances that are not refined.
GridIndex = tuple[int, ...]


def on_nested_grids(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
    rejected: Callable[[Made], bool] = lambda _: False,
) -> tuple[Made, ...]:
    """Candidates in the order of the finest grids."""
    grids = _Grids(made, criterion)
    nuisances, result = grids.while_the_last_alone_fits(nuisances)
    finest, result = grids.halved(nuisances, result)
    if rejected(grids.best_of(result)):
        nuisances, further = grids.where_more_is_explained(nuisances, result)
        longest, together = grids.halved(nuisances, result + further) if further else (finest, result)
        if not rejected(grids.best_of(together)):
            finest, result = longest, together
    return tuple(candidate for _, candidate in sorted(result, key=lambda item: _position(finest, item[0])))


@dataclass(frozen=True)
class _Grids(Generic[Made]):
    """How candidates at combinations of discrete nuisances are made and compared."""

    made: Callable[[dict[str, float], Made | None], Made]
    criterion: Callable[[Made], float]

    def while_the_last_alone_fits(
        self, nuisances: tuple[Nuisance, ...]
    ) -> tuple[tuple[Nuisance, ...], Found[Made]]:
        """Nuisances whose grids go on while that shows the way, and candidates at all of their values."""
        results = [(combination, self.made(combination, None)) for combination in combinations(nuisances)]
        for nuisance in nuisances:
            while nuisance.longer is not nuisance:
                *others, last = self._profile(nuisance, results).values()
                if not min(others, default=last) - last > chi_square_quantile(FITTING_LEVEL, 1):
                    break
                results += self._added(nuisances, nuisance := nuisance.longer, results)
                nuisances = _with(nuisances, nuisance)
        return nuisances, results

    def where_more_is_explained(
        self, nuisances: tuple[Nuisance, ...], result: Found[Made]
    ) -> tuple[tuple[Nuisance, ...], Found[Made]]:
        """Nuisances with all values that they may have, where these explain more, and what is there."""
        further: Found[Made] = []
        for nuisance in nuisances:
            if nuisance.longest is not nuisance:
                new = self._added(nuisances, nuisance.longest, result + further)
                profiles = (self._profile(nuisance, item) for item in (new, result + further))
                if _explain_more(*profiles):
                    further, nuisances = further + new, _with(nuisances, nuisance.longest)
        return nuisances, further

    def halved(
        self, nuisances: tuple[Nuisance, ...], result: Found[Made]
    ) -> tuple[tuple[Nuisance, ...], Found[Made]]:
        """The finest grids, and candidates there beside the best of those that compete with each other."""
        result = list(result)
        for _ in range(max((nuisance.halvings for nuisance in nuisances if nuisance.discrete), default=0)):
            finer = tuple(nuisance.halved for nuisance in nuisances)
            criteria = [self.criterion(candidate) for _, candidate in result]
            least = least_comparable_criteria(bounded_sums(nuisances), [item for item, _ in result], criteria)
            compared = zip(result, criteria, least, strict=True)
            near = [(_position(finer, item), made) for (item, made), value, low in compared if value == low]
            known = {_position(finer, item) for item, _ in result}
            for combination in combinations(finer):
                position = _position(finer, combination)
                neighbours = [made for other, made in near if _adjacent(nuisances, finer, position, other)]
                if neighbours and position not in known:
                    start = min(neighbours, key=self.criterion)
                    result.append((combination, self.made(combination, start)))
            nuisances = finer
        return nuisances, result

    def best_of(self, result: Found[Made]) -> Made:
        """Candidate that fits best."""
        return min((candidate for _, candidate in result), key=self.criterion)

    def _profile(self, nuisance: Nuisance, result: Found[Made]) -> dict[float, float]:
        least: dict[float, float] = {}
        for item, candidate in sorted(result, key=lambda pair: pair[0][nuisance.name]):
            value = item[nuisance.name]
            least[value] = min(self.criterion(candidate), least.get(value, math.inf))
        return least

    def _added(self, nuisances: tuple[Nuisance, ...], longer: Nuisance, result: Found[Made]) -> Found[Made]:
        known, best = {item[longer.name] for item, _ in result}, self.best_of(result)
        every = combinations(_with(nuisances, longer))
        return [(item, self.made(item, best)) for item in every if item[longer.name] not in known]


def _explain_more(new: dict[float, float], before: dict[float, float]) -> bool:
    """Whether the best of further values explains clearly more, and none on the way to it clearly less."""
    if not new:  # bounds of a sum may leave none
        return False
    best = min(new, key=lambda value: new[value])
    highest = max(criterion for value, criterion in new.items() if value <= best)
    allowed = max(before.values()) + chi_square_quantile(FITTING_LEVEL, 1)
    return new[best] < CLEARLY_LESS * min(before.values()) and highest <= allowed


def _with(nuisances: tuple[Nuisance, ...], changed: Nuisance) -> tuple[Nuisance, ...]:
    return tuple(changed if nuisance.name == changed.name else nuisance for nuisance in nuisances)


def reaching(nuisances: tuple[Nuisance, ...], points: Sequence[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose grids are as long as those of which some points are the best."""
    results = []
    for nuisance in nuisances:
        furthest = max(point[nuisance.name] for point in points)
        while nuisance.grid[-1] < furthest and nuisance.longer is not nuisance:
            nuisance = nuisance.longer  # noqa: PLW2901
        results.append(nuisance)
    return tuple(results)


def with_values_tried(nuisances: tuple[Nuisance, ...], tried: Iterable[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose discrete ones have the values of some candidates, and no steps to be halved."""
    points = list(tried)

    def fixed(nuisance: Nuisance) -> Nuisance:
        values = np.unique([point[nuisance.name] for point in points])
        return replace(nuisance, grid=values, halvings=0, furthest=None)

    return tuple(fixed(item) if item.discrete and item.halvings else item for item in nuisances)


def _position(nuisances: tuple[Nuisance, ...], values: Values) -> GridIndex:
    """Place on the grids; of a nuisance with bounds on that of the sum."""

    def index(nuisance: Nuisance) -> int:
        value = values[nuisance.name] if nuisance.bounds is None else nuisance.with_others(values)
        return int(np.argmin(np.abs(nuisance.grid - value)))

    return tuple(index(nuisance) for nuisance in nuisances if not nuisance.refined)


def _adjacent(
    nuisances: tuple[Nuisance, ...], finer: tuple[Nuisance, ...], position: GridIndex, other: GridIndex
) -> bool:
    """Whether two places on the finer grids differ by one step at most, and where steps were halved only."""
    pairs = zip(nuisances, finer, strict=True)
    steps = [fine.grid.size > coarse.grid.size for coarse, fine in pairs if not coarse.refined]
    return all(abs(a - b) <= step for a, b, step in zip(position, other, steps, strict=True))


# -- Nodes --

#: Nodes of one nuisance, at least; of several together about so many, at most.
FEWEST_NODES, MOST_NODES = 17, 1000


@dataclass(frozen=True)
class NodeAxis:
    """Nodes of one nuisance."""

    nuisance: Nuisance
    values: Float[np.ndarray, " T"]

    @cached_property
    def nodes(self) -> Float[np.ndarray, " T"]:
        """Nodes on the spline's scale."""
        return np.log(self.values) if self.nuisance.positive else self.values

    def values_at(self, positions: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Values of the nuisance at places of the scale."""
        return np.exp(positions) if self.nuisance.positive else positions

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.nodes, np.eye(self.nodes.size))

    def weights(self, positions: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k T"]:
        """What each node counts at places between them."""
        return np.asarray(self._spline(positions))


@dataclass(frozen=True)
class Nodes:
    """Product of the nodes of several nuisances; one node for none."""

    axes: tuple[NodeAxis, ...]

    @property
    def points(self) -> list[dict[str, float]]:
        """The nuisances' values at every node."""
        names = [axis.nuisance.name for axis in self.axes]
        return [
            dict(zip(names, values, strict=True))
            for values in product(*(axis.values.tolist() for axis in self.axes))
        ]

    @property
    def nodes(self) -> list[Float[np.ndarray, " _"]]:
        """Nodes on the scale of each axis."""
        return [axis.nodes for axis in self.axes]

    def box(self, positions: Float[np.ndarray, " k"]) -> Box:
        """Places of the one nuisance that there is, as a box; an empty one for none."""
        return [positions] if self.axes else []

    def over(self, values: Float[np.ndarray, "T *shape"], box: Box) -> Float[np.ndarray, "points *shape"]:
        """Values at the points of a box, from those at the nodes."""
        sizes = [axis.nodes.size for axis in self.axes]
        result = values.reshape(*sizes, *values.shape[1:])  # of which there may be none
        for number, (axis, item) in enumerate(zip(self.axes, box, strict=True)):
            moved = np.tensordot(axis.weights(item), result, (1, number))
            result = np.moveaxis(moved, 0, number)
        return result.reshape(math.prod(result.shape[: len(sizes)]), *values.shape[1:])

    def weights(self, position: Float[np.ndarray, " axes"]) -> Float[np.ndarray, " T"]:
        """What each node counts at one place."""
        result = np.ones(1)
        for axis, item in zip(self.axes, position, strict=True):
            result = np.outer(result, axis.weights(np.array([item]))[0]).ravel()
        return result

    def values_at(self, position: Float[np.ndarray, " axes"]) -> Values:
        """The nuisances' values at one place."""
        return {
            axis.nuisance.name: float(axis.values_at(np.array([item]))[0])
            for axis, item in zip(self.axes, position, strict=True)
        }

    def misfit(self, box: Box, known: Mapping[str, Prior]) -> Float[np.ndarray, " points"]:
        """Squared distance of the points of a box from what is known beforehand, in standard errors."""
        total = np.zeros(1)
        for axis, item in zip(self.axes, box, strict=True):
            prior = known.get(axis.nuisance.name)
            misfit = np.zeros(item.size) if prior is None else prior.misfit(axis.values_at(item))
            total = np.add.outer(total, misfit).ravel()
        return total


def nodes_of(nuisances: tuple[Nuisance, ...], fewest: int = FEWEST_NODES) -> Nodes:
    """Nodes of the nuisances that are searched for between the values of their grids."""
    unknown = tuple(nuisance for nuisance in nuisances if nuisance.refined)
    grids = zip(unknown, product_grids(unknown, MOST_NODES), strict=True)
    fewest = min(fewest, int(MOST_NODES ** (1.0 / max(len(unknown), 1))))
    return Nodes(tuple(NodeAxis(nuisance, _fine(nuisance, grid, fewest)) for nuisance, grid in grids))


def _fine(nuisance: Nuisance, grid: Float[np.ndarray, " _"], fewest: int) -> Float[np.ndarray, " T"]:
    """A grid with as many values between its own as make it fine enough."""
    between = -((1 - fewest) // (grid.size - 1))
    if between == 1:
        return grid
    axis = NodeAxis(nuisance, grid)
    steps = np.arange((grid.size - 1) * between + 1) / between
    return axis.values_at(np.interp(steps, np.arange(grid.size), axis.nodes))


# -- Nuisance scan --

#: Places between two nodes at which minima are looked for.
BETWEEN = 4
#: Points and rounds of a closer look: each round is finer by half the points.
SCAN_POINTS, SCAN_ROUNDS = 17, 6
#: Places over each stretch of a nuisance, closer towards its ends.
POSITIONS = 65

Points = Float[np.ndarray, " k"]


@dataclass(frozen=True)
class NuisanceScan:
    """A criterion over one continuous nuisance, or over none."""

    nodes: Nodes
    least: Callable[[Points], Points]

    @cached_property
    def scanned(self) -> tuple[Points, Points]:
        """Places between the nodes and all minima among them, in order, and the criterion there."""
        if not self.nodes.axes:
            positions = np.zeros(1)
            return positions, self.least(positions)
        (nodes,) = self.nodes.nodes
        steps = np.arange((nodes.size - 1) * BETWEEN + 1) / BETWEEN
        positions = np.interp(steps, np.arange(nodes.size), nodes)
        J = self.least(positions)
        padded = np.concatenate([[np.inf], J, [np.inf]])
        lowest = np.flatnonzero((padded[:-2] >= J) & (padded[2:] >= J))
        results = [
            self._minimum(positions[max(item - 1, 0)], positions[min(item + 1, positions.size - 1)])
            for item in lowest
        ]
        positions = np.unique(np.concatenate([positions, results]))
        return positions, self.least(positions)

    @property
    def minimum(self) -> tuple[float, float]:
        """Place of the least, and the criterion there."""
        positions, J = self.scanned
        index = int(np.argmin(J))
        return float(positions[index]), float(J[index])

    def stretches(self, bound: float) -> Iterator[tuple[Points, bool]]:
        """Stretches in which the criterion is at most a bound."""
        positions, J = self.scanned
        fits = np.concatenate([[False], bound >= J, [False]])
        starts, stops = np.flatnonzero(~fits[:-1] & fits[1:]), np.flatnonzero(fits[:-1] & ~fits[1:])
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            low, high = float(positions[start]), float(positions[stop - 1])
            if start > 0:
                low = self._end(low, float(positions[start - 1]), bound)
            if stop < positions.size:
                high = self._end(high, float(positions[stop]), bound)
            turned = 0.5 - 0.5 * np.cos(np.pi * np.arange(POSITIONS) / (POSITIONS - 1))
            within = np.unique(np.concatenate([low + (high - low) * turned, positions[start:stop]]))
            yield within, stop == positions.size and any(axis.nuisance.positive for axis in self.nodes.axes)

    def _minimum(self, low: float, high: float) -> float:
        for _ in range(SCAN_ROUNDS):
            positions = np.linspace(low, high, SCAN_POINTS)
            index = int(np.argmin(self.least(positions)))
            low, high = float(positions[max(index - 1, 0)]), float(positions[min(index + 1, SCAN_POINTS - 1)])
        return 0.5 * (low + high)

    def _end(self, inside: float, outside: float, bound: float) -> float:
        """Last place with the criterion below a bound on the way from one that has it to one that has not."""
        for _ in range(SCAN_ROUNDS):
            positions = np.linspace(inside, outside, SCAN_POINTS)
            first_out = int(np.argmax(self.least(positions[1:]) > bound)) + 1
            inside, outside = float(positions[first_out - 1]), float(positions[first_out])
        return inside
