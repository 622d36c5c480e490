"""Confidence sets of single parameters: a criterion over the nuisances, of one flight or of a pool."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import repeat
from math import inf
from typing import cast

import numpy as np
import scipy

from eivor import checks
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.moments import Instrumental
from eivor.estimation.variable_projection import Box, Nodes, argmin, nodes_of
from eivor.estimation.weighting import RunSums, WeightedRows, WhitenedRows
from eivor.inference import distributions
from eivor.inference.anderson_rubin import Allowed, allowed, concentrated, minimum_ratio
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.models.separable import ManyValues, Nuisance, Prior, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.signals.signals import stretches
from eivor.tools import Bool, Float, Int

#: Directions of an interpolation's columns with smaller shares of power are none.
SMALLEST_POWER = 1e-14


@dataclass(frozen=True)
class NuisanceProducts:
    """Q' [phi y], and R with [phi y]' [phi y] = R' R, at any values of the nuisances, by those at nodes."""

    weights: Callable[[ManyValues], Float[np.ndarray, "points T"]]
    equations: Float[np.ndarray, "T q b"]
    root: Float[np.ndarray, "T r b"]

    @classmethod
    def of_rows(
        cls,
        weights: WhitenedRows,
        nodes: Nodes,
        basis: Float[np.ndarray, "rows q"] | None = None,
        kinds: Iterable[bytes] = repeat(b""),
    ) -> dict[bytes, NuisanceProducts]:
        """Products of the runs of each kind, by default of all, with an orthonormal basis of instruments."""
        source = weights.problem.interpolation or nodes
        sums: dict[tuple[bytes, bytes], RunSums] = {}
        runs = weights.sums(source.points, weights.basis if basis is None else basis)
        for kind, (still, moving, equations, power) in zip(kinds, runs, strict=False):
            key = kind, moving.tobytes()
            *_, E, P = sums.get(key, (0.0, 0.0))
            sums[key] = still, moving, E + equations, P + power
        results: dict[bytes, NuisanceProducts] = {}
        for (kind, _), (still, moving, equations, power) in sums.items():
            products = cls(source.weights, equations, _root(power, still, moving, equations.shape[0]))
            results[kind] = products.joined(results[kind]) if kind in results else products
        return results

    def joined(self, other: NuisanceProducts) -> NuisanceProducts:
        """Products of these rows and of others."""
        root = np.concatenate([self.root, other.root], axis=1)
        return replace(self, equations=self.equations + other.equations, root=root)

    def combined(
        self, columns: Float[np.ndarray, "b c"], instruments: Float[np.ndarray, "q p"] | None = None
    ) -> NuisanceProducts:
        """Products of combinations of the columns, and of the instruments."""
        equations = self.equations if instruments is None else instruments.T @ self.equations
        return replace(self, equations=equations @ columns, root=self.root @ columns)

    def evaluate(
        self, values: ManyValues
    ) -> tuple[Float[np.ndarray, "points q b"], Float[np.ndarray, "points r b"]]:
        weights = self.weights(values)
        return np.tensordot(weights, self.equations, 1), np.tensordot(weights, self.root, 1)


def _root(
    power: np.ndarray, still: Int[np.ndarray, " f"], moving: Int[np.ndarray, " m"], nodes: int
) -> Float[np.ndarray, "nodes r b"]:
    """Root of the products at each node, as smooth between nodes; the same for all if interpolated."""
    count, size = still.size, int(still[-1]) + 1
    lengths = np.sqrt(np.diagonal(power.mean(axis=0) if power.ndim > 2 else power))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    squares, directions = np.linalg.eigh(power / np.outer(lengths, lengths))
    root = np.sqrt(np.maximum(squares, 0.0))[..., None] * directions.swapaxes(-1, -2)
    if power.ndim > 2:
        root = directions @ root * lengths
        moving_root = root[..., count:]
    else:
        root = root[squares > SMALLEST_POWER * squares[-1]] * lengths
        moving_root = root[:, count:].reshape(len(root), nodes, moving.size).swapaxes(0, 1)
    result = np.zeros((nodes, root.shape[-2], size))
    result[..., still], result[..., moving] = root[..., :count], moving_root
    return result


@dataclass(frozen=True)
class PoolMember:
    """Products of one flight."""

    weights: WeightedRows
    centre: Float[np.ndarray, " n"]  # Linear parameters at which the response is taken
    products: NuisanceProducts  # Of residual and regressors
    rows: float  # As many independent ones

    def recentred(self, centre: Float[np.ndarray, " n"]) -> PoolMember:
        """The same products with the response taken elsewhere."""
        change = np.eye(1 + centre.size)
        change[1:, 0] = self.centre - centre
        return replace(self, centre=centre, products=self.products.combined(change))

    @property
    def instruments(self) -> int:
        """Number of independent instruments."""
        return self.products.equations.shape[1]


def about(centre: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
    """Combinations of [phi y] that are the residual of parameters, and the regressors."""
    change = np.zeros((centre.size + 1, centre.size + 1))
    change[:, 0] = np.append(-centre, 1.0)
    change[:-1, 1:] = np.eye(centre.size)
    return change


#: Steps from node to node at which minima are looked for.
NODE_STEPS = 4
#: Points and rounds of a closer look at minima: each round is finer by half the points.
SCAN_POINTS, SCAN_ROUNDS = 9, 6
#: Most steps to a place where J is at a bound, but for a share of that.
ROOT_ROUNDS, ROOT_SHARE = 16, 1e-10
#: Places over each stretch of a nuisance, closer towards its ends.
POSITIONS = 65
#: Places at which a profile over further nuisances is compared with its bound.
PROFILE_POINTS = 2001

Forms = Float[np.ndarray, "F m b b"]
Rows = Int[np.ndarray, " R"]
Places = Float[np.ndarray, "R k"]
Edges = Float[np.ndarray, " E"]


@dataclass(frozen=True)
class Criterion:
    """J of some flights; a scan follows it along the first nuisance, in slices by values of the others."""

    members: tuple[PoolMember, ...]
    flight_specific: tuple[int, ...]
    nodes: Nodes
    known: Mapping[str, Prior]
    around: Values | None = None  # Where slices are closest. Default: where J is least
    strange: tuple[str, ...] = ()  # Parameters of other equations alone

    @property
    def size(self) -> int:
        """Number of linear parameters of a flight."""
        return self.members[0].centre.size

    @property
    def shared(self) -> tuple[int, ...]:
        """Places of the linear parameters that are shared."""
        return tuple(index for index in range(self.size) if index not in self.flight_specific)

    @property
    def unknowns(self) -> int:
        """Parameters of all flights, and nuisances."""
        return len(self.members) * len(self.flight_specific) + len(self.shared) + len(self.nodes.nuisances)

    @property
    def rows(self) -> float:
        """Independent rows of all flights."""
        return sum(member.rows for member in self.members)

    @property
    def instruments(self) -> int:
        """Independent instruments of all flights."""
        return sum(member.instruments for member in self.members)

    def positions(self, flight: int) -> np.ndarray:
        """Positions of a flight's residual and parameters among all."""
        flights, specific = len(self.members), len(self.flight_specific)
        positions = np.zeros(1 + self.size, dtype=np.int64)
        positions[[1 + index for index in self.flight_specific]] = 1 + flight * specific + np.arange(specific)
        positions[[1 + index for index in self.shared]] = 1 + flights * specific + np.arange(len(self.shared))
        return positions

    @cached_property
    def _scales(self) -> Float[np.ndarray, " b"]:
        """Lengths of residual and regressors, by which columns are divided."""
        squares = [np.mean((m.products.root**2).sum(axis=1), axis=0) for m in self.members]
        lengths = np.sqrt(np.mean(squares, axis=0))
        return np.where(lengths > 0.0, lengths, 1.0)

    @cached_property
    def _scaled(self) -> list[NuisanceProducts]:
        """Products of each flight in columns of unit length."""
        return [member.products.combined(np.diag(1.0 / self._scales)) for member in self.members]

    def _forms(self, values: ManyValues) -> tuple[Forms, Forms]:
        """Squares of each flight's equations, and its power over rows less unknowns."""
        N, D = zip(*(products.evaluate(values) for products in self._scaled), strict=True)
        N, D = (np.stack([part.swapaxes(1, 2) @ part for part in parts]) for parts in (N, D))
        return N, D / (self.rows - self.unknowns)

    def _joined(self, blocks: Forms) -> Float[np.ndarray, "m q q"]:
        """Form of all parameters: residual, each flight's own, and shared ones."""
        width = 1 + len(self.members) * len(self.flight_specific) + len(self.shared)
        joined = np.zeros((blocks.shape[1], width, width))
        for number, block in enumerate(blocks):
            positions = self.positions(number)
            joined[:, positions[:, None], positions] += block
        return joined

    def profile_over(self, box: Box) -> Float[np.ndarray, " points"]:
        """Profile of J at the points of a box."""
        return self._profile(self.nodes.values_over(box))

    def _profile(self, values: ManyValues) -> Float[np.ndarray, " points"]:
        return minimum_ratio(*map(self._joined, self._forms(values))) + self.nodes.misfit(values, self.known)

    @cached_property
    def minimum(self) -> tuple[Values, float]:
        """Nuisances where J is least, and J there."""
        result = argmin(self.profile_over, self.nodes.places)
        return self.nodes.values_at(result), float(self.profile_over([*result[:, None]])[0])

    def parameters(self, nuisances: Values) -> list[Float[np.ndarray, " n"]]:
        """Linear parameters of each flight where J is least, at values of the nuisances."""
        weighted = [member.weights.rows(nuisances) for member in self.members]  # exact, not interpolated
        columns = [
            np.column_stack([rows.regressors, rows.response]) @ (about(member.centre) / self._scales)
            for rows, member in zip(weighted, self.members, strict=True)
        ]
        moments = [rows.instruments.T @ column for rows, column in zip(weighted, columns, strict=True)]
        N, D = (self._joined(np.stack([(a.T @ a)[None] for a in part]))[0] for part in (moments, columns))
        x = scipy.linalg.eigh(N, D, subset_by_index=(0, 0))[1][:, 0]
        differences = -x / x[0] * self._scales[0]
        return [
            member.centre + differences[self.positions(number)][1:] / self._scales[1:]
            for number, member in enumerate(self.members)
        ]

    @property
    def _followed(self) -> Nuisance | None:
        return self.nodes.nuisances[0] if self.nodes.nuisances else None

    @cached_property
    def slices(self) -> list[dict[str, float]]:
        """Values of all nuisances but the first, of each slice."""
        return self.nodes.slices(self.minimum[0] if self.around is None else self.around)

    def _values_at(self, rows: Rows, places: Places) -> ManyValues:
        """Values of the nuisances at some places of slices, the places of a row all of one slice."""
        slice_values = {name: np.array([point[name] for point in self.slices]) for name in self.slices[0]}
        values = {name: np.repeat(column[rows], places.shape[1]) for name, column in slice_values.items()}
        if self._followed is not None:
            values[self._followed.name] = self._followed.values_at(places.ravel())
        return values

    def profile_at(self, rows: Rows, places: Places) -> Places:
        """Profile of J at some places of slices."""
        return self._profile(self._values_at(rows, places)).reshape(places.shape)

    @cached_property
    def _scanned(self) -> list[tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]]:
        """Places along each slice, in order and with all minima among them, and J there."""
        numbers = np.arange(len(self.slices))
        if self._followed is None:
            return [(np.zeros(1), self.profile_at(numbers, np.zeros((1, 1)))[0])]
        nodes = self.nodes.places[0]
        steps = np.arange((nodes.size - 1) * NODE_STEPS + 1) / NODE_STEPS
        positions = np.interp(steps, np.arange(nodes.size), nodes)
        J = self.profile_at(numbers, np.tile(positions, (numbers.size, 1)))
        padded = np.pad(J, ((0, 0), (1, 1)), constant_values=inf)
        rows, lowest = np.nonzero((padded[:, :-2] >= J) & (padded[:, 2:] >= J))
        low = positions[np.maximum(lowest - 1, 0)]
        high = positions[np.minimum(lowest + 1, positions.size - 1)]
        for _ in range(SCAN_ROUNDS):
            places = np.linspace(low, high, SCAN_POINTS, axis=1)
            best = np.argmin(self.profile_at(rows, places), axis=1)
            low, high = (
                places[np.arange(rows.size), np.clip(best + step, 0, SCAN_POINTS - 1)] for step in (-1, 1)
            )
        minima = 0.5 * (low + high)
        J_minima, results = self.profile_at(rows, minima[:, None])[:, 0], []
        for number in numbers:
            places = np.append(positions, minima[rows == number])
            order = np.argsort(places, kind="stable")
            results.append((places[order], np.append(J[number], J_minima[rows == number])[order]))
        return results

    @property
    def minima(self) -> Float[np.ndarray, " S"]:
        return np.array([J.min() for _, J in self._scanned])

    def _edges(
        self, rows: Rows, bound: float, inside: Edges, outside: Edges, J_inside: Edges, J_outside: Edges
    ) -> Edges:
        """Places at which J meets a bound, between those inside and outside, by the Illinois rule."""
        J_inside, J_outside = J_inside - bound, J_outside - bound
        last_side = np.zeros(rows.size)
        for _ in range(ROOT_ROUNDS if rows.size and self._followed is not None else 0):
            rise = np.where(J_outside > J_inside, J_outside - J_inside, 1.0)
            position = inside + np.where(J_outside > J_inside, -J_inside / rise, 0.0) * (outside - inside)
            excess = self.profile_at(rows, position[:, None])[:, 0] - bound
            fits = excess <= 0.0
            side = np.where(fits, 1.0, -1.0)
            # the end that stays a second time counts half
            halved = np.where(side == last_side, 0.5, 1.0)
            inside, J_inside = np.where(fits, position, inside), np.where(fits, excess, halved * J_inside)
            outside, J_outside = np.where(fits, outside, position), np.where(fits, halved * J_outside, excess)
            last_side = side
            if np.all((J_inside >= -ROOT_SHARE * bound) | (inside == outside)):
                break
        return inside

    @cached_property
    def _stretches(self) -> dict[float, tuple[Rows, Places, Bool[np.ndarray, " R"]]]:
        """Stretches by bound, the same for all parameters."""
        return {}

    def stretches(self, bound: float) -> tuple[Rows, Places, Bool[np.ndarray, " R"]]:
        """Slice, places, and whether J would stay below the bound beyond, of each stretch below it."""
        if bound in self._stretches:
            return self._stretches[bound]
        parts = []
        for number, (positions, J) in enumerate(self._scanned):
            parts += [(number, positions, J, part.start, part.stop) for part in stretches(bound >= J)]
        rows = np.array([number for number, *_ in parts], dtype=np.int64)
        ends = np.zeros((4, 0, 2))
        if parts:
            index = [([a, b - 1], [max(a - 1, 0), min(b, x.size - 1)]) for _, x, _, a, b in parts]
            both = [(x[i], x[o], J[i], J[o]) for (_, x, J, *_), (i, o) in zip(parts, index, strict=True)]
            ends = np.array(both).swapaxes(0, 1)
        inside = self._edges(np.repeat(rows, 2), bound, *ends.reshape(4, -1))
        shares = 0.5 - 0.5 * np.cos(np.pi * np.arange(POSITIONS) / (POSITIONS - 1))
        grids = [
            np.unique(np.concatenate([low + (high - low) * shares, positions[start:stop]]))
            for (_, positions, _, start, stop), (low, high) in zip(parts, inside.reshape(-1, 2), strict=True)
        ]
        longest = max((grid.size for grid in grids), default=0)
        padded = np.array([np.append(grid, np.full(longest - grid.size, grid[-1])) for grid in grids])
        positive = self._followed is not None and self._followed.positive
        cut_short = [positive and stop == positions.size for _, positions, *_, stop in parts]
        result = rows, padded.reshape(rows.size, max(longest, 1)), np.array(cut_short, dtype=np.bool_)
        return self._stretches.setdefault(bound, result)

    def sets_below(self, bound: float, position: int) -> list[ConfidenceSet]:
        """For each flight the values of one parameter at which J is at most a bound."""
        rows, places, cut_short = self.stretches(bound)
        if not rows.size:
            return [ConfidenceSet.empty() for _ in self.members]
        pieces: list[list[tuple[float, float]]] = [[] for _ in self.members]
        values = self._values_at(rows, places)
        (N, D), bounds = self._forms(values), bound - self.nodes.misfit(values, self.known)
        for number, (Q, free) in enumerate(self._flight_forms(N - np.reshape(bounds, (-1, 1, 1)) * D)):
            fitting = allowed(Q, 1 + position)
            parts = (fitting.low, fitting.high, fitting.outside, free)
            scale = self._scales[0] / self._scales[1 + position]
            centre = self.members[number].centre[position]
            for cut, *ends, unbounded in zip(
                cut_short, *(x.reshape(places.shape) for x in parts), strict=True
            ):
                part = Allowed(*ends)
                spans = part.continued() if cut else part.pieces()
                spans = [(-inf, inf)] if unbounded.any() else spans
                pieces[number] += [(float(centre + a * scale), float(centre + b * scale)) for a, b in spans]
        return [ConfidenceSet.union(item) for item in pieces]

    def _flight_forms(self, Q: Forms) -> list[tuple[Float[np.ndarray, "m c c"], Bool[np.ndarray, " m"]]]:
        """Form of each flight's parameters, minimised over those of the other flights."""
        shared = [0, *(1 + item for item in self.shared)]
        rest, free = concentrated(Q, shared)
        total, free_count = rest.sum(axis=0), free.sum(axis=0)
        results = []
        for number, block in enumerate(Q):
            form = block.copy()
            form[:, np.array(shared)[:, None], shared] += total - rest[number]
            results.append((form, free_count > free[number]))
        return results

    def sum_set(self, names: Sequence[str], nuisances: Values, bound: float) -> ConfidenceSet:
        """Values of the sum of some nuisances at which J is at most a bound, and that of the estimate."""
        first, estimate = self.nodes.nuisances[0], sum(nuisances[name] for name in names)
        others = np.array([sum(point[name] for name in names if name != first.name) for point in self.slices])
        if first.name not in names:  # between slices the root of the excess is straight
            excesses = np.append(np.maximum(self.minima - self.minima.min(), 0.0), 0.0)
            order = np.argsort(np.append(others, estimate), kind="stable")
            values, roots = np.append(others, estimate)[order], np.sqrt(excesses[order])
            fine = np.unique(np.append(np.linspace(values[0], values[-1], PROFILE_POINTS), estimate))
            fits = np.interp(fine, values, roots) <= np.sqrt(max(bound - self.minima.min(), 0.0))
            return ConfidenceSet.union((float(fine[a][0]), float(fine[a][-1])) for a in stretches(fits))
        rows, places, cut_short = self.stretches(bound)
        low, high = first.values_at(places[:, 0]), first.values_at(places[:, -1])
        low = np.where(first.positive & (places[:, 0] == self.nodes.places[0][0]), 0.0, low)
        high = np.where(cut_short, inf, high)
        pieces = zip((others[rows] + low).tolist(), (others[rows] + high).tolist(), strict=True)
        return ConfidenceSet.union([(estimate, estimate), *pieces])


#: Degrees of freedom of the cosine averages, whose quantile the profile set takes over.
DEGREES = 8
#: More parameters have no sets: of several axes that share nuisances these take too long.
FEW_PARAMETERS = 8
#: Instruments that move the rows by less than this share are none of them.
INDEPENDENT = 1e-6
#: Equations that nuisances change by less stay the same.
SAME = 1e-9


@dataclass(frozen=True)
class ParameterSets:
    """Three 95 % sets of one parameter, or of another level."""

    wald: ConfidenceSet  # The estimate plus and minus
    profile: ConfidenceSet
    anderson_rubin: ConfidenceSet
    strange: tuple[str, ...] = ()
    conditional: ConfidenceSet | None = None  # Profile set by the strength of the instruments; none of a pool

    @property
    def robust(self) -> ConfidenceSet:
        """The conditional set; of a pool the Anderson-Rubin set, but never less than the profile set."""
        union = ConfidenceSet.union((*self.anderson_rubin.intervals, *self.profile.intervals))
        return union if self.conditional is None else self.conditional


@dataclass(frozen=True)
class ProfileSets:
    """Confidence sets of linear parameters and of nuisances, from the criterion over the nuisances."""

    problem: SeparableProblem
    estimate: Estimate

    @cached_property
    def nodes(self) -> Nodes:
        return nodes_of(self.problem.nuisances)

    @property
    def available(self) -> bool:
        """Whether the estimate is by instruments of rows in frequency, and of few parameters."""
        method = by_name(self.estimate.method).of_flights
        return (
            isinstance(method, LinearMethod)
            and isinstance(method.assembler, Instrumental)
            and isinstance(self.estimate.rows.layout, BinRows)
            and len(self.estimate.rows.parameters) <= FEW_PARAMETERS
        )

    def of_parameter(self, name: str, level: float = 0.95) -> ParameterSets | None:
        checks.level(level)
        estimate, parameters = self.estimate, [item.name for item in self.estimate.rows.parameters]
        position = checks.index_of("a parameter", name, parameters)
        if not self.available:
            return None
        criterion = self._part([bool(present[position]) for _, present in self._runs])
        if criterion is not self._full_criterion:
            position -= sum(parameters.index(other) < position for other in criterion.strange)
            products = [member.products.equations for member in criterion.members]
            if all(
                len(E) > 1 and E.size > 0 and np.ptp(E, axis=0).max() <= SAME * np.abs(E).max()
                for E in products
            ):
                return None  # an equation that no nuisance moves
        wald = estimate.interval(name, level)
        return self._sets(criterion, lambda bound: criterion.sets_below(bound, position)[0], wald, level)

    def of_nuisances(self, names: Sequence[str], level: float = 0.95) -> ParameterSets | None:
        """Sets of the sum of some nuisances; None where none of them is searched for."""
        searched = {nuisance.name for nuisance in self.nodes.nuisances}
        if not self.available or not searched & set(names):
            return None
        estimate, criterion = self.estimate, self._excited
        direction = sum(estimate.direction(name) for name in names if name in searched)
        value = sum(estimate.nuisances[name] for name in names)
        half = estimate.joint_covariance.half_width(np.asarray(direction), level)
        wald = (value - half, value + half)
        return self._sets(
            criterion, lambda bound: criterion.sum_set(names, estimate.nuisances, bound), wald, level
        )

    @cached_property
    def _excited(self) -> Criterion:
        """Equations with a parameter of strong instruments; all of them where none has."""
        strong = np.array(self.estimate.first_stage) >= STRONG_FIRST_STAGE
        used = [bool(strong[: present.size][present].any()) for _, present in self._runs]
        return self._part(used if any(used) else [True] * len(used))

    def _part(self, used: Sequence[bool]) -> Criterion:
        """Criterion of some runs, by the regressors that move and the instruments that act in them."""
        rows = self.estimate.rows
        sizes = [size for size, _ in self._runs]
        involved = np.repeat(used, sizes)
        moving = np.flatnonzero(rows.regressors[involved].any(axis=0))
        if involved.all() and moving.size == rows.regressors.shape[1]:
            return self._full_criterion
        instruments = np.eye(rows.instruments.shape[1])
        if not involved.all():
            _, lengths, V = np.linalg.svd(rows.instruments[involved], full_matrices=False)
            instruments = V[lengths > INDEPENDENT].T / lengths[lengths > INDEPENDENT]
        return self._criterion(involved, moving, instruments)

    def _sets(
        self,
        criterion: Criterion,
        set_at: Callable[[float], ConfidenceSet],
        wald: tuple[float, float],
        level: float,
    ) -> ParameterSets | None:
        estimate, strange = self.estimate, criterion.strange
        try:
            minimum = float(criterion.minima.min())
        except np.linalg.LinAlgError:
            return None
        # instruments less unknowns, but for what the set is of
        degrees = criterion.instruments + len(estimate.misfits) + estimate.undetermined
        degrees -= estimate.unknowns - len(strange) - 1
        stages = zip(estimate.names, estimate.first_stage, strict=True)
        strength = degrees * float(min(F for name, F in stages if name not in strange))
        excess = distributions.t_quantile(level, DEGREES) ** 2
        profile = conditional = set_at(minimum + excess)
        if (larger := distributions.conditional_ratio_quantile(level, degrees, strength)) > excess:
            conditional = set_at(minimum + larger)
        anderson_rubin = set_at(distributions.chi_square_quantile(level, max(degrees, 1)))
        return ParameterSets(ConfidenceSet((wald,)), profile, anderson_rubin, strange, conditional)

    @cached_property
    def _full_criterion(self) -> Criterion:
        rows = self.estimate.rows
        used = np.ones(rows.response.size, dtype=np.bool_)
        return self._criterion(used, np.arange(rows.regressors.shape[1]), np.eye(rows.instruments.shape[1]))

    @cached_property
    def _weights(self) -> WhitenedRows:
        weighting = cast("LinearMethod", by_name(self.estimate.method).of_flights).row_weighting
        weights = weighting.last_pass(self.problem, self.estimate.theta, self.estimate.nuisances)
        return cast("WhitenedRows", weights)

    @cached_property
    def _runs(self) -> list[tuple[int, Bool[np.ndarray, " n"]]]:
        """Rows of each run, and which regressors move in it, though some of their rows may be zero."""
        sizes = [2 * run.count for run in cast("BinRows", self.estimate.rows.layout).runs]
        parts = np.split(self.estimate.rows.regressors, np.cumsum(sizes)[:-1])
        return [(size, np.any(part, axis=0)) for size, part in zip(sizes, parts, strict=True)]

    @cached_property
    def _sums(self) -> list[tuple[int, NuisanceProducts]]:
        """First row and products of the runs with the same regressors."""
        kinds = [present.tobytes() for _, present in self._runs]
        starts = np.cumsum([0, *(size for size, _ in self._runs)]).tolist()
        instruments = self.estimate.rows.instruments
        by_kind = NuisanceProducts.of_rows(self._weights, self.nodes, instruments, kinds)
        return [(starts[kinds.index(kind)], products) for kind, products in by_kind.items()]

    def _criterion(
        self,
        rows: Bool[np.ndarray, " rows"],
        regressors: Int[np.ndarray, " own"],
        instruments: Float[np.ndarray, "p q"],
    ) -> Criterion:
        """J of some rows, regressors and combinations of instruments."""
        parts = [part for first, part in self._sums if rows[first : first + 1].any()]  # one may lack bins
        products, theta = reduce(NuisanceProducts.joined, parts), self.estimate.theta
        products = products.combined(about(theta)[:, [0, *(1 + regressors)]], instruments)
        count = np.count_nonzero(rows) * self.estimate.rows.layout.independent
        member = PoolMember(self._weights, theta[regressors], products, count)
        parameters = enumerate(self.estimate.rows.parameters)
        strange = tuple(item.name for index, item in parameters if index not in regressors)
        priors = known_priors(self.nodes)
        return Criterion((member,), (), self.nodes, priors, self.estimate.nuisances, strange)


def known_priors(nodes: Nodes) -> dict[str, Prior]:
    """Priors of the nuisances that are searched for, by their names."""
    return {item.name: item.prior for item in nodes.nuisances if item.prior is not None}
