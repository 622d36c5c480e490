"""Grids of nuisances: nested, long and interpolated, and competing candidates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

from eivor.estimation.variable_projection import product_grids
from eivor.inference.distributions import chi_square_quantile
from eivor.models.separable import Nuisance, Prior, Values, combinations
from eivor.tools import Float

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


# -- Long grids --

#: Values of a discrete nuisance fit within this quantile of what the best leaves.
FITTING_LEVEL = 0.95
#: Values explain clearly more where their criterion is below this share of what it was.
CLEARLY_LESS = 0.5

Made = TypeVar("Made")
#: Candidates with the values of nuisances at which they were made.
Found = list[tuple[dict[str, float], Made]]


def while_the_last_alone_fits(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances whose grids go on while that shows the way, and candidates at all of their values."""
    results = [(combination, made(combination, None)) for combination in combinations(nuisances)]
    for nuisance in nuisances:
        while nuisance.longer is not nuisance and _last_alone_fits(nuisance, results, criterion):
            results += _added(nuisances, nuisance := nuisance.longer, results, made, criterion)
            nuisances = _with(nuisances, nuisance)
    return nuisances, results


def where_more_is_explained(
    nuisances: tuple[Nuisance, ...],
    result: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances with all values that they may have, where these explain more, and what is found there."""
    further: Found[Made] = []
    for nuisance in nuisances:
        if nuisance.longest is not nuisance:
            new = _added(nuisances, nuisance.longest, result + further, made, criterion)
            if _explain_more(
                _profile(nuisance, new, criterion), _profile(nuisance, result + further, criterion)
            ):
                further, nuisances = further + new, _with(nuisances, nuisance.longest)
    return nuisances, further


def reaching(nuisances: tuple[Nuisance, ...], points: Sequence[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose grids are as long as those of which some points are the best."""
    return tuple(_reaching(nuisance, max(point[nuisance.name] for point in points)) for nuisance in nuisances)


def _reaching(nuisance: Nuisance, value: float) -> Nuisance:
    while nuisance.grid[-1] < value and nuisance.longer is not nuisance:
        nuisance = nuisance.longer
    return nuisance


def _profile(
    nuisance: Nuisance, result: Found[Made], criterion: Callable[[Made], float]
) -> dict[float, float]:
    """Least criterion at each value of a nuisance, in their order."""
    least: dict[float, float] = {}
    for item, candidate in sorted(result, key=lambda pair: pair[0][nuisance.name]):
        value = item[nuisance.name]
        least[value] = min(criterion(candidate), least.get(value, math.inf))
    return least


def _explain_more(new: dict[float, float], before: dict[float, float]) -> bool:
    """Whether the best of further values explains clearly more, and none on the way to it clearly less."""
    if not new:  # bounds of a sum may leave none
        return False
    best = min(new, key=lambda value: new[value])
    highest = max(criterion for value, criterion in new.items() if value <= best)
    allowed = max(before.values()) + chi_square_quantile(FITTING_LEVEL, 1)
    return new[best] < CLEARLY_LESS * min(before.values()) and highest <= allowed


def _last_alone_fits(nuisance: Nuisance, result: Found[Made], criterion: Callable[[Made], float]) -> bool:
    *others, last = _profile(nuisance, result, criterion).values()
    return min(others, default=last) - last > chi_square_quantile(FITTING_LEVEL, 1)


def _added(
    nuisances: tuple[Nuisance, ...],
    longer: Nuisance,
    result: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> Found[Made]:
    """Candidates at the values that a longer grid has more."""
    known, best = {item[longer.name] for item, _ in result}, best_of(result, criterion)
    new = [
        combination
        for combination in combinations(_with(nuisances, longer))
        if combination[longer.name] not in known
    ]
    return [(item, made(item, best)) for item in new]


def _with(nuisances: tuple[Nuisance, ...], changed: Nuisance) -> tuple[Nuisance, ...]:
    return tuple(changed if nuisance.name == changed.name else nuisance for nuisance in nuisances)


def best_of(result: Found[Made], criterion: Callable[[Made], float]) -> Made:
    """Candidate that fits best."""
    return min((candidate for _, candidate in result), key=criterion)


# -- Nested grids --

#: Place of a combination on the grids of nuisances that are not refined.
GridIndex = tuple[int, ...]


def on_nested_grids(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
    rejected: Callable[[Made], bool] = lambda _: False,
) -> tuple[Made, ...]:
    """Candidates in the order of the finest grids."""
    nuisances, result = while_the_last_alone_fits(nuisances, made, criterion)
    finest, result = _halved(nuisances, result, made, criterion)
    if rejected(best_of(result, criterion)):
        nuisances, further = where_more_is_explained(nuisances, result, made, criterion)
        longest, together = (
            _halved(nuisances, result + further, made, criterion) if further else (finest, result)
        )
        if not rejected(best_of(together, criterion)):
            finest, result = longest, together
    return tuple(candidate for _, candidate in sorted(result, key=lambda item: _position(finest, item[0])))


def _halved(
    nuisances: tuple[Nuisance, ...],
    result: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """The finest grids, and candidates there beside the best."""
    result = list(result)
    for _ in range(max((nuisance.halvings for nuisance in nuisances if nuisance.discrete), default=0)):
        finer = tuple(nuisance.halved for nuisance in nuisances)
        best = list(_best_candidates(nuisances, result, criterion))
        known = {_position(finer, item) for item, _ in result}
        near = [(_position(finer, item), candidate) for item, candidate in best]
        for combination in combinations(finer):
            position = _position(finer, combination)
            neighbours = [
                candidate for other, candidate in near if _adjacent(nuisances, finer, position, other)
            ]
            if neighbours and position not in known:
                result.append((combination, made(combination, min(neighbours, key=criterion))))
        nuisances = finer
    return nuisances, result


def with_values_tried(nuisances: tuple[Nuisance, ...], tried: Iterable[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose discrete ones have the values of some candidates, and no steps to be halved."""
    points = list(tried)
    return tuple(
        replace(
            nuisance, grid=np.unique([point[nuisance.name] for point in points]), halvings=0, furthest=None
        )
        if nuisance.discrete and nuisance.halvings
        else nuisance
        for nuisance in nuisances
    )


def _best_candidates(
    nuisances: tuple[Nuisance, ...],
    result: list[tuple[dict[str, float], Made]],
    criterion: Callable[[Made], float],
) -> Iterator[tuple[dict[str, float], Made]]:
    """Best of the candidates that compete with each other."""
    criteria = [criterion(candidate) for _, candidate in result]
    least = least_comparable_criteria(bounded_sums(nuisances), [item for item, _ in result], criteria)
    for entry, element, lowest in zip(result, criteria, least, strict=True):
        if element == lowest:
            yield entry


def _position(nuisances: tuple[Nuisance, ...], nuisance_values: Values) -> GridIndex:
    """Place on the grids; of a nuisance with bounds on that of the sum."""
    return tuple(
        int(
            np.argmin(
                np.abs(
                    nuisance.grid
                    - (
                        nuisance_values[nuisance.name]
                        if nuisance.bounds is None
                        else nuisance.with_others(nuisance_values)
                    )
                )
            )
        )
        for nuisance in nuisances
        if not nuisance.refined
    )


def _adjacent(
    nuisances: tuple[Nuisance, ...], finer: tuple[Nuisance, ...], position: GridIndex, other: GridIndex
) -> bool:
    """Whether two places on the finer grids differ by one step at most, and where steps were halved only."""
    steps = [
        int(fine.grid.size > coarse.grid.size)
        for coarse, fine in zip(nuisances, finer, strict=True)
        if not coarse.refined
    ]
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

    def over(
        self, values: Float[np.ndarray, "T *shape"], box: Sequence[Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, "points *shape"]:
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

    def misfit(
        self, box: Sequence[Float[np.ndarray, " _"]], known: Mapping[str, Prior]
    ) -> Float[np.ndarray, " points"]:
        """Squared distance of the points of a box from what is known beforehand, in standard errors."""
        total = np.zeros(1)
        for axis, item in zip(self.axes, box, strict=True):
            prior = known.get(axis.nuisance.name)
            current = np.zeros(item.size) if prior is None else prior.misfit(axis.values_at(item))
            total = np.add.outer(total, current).ravel()
        return total


def nodes_of(nuisances: tuple[Nuisance, ...], fewest: int = FEWEST_NODES) -> Nodes:
    """Nodes of the nuisances that are searched for between the values of their grids."""
    unknown = tuple(nuisance for nuisance in nuisances if nuisance.refined)
    grids = product_grids(unknown, MOST_NODES)
    fewest = min(fewest, int(MOST_NODES ** (1.0 / max(len(unknown), 1))))
    return Nodes(
        tuple(
            NodeAxis(nuisance, _fine(nuisance, grid, fewest))
            for nuisance, grid in zip(unknown, grids, strict=True)
        )
    )


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
        (current,) = self.nodes.nodes
        steps = np.arange((current.size - 1) * BETWEEN + 1) / BETWEEN
        positions = np.interp(steps, np.arange(current.size), current)
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
