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
    return tuple((one.name, *one.known_with) for one in nuisances if one.bounds is not None)


def least_of_competitors(
    bounded: Sequence[Sequence[str]], points: Sequence[Values], criteria: Sequence[float]
) -> list[float]:
    """Return for each candidate the least criterion of those it competes with, itself among them."""
    classes = [tuple(round(sum(at[name] for name in names), DECIMALS) for names in bounded) for at in points]
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
    found = [(at, made(at, None)) for at in combinations(nuisances)]
    for one in nuisances:
        while one.longer is not one and _last_alone_fits(one, found, criterion):
            found += _added(nuisances, one := one.longer, found, made, criterion)
            nuisances = _with(nuisances, one)
    return nuisances, found


def where_more_is_explained(
    nuisances: tuple[Nuisance, ...],
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """Nuisances with all values that they may have, where these explain more, and what is found there."""
    further: Found[Made] = []
    for one in nuisances:
        if one.longest is not one:
            new = _added(nuisances, one.longest, found + further, made, criterion)
            if _explain_more(_profile(one, new, criterion), _profile(one, found + further, criterion)):
                further, nuisances = further + new, _with(nuisances, one.longest)
    return nuisances, further


def reaching(nuisances: tuple[Nuisance, ...], points: Sequence[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose grids are as long as those of which some points are the best."""
    return tuple(_reaching(one, max(at[one.name] for at in points)) for one in nuisances)


def _reaching(one: Nuisance, value: float) -> Nuisance:
    while one.grid[-1] < value and one.longer is not one:
        one = one.longer
    return one


def _profile(one: Nuisance, found: Found[Made], criterion: Callable[[Made], float]) -> dict[float, float]:
    """Least criterion at each value of a nuisance, in their order."""
    least: dict[float, float] = {}
    for at, candidate in sorted(found, key=lambda pair: pair[0][one.name]):
        value = at[one.name]
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


def _last_alone_fits(one: Nuisance, found: Found[Made], criterion: Callable[[Made], float]) -> bool:
    *others, last = _profile(one, found, criterion).values()
    return min(others, default=last) - last > chi_square_quantile(FITTING_LEVEL, 1)


def _added(
    nuisances: tuple[Nuisance, ...],
    longer: Nuisance,
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> Found[Made]:
    """Candidates at the values that a longer grid has more."""
    known, beside = {at[longer.name] for at, _ in found}, best_of(found, criterion)
    new = [at for at in combinations(_with(nuisances, longer)) if at[longer.name] not in known]
    return [(at, made(at, beside)) for at in new]


def _with(nuisances: tuple[Nuisance, ...], changed: Nuisance) -> tuple[Nuisance, ...]:
    return tuple(changed if one.name == changed.name else one for one in nuisances)


def best_of(found: Found[Made], criterion: Callable[[Made], float]) -> Made:
    """Candidate that fits best."""
    return min((candidate for _, candidate in found), key=criterion)


# -- Nested grids --

#: Place of a combination on the grids of nuisances that are not refined.
Place = tuple[int, ...]


def on_nested_grids(
    nuisances: tuple[Nuisance, ...],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
    rejected: Callable[[Made], bool] = lambda _: False,
) -> tuple[Made, ...]:
    """Candidates in the order of the finest grids."""
    nuisances, found = while_the_last_alone_fits(nuisances, made, criterion)
    finest, found = _halved(nuisances, found, made, criterion)
    if rejected(best_of(found, criterion)):
        nuisances, further = where_more_is_explained(nuisances, found, made, criterion)
        longest, together = (
            _halved(nuisances, found + further, made, criterion) if further else (finest, found)
        )
        if not rejected(best_of(together, criterion)):
            finest, found = longest, together
    return tuple(candidate for _, candidate in sorted(found, key=lambda one: _place(finest, one[0])))


def _halved(
    nuisances: tuple[Nuisance, ...],
    found: Found[Made],
    made: Callable[[dict[str, float], Made | None], Made],
    criterion: Callable[[Made], float],
) -> tuple[tuple[Nuisance, ...], Found[Made]]:
    """The finest grids, and candidates there beside the best."""
    found = list(found)
    for _ in range(max((one.halvings for one in nuisances if one.discrete), default=0)):
        finer = tuple(one.halved for one in nuisances)
        best = list(_best_candidates(nuisances, found, criterion))
        known = {_place(finer, at) for at, _ in found}
        near = [(_place(finer, at), candidate) for at, candidate in best]
        for at in combinations(finer):
            place = _place(finer, at)
            beside = [candidate for other, candidate in near if _adjacent(nuisances, finer, place, other)]
            if beside and place not in known:
                found.append((at, made(at, min(beside, key=criterion))))
        nuisances = finer
    return nuisances, found


def with_values_tried(nuisances: tuple[Nuisance, ...], tried: Iterable[Values]) -> tuple[Nuisance, ...]:
    """Nuisances whose discrete ones have the values of some candidates, and no steps to be halved."""
    points = list(tried)
    return tuple(
        replace(one, grid=np.unique([at[one.name] for at in points]), halvings=0, furthest=None)
        if one.discrete and one.halvings
        else one
        for one in nuisances
    )


def _best_candidates(
    nuisances: tuple[Nuisance, ...],
    found: list[tuple[dict[str, float], Made]],
    criterion: Callable[[Made], float],
) -> Iterator[tuple[dict[str, float], Made]]:
    """Best of the candidates that compete with each other."""
    criteria = [criterion(candidate) for _, candidate in found]
    least = least_of_competitors(bounded_sums(nuisances), [at for at, _ in found], criteria)
    for one, own, lowest in zip(found, criteria, least, strict=True):
        if own == lowest:
            yield one


def _place(nuisances: tuple[Nuisance, ...], at: Values) -> Place:
    """Place on the grids; of a nuisance with bounds on that of the sum."""
    return tuple(
        int(np.argmin(np.abs(one.grid - (at[one.name] if one.bounds is None else one.with_others(at)))))
        for one in nuisances
        if not one.refined
    )


def _adjacent(
    nuisances: tuple[Nuisance, ...], finer: tuple[Nuisance, ...], place: Place, other: Place
) -> bool:
    """Whether two places on the finer grids differ by one step at most, and where steps were halved only."""
    steps = [
        int(fine.grid.size > coarse.grid.size)
        for coarse, fine in zip(nuisances, finer, strict=True)
        if not coarse.refined
    ]
    return all(abs(a - b) <= step for a, b, step in zip(place, other, steps, strict=True))


# -- Nodes --

#: Nodes of one nuisance, at least; of several together about so many, at most.
FEWEST_NODES, MOST_NODES = 17, 1000


@dataclass(frozen=True)
class NodeAxis:
    """Nodes of one nuisance."""

    nuisance: Nuisance
    values: Float[np.ndarray, " T"]

    @cached_property
    def places(self) -> Float[np.ndarray, " T"]:
        """Nodes on the spline's scale."""
        return np.log(self.values) if self.nuisance.positive else self.values

    def at(self, places: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Values of the nuisance at places of the scale."""
        return np.exp(places) if self.nuisance.positive else places

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.places, np.eye(self.places.size))

    def weights(self, places: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k T"]:
        """What each node counts at places between them."""
        return np.asarray(self._spline(places))


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
    def places(self) -> list[Float[np.ndarray, " _"]]:
        """Nodes on the scale of each axis."""
        return [axis.places for axis in self.axes]

    def over(
        self, values: Float[np.ndarray, "T *shape"], box: Sequence[Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, "points *shape"]:
        """Values at the points of a box, from those at the nodes."""
        sizes = [axis.places.size for axis in self.axes]
        found = values.reshape(*sizes, *values.shape[1:])  # of which there may be none
        for number, (axis, places) in enumerate(zip(self.axes, box, strict=True)):
            moved = np.tensordot(axis.weights(places), found, (1, number))
            found = np.moveaxis(moved, 0, number)
        return found.reshape(math.prod(found.shape[: len(sizes)]), *values.shape[1:])

    def weights(self, place: Float[np.ndarray, " axes"]) -> Float[np.ndarray, " T"]:
        """What each node counts at one place."""
        found = np.ones(1)
        for axis, one in zip(self.axes, place, strict=True):
            found = np.outer(found, axis.weights(np.array([one]))[0]).ravel()
        return found

    def at(self, place: Float[np.ndarray, " axes"]) -> Values:
        """The nuisances' values at one place."""
        return {
            axis.nuisance.name: float(axis.at(np.array([one]))[0])
            for axis, one in zip(self.axes, place, strict=True)
        }

    def misfit(
        self, box: Sequence[Float[np.ndarray, " _"]], known: Mapping[str, Prior]
    ) -> Float[np.ndarray, " points"]:
        """Squared distance of the points of a box from what is known beforehand, in standard errors."""
        total = np.zeros(1)
        for axis, places in zip(self.axes, box, strict=True):
            prior = known.get(axis.nuisance.name)
            own = np.zeros(places.size) if prior is None else prior.misfit(axis.at(places))
            total = np.add.outer(total, own).ravel()
        return total


def nodes_of(nuisances: tuple[Nuisance, ...], fewest: int = FEWEST_NODES) -> Nodes:
    """Nodes of the nuisances that are searched for between the values of their grids."""
    sought = tuple(nuisance for nuisance in nuisances if nuisance.refined)
    grids = product_grids(sought, MOST_NODES)
    fewest = min(fewest, int(MOST_NODES ** (1.0 / max(len(sought), 1))))
    return Nodes(
        tuple(
            NodeAxis(nuisance, _fine(nuisance, grid, fewest))
            for nuisance, grid in zip(sought, grids, strict=True)
        )
    )


def _fine(nuisance: Nuisance, grid: Float[np.ndarray, " _"], fewest: int) -> Float[np.ndarray, " T"]:
    """A grid with as many values between its own as make it fine enough."""
    between = -((1 - fewest) // (grid.size - 1))
    if between == 1:
        return grid
    axis = NodeAxis(nuisance, grid)
    steps = np.arange((grid.size - 1) * between + 1) / between
    return axis.at(np.interp(steps, np.arange(grid.size), axis.places))


# -- Nuisance scan --

#: Places between two nodes at which minima are looked for.
BETWEEN = 4
#: Points and rounds of a closer look: each round is finer by half the points.
SCAN_POINTS, SCAN_ROUNDS = 17, 6
#: Places over each stretch of a nuisance, closer towards its ends.
PLACES = 65

Places = Float[np.ndarray, " k"]


@dataclass(frozen=True)
class NuisanceScan:
    """A criterion over one continuous nuisance, or over none."""

    nodes: Nodes
    least: Callable[[Places], Places]

    @cached_property
    def scanned(self) -> tuple[Places, Places]:
        """Places between the nodes and all minima among them, in order, and the criterion there."""
        if not self.nodes.axes:
            places = np.zeros(1)
            return places, self.least(places)
        (own,) = self.nodes.places
        steps = np.arange((own.size - 1) * BETWEEN + 1) / BETWEEN
        places = np.interp(steps, np.arange(own.size), own)
        J = self.least(places)
        padded = np.concatenate([[np.inf], J, [np.inf]])
        lowest = np.flatnonzero((padded[:-2] >= J) & (padded[2:] >= J))
        found = [self._minimum(places[max(at - 1, 0)], places[min(at + 1, places.size - 1)]) for at in lowest]
        places = np.unique(np.concatenate([places, found]))
        return places, self.least(places)

    @property
    def minimum(self) -> tuple[float, float]:
        """Place of the least, and the criterion there."""
        places, J = self.scanned
        at = int(np.argmin(J))
        return float(places[at]), float(J[at])

    def stretches(self, bound: float) -> Iterator[tuple[Places, bool]]:
        """Stretches in which the criterion is at most a bound."""
        places, J = self.scanned
        fits = np.concatenate([[False], bound >= J, [False]])
        starts, stops = np.flatnonzero(~fits[:-1] & fits[1:]), np.flatnonzero(fits[:-1] & ~fits[1:])
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            low, high = float(places[start]), float(places[stop - 1])
            if start > 0:
                low = self._end(low, float(places[start - 1]), bound)
            if stop < places.size:
                high = self._end(high, float(places[stop]), bound)
            turned = 0.5 - 0.5 * np.cos(np.pi * np.arange(PLACES) / (PLACES - 1))
            within = np.unique(np.concatenate([low + (high - low) * turned, places[start:stop]]))
            yield within, stop == places.size and any(axis.nuisance.positive for axis in self.nodes.axes)

    def _minimum(self, low: float, high: float) -> float:
        for _ in range(SCAN_ROUNDS):
            places = np.linspace(low, high, SCAN_POINTS)
            at = int(np.argmin(self.least(places)))
            low, high = float(places[max(at - 1, 0)]), float(places[min(at + 1, SCAN_POINTS - 1)])
        return 0.5 * (low + high)

    def _end(self, inside: float, outside: float, bound: float) -> float:
        """Last place with the criterion below a bound on the way from one that has it to one that has not."""
        for _ in range(SCAN_ROUNDS):
            places = np.linspace(inside, outside, SCAN_POINTS)
            first_out = int(np.argmax(self.least(places[1:]) > bound)) + 1
            inside, outside = float(places[first_out - 1]), float(places[first_out])
        return inside
