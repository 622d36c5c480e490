"""Confidence sets of single parameters: a criterion over the nuisances, of one flight or of a pool."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import cast

import numpy as np
import scipy

from eivor import checks
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.moments import Instrumental
from eivor.estimation.variable_projection import Box, NodeAxis, Nodes, argmin, nodes_of
from eivor.estimation.weighting import WeightedRows, WhitenedRows
from eivor.inference import distributions
from eivor.inference.anderson_rubin import Allowed, allowed, concentrated, least_ratio
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.models.regression import Regression
from eivor.models.separable import Prior, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.signals.signals import stretches
from eivor.tools import Bool, Float, Int


@dataclass(frozen=True)
class PoolMember:
    """Products of one flight at every node of the nuisances."""

    problem: SeparableProblem
    weights: WeightedRows
    centre: Float[np.ndarray, " n"]  # Linear parameters at which the response is taken
    equations: Float[np.ndarray, "T q n_plus_1"]  # Q' of residual and regressors, at each node
    power: Float[np.ndarray, "T n_plus_1 n_plus_1"]  # Their products with each other
    rows: float  # As many independent ones

    def recentred(self, centre: Float[np.ndarray, " n"]) -> PoolMember:
        """The same products with the response taken elsewhere."""
        moved = np.append(1.0, self.centre - centre)
        equations, power = self.equations.copy(), self.power.copy()
        equations[:, :, 0] = self.equations @ moved
        power[:, 0, 1:] = power[:, 1:, 0] = self.power[:, 1:] @ moved
        power[:, 0, 0] = moved @ self.power @ moved
        return replace(self, centre=centre, equations=equations, power=power)

    @property
    def instruments(self) -> int:
        """Number of independent instruments."""
        return self.equations.shape[1]


def products_at(
    rows: Regression, centre: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "q n_plus_1"], Float[np.ndarray, "n_plus_1 n_plus_1"]]:
    """Q' of residual and regressors, and their products with each other."""
    columns = np.column_stack([rows.response - rows.regressors @ centre, rows.regressors])
    return rows.instruments.T @ columns, columns.T @ columns


#: Places between two nodes at which minima are looked for.
BETWEEN = 4
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
        return len(self.members) * len(self.flight_specific) + len(self.shared) + len(self.nodes.axes)

    @property
    def rows(self) -> float:
        """Independent rows of all flights."""
        return sum(member.rows for member in self.members)

    @property
    def instruments(self) -> int:
        """Independent instruments of all flights."""
        return sum(member.instruments for member in self.members)

    def indices_of(self, number: int) -> np.ndarray:
        """Where residual and parameters of a flight are among those of all."""
        flights, specific = len(self.members), len(self.flight_specific)
        positions = np.zeros(1 + self.size, dtype=np.int64)
        positions[[1 + item for item in self.flight_specific]] = 1 + number * specific + np.arange(specific)
        positions[[1 + item for item in self.shared]] = 1 + flights * specific + np.arange(len(self.shared))
        return positions

    @cached_property
    def _scales(self) -> Float[np.ndarray, " b"]:
        """Lengths of residual and regressors, by which columns are divided."""
        lengths = np.sqrt(np.mean([np.diagonal(np.mean(m.power, axis=0)) for m in self.members], axis=0))
        return np.where(lengths > 0.0, lengths, 1.0)

    @cached_property
    def _scaled(self) -> list[tuple[Float[np.ndarray, "T q b"], Float[np.ndarray, "T b b"]]]:
        """Equations of each flight and their power over rows less unknowns, in columns of unit length."""
        sizes = np.outer(self._scales, self._scales) * (self.rows - self.unknowns)
        return [(member.equations / self._scales, member.power / sizes) for member in self.members]

    def _joined(self, blocks: Forms) -> Float[np.ndarray, "m q q"]:
        """Form of all parameters: residual, each flight's own, and what is shared."""
        width = 1 + len(self.members) * len(self.flight_specific) + len(self.shared)
        joined = np.zeros((blocks.shape[1], width, width))
        for number, block in enumerate(blocks):
            positions = self.indices_of(number)
            joined[:, positions[:, None], positions] += block
        return joined

    def least(self, box: Box) -> Float[np.ndarray, " points"]:
        """Least J at the points of a box."""
        made = [[self.nodes.over(part, box) for part in pair] for pair in self._scaled]
        N = np.stack([seen.transpose(0, 2, 1) @ seen for seen, _ in made])
        D = np.stack([power for _, power in made])
        return least_ratio(self._joined(N), self._joined(D)) + self.nodes.misfit(
            self.nodes.values_over(box), self.known
        )

    @cached_property
    def minimum(self) -> tuple[Values, float]:
        """Nuisances where J is least, and J there."""
        result = argmin(self.least, self.nodes.nodes)
        return self.nodes.values_at(result), float(self.least([*result[:, None]])[0])

    def parameters(self, nuisances: Values) -> list[Float[np.ndarray, " n"]]:
        """Linear parameters of each flight where J is least, at values of the nuisances."""
        made = [products_at(member.weights.rows(nuisances), member.centre) for member in self.members]
        outer = np.outer(self._scales, self._scales)
        seen = [equations / self._scales for equations, _ in made]
        N = self._joined(np.stack([(item.T @ item)[None] for item in seen]))[0]
        D = self._joined(np.stack([(power / outer)[None] for _, power in made]))[0]
        x = scipy.linalg.eigh(N, D, subset_by_index=(0, 0))[1][:, 0]
        differences = -x / x[0] * self._scales[0]
        return [
            member.centre + differences[self.indices_of(number)][1:] / self._scales[1:]
            for number, member in enumerate(self.members)
        ]

    @property
    def _axis(self) -> NodeAxis | None:
        return self.nodes.axes[0] if self.nodes.axes else None

    @cached_property
    def _closer(self) -> tuple[Nodes, Box]:
        return self.nodes.closer(self.minimum[0] if self.around is None else self.around)

    @cached_property
    def slices(self) -> list[dict[str, float]]:
        """Values of all nuisances but the first, of each slice."""
        return Nodes(self._closer[0].axes[1:], self.nodes.fixed).points

    @cached_property
    def _in_slices(self) -> list[list[Float[np.ndarray, "S T *shape"]]]:
        """Equations and power of each flight, at the nodes of every slice."""

        def sliced(part: Float[np.ndarray, "nodes *shape"]) -> Float[np.ndarray, "S T *shape"]:
            fine, count = self.nodes.over(part, self._closer[1]), len(self.slices)
            # no -1: equations without a parameter that stays are empty
            shape = (fine.shape[0] // count, count, *part.shape[1:])
            return np.ascontiguousarray(fine.reshape(shape).swapaxes(0, 1))

        return [[sliced(part) for part in pair] for pair in self._scaled]

    def _forms_at(self, rows: Rows, places: Places) -> tuple[Forms, Forms]:
        """N and D of each flight at some places of slices, the places of a row all of one slice."""
        weights = np.ones((*places.shape, 1))
        if self._axis is not None:
            weights = self._axis.weights(places.ravel()).reshape(*places.shape, -1)

        def between(part: Float[np.ndarray, "S T *shape"]) -> Float[np.ndarray, "m *shape"]:
            at_nodes = part[rows].reshape(rows.size, part.shape[1], -1)
            return (weights @ at_nodes).reshape(places.size, *part.shape[2:])

        seen = [between(equations) for equations, _ in self._in_slices]
        N = np.stack([item.transpose(0, 2, 1) @ item for item in seen])
        return N, np.stack([between(power) for _, power in self._in_slices])

    def _misfit_at(self, rows: Rows, places: Places) -> Places:
        """Squared distance from what is known beforehand, in standard errors."""
        values = {
            name: np.array([self.slices[row][name] for row in rows])[:, None] for name in self.slices[0]
        }
        if self._axis is not None:
            values[self._axis.nuisance.name] = self._axis.values_at(places)
        return self.nodes.misfit(values, self.known) + np.zeros(places.shape)

    def least_at(self, rows: Rows, places: Places) -> Places:
        """Least J at some places of slices."""
        J = least_ratio(*map(self._joined, self._forms_at(rows, places)))
        return J.reshape(places.shape) + self._misfit_at(rows, places)

    @cached_property
    def _scanned(self) -> list[tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]]:
        """Of each slice places between the nodes with all minima among them, in order, and J there."""
        every = np.arange(len(self.slices))
        if self._axis is None:
            return [(np.zeros(1), self.least_at(every, np.zeros((1, 1)))[0])]
        nodes = self._axis.nodes
        steps = np.arange((nodes.size - 1) * BETWEEN + 1) / BETWEEN
        positions = np.interp(steps, np.arange(nodes.size), nodes)
        J = self.least_at(every, np.tile(positions, (every.size, 1)))
        padded = np.pad(J, ((0, 0), (1, 1)), constant_values=inf)
        rows, lowest = np.nonzero((padded[:, :-2] >= J) & (padded[:, 2:] >= J))
        low = positions[np.maximum(lowest - 1, 0)]
        high = positions[np.minimum(lowest + 1, positions.size - 1)]
        for _ in range(SCAN_ROUNDS):
            places = np.linspace(low, high, SCAN_POINTS, axis=1)
            best = np.argmin(self.least_at(rows, places), axis=1)
            low, high = (
                places[np.arange(rows.size), np.clip(best + step, 0, SCAN_POINTS - 1)] for step in (-1, 1)
            )
        minima = 0.5 * (low + high)
        least, results = self.least_at(rows, minima[:, None])[:, 0], []
        for number in every:
            places = np.append(positions, minima[rows == number])
            order = np.argsort(places, kind="stable")
            results.append((places[order], np.append(J[number], least[rows == number])[order]))
        return results

    @property
    def minima(self) -> Float[np.ndarray, " S"]:
        return np.array([J.min() for _, J in self._scanned])

    def _edges(
        self, rows: Rows, bound: float, inside: Edges, outside: Edges, within: Edges, beyond: Edges
    ) -> Edges:
        """Places at which J meets a bound, between those inside and outside, by the Illinois rule."""
        within, beyond = within - bound, beyond - bound
        last = np.zeros(rows.size)
        for _ in range(ROOT_ROUNDS if rows.size and self._axis is not None else 0):
            apart = np.where(beyond > within, beyond - within, 1.0)
            point = inside + np.where(beyond > within, -within / apart, 0.0) * (outside - inside)
            excess = self.least_at(rows, point[:, None])[:, 0] - bound
            fits = excess <= 0.0
            side = np.where(fits, 1.0, -1.0)
            # the end that stays a second time counts half
            halved = np.where(side == last, 0.5, 1.0)
            inside, within = np.where(fits, point, inside), np.where(fits, excess, halved * within)
            outside, beyond = np.where(fits, outside, point), np.where(fits, halved * beyond, excess)
            last = side
            if np.all((within >= -ROOT_SHARE * bound) | (inside == outside)):
                break
        return inside

    @cached_property
    def _known(self) -> dict[float, tuple[Rows, Places, Bool[np.ndarray, " R"]]]:
        """Stretches of each bound: all parameters have the same."""
        return {}

    def stretches(self, bound: float) -> tuple[Rows, Places, Bool[np.ndarray, " R"]]:
        """Number of the slice, places, and whether J would stay below the bound beyond, of each stretch."""
        if bound in self._known:
            return self._known[bound]
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
        turned = 0.5 - 0.5 * np.cos(np.pi * np.arange(POSITIONS) / (POSITIONS - 1))
        within = [
            np.unique(np.concatenate([low + (high - low) * turned, positions[start:stop]]))
            for (_, positions, _, start, stop), (low, high) in zip(parts, inside.reshape(-1, 2), strict=True)
        ]
        most = max((item.size for item in within), default=0)
        padded = np.array([np.append(item, np.full(most - item.size, item[-1])) for item in within])
        positive = self._axis is not None and self._axis.nuisance.positive
        cut_short = [positive and stop == positions.size for _, positions, *_, stop in parts]
        made = rows, padded.reshape(rows.size, max(most, 1)), np.array(cut_short, dtype=np.bool_)
        return self._known.setdefault(bound, made)

    def below(self, bound: float, position: int) -> list[ConfidenceSet]:
        """For each flight the values of one parameter at which J is at most a bound."""
        rows, places, cut_short = self.stretches(bound)
        if not rows.size:
            return [ConfidenceSet.empty() for _ in self.members]
        pieces: list[list[tuple[float, float]]] = [[] for _ in self.members]
        N, D = self._forms_at(rows, places)
        left = (bound - self._misfit_at(rows, places)).ravel()[:, None, None]
        for number, (Q, free) in enumerate(self._others_free(N - left * D)):
            fitting = allowed(Q, 1 + position)
            parts = (fitting.low, fitting.high, fitting.outside, free)
            scale = self._scales[0] / self._scales[1 + position]
            centre = self.members[number].centre[position]
            for cut, *ends, unbounded in zip(
                cut_short, *(x.reshape(places.shape) for x in parts), strict=True
            ):
                part = Allowed(*ends)
                made = part.continued() if cut else part.pieces()
                made = [(-inf, inf)] if unbounded.any() else made
                pieces[number] += [(float(centre + a * scale), float(centre + b * scale)) for a, b in made]
        return [ConfidenceSet.union(item) for item in pieces]

    def _others_free(self, Q: Forms) -> list[tuple[Float[np.ndarray, "m c c"], Bool[np.ndarray, " m"]]]:
        """For each flight the form of its parameters, those of the other flights where the form is least."""
        kept = [0, *(1 + item for item in self.shared)]
        rest, free = concentrated(Q, kept)
        total, some = rest.sum(axis=0), free.sum(axis=0)
        results = []
        for number, block in enumerate(Q):
            whole = block.copy()
            whole[:, np.array(kept)[:, None], kept] += total - rest[number]
            results.append((whole, some > free[number]))
        return results

    def of_sum(self, names: Sequence[str], at: Values, bound: float) -> ConfidenceSet:
        """Values of the sum of some nuisances at which J is at most a bound, that of `at` among them."""
        axis, here = self.nodes.axes[0], sum(at[name] for name in names)
        first = axis.nuisance
        others = np.array([sum(point[name] for name in names if name != first.name) for point in self.slices])
        if first.name not in names:  # between slices the root of the excess is straight
            excesses = np.append(np.maximum(self.minima - self.minima.min(), 0.0), 0.0)
            order = np.argsort(np.append(others, here), kind="stable")
            values, roots = np.append(others, here)[order], np.sqrt(excesses[order])
            fine = np.unique(np.append(np.linspace(values[0], values[-1], PROFILE_POINTS), here))
            fits = np.interp(fine, values, roots) <= np.sqrt(max(bound - self.minima.min(), 0.0))
            return ConfidenceSet.union((float(fine[a][0]), float(fine[a][-1])) for a in stretches(fits))
        rows, places, cut_short = self.stretches(bound)
        low, high = axis.values_at(places[:, 0]), axis.values_at(places[:, -1])
        low = np.where(first.positive & (places[:, 0] == axis.nodes[0]), 0.0, low)
        high = np.where(cut_short, inf, high)
        pieces = zip((others[rows] + low).tolist(), (others[rows] + high).tolist(), strict=True)
        return ConfidenceSet.union([(here, here), *pieces])


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


@dataclass(frozen=True, slots=True)
class _Part:
    """What some equations say of the nuisances."""

    criterion: Criterion
    degrees: float  # Instruments less unknowns, but for what the set is of
    strange: tuple[str, ...]  # Parameters of other equations alone


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
        part = self._part([bool(present[position]) for _, present in self._runs])
        if part.criterion is not self._of_all_rows:
            position -= sum(parameters.index(other) < position for other in part.strange)
            products = [member.equations for member in part.criterion.members]
            if all(
                len(E) > 1 and E.size > 0 and np.ptp(E, axis=0).max() <= SAME * np.abs(E).max()
                for E in products
            ):
                return None  # an equation that no nuisance moves
        wald = estimate.interval(name, level)
        return self._sets(part, lambda bound: part.criterion.below(bound, position)[0], wald, level)

    def of_nuisances(self, names: Sequence[str], level: float = 0.95) -> ParameterSets | None:
        """Sets of the sum of some nuisances; None where none of them is searched for."""
        searched = {axis.nuisance.name for axis in self.nodes.axes}
        if not self.available or not searched & set(names):
            return None
        estimate, part = self.estimate, self._excited
        direction = sum(estimate.direction(name) for name in names if name in searched)
        here = sum(estimate.nuisances[name] for name in names)
        half = estimate.joint_covariance.half_width(np.asarray(direction), level)
        wald = (here - half, here + half)
        return self._sets(
            part, lambda bound: part.criterion.of_sum(names, estimate.nuisances, bound), wald, level
        )

    @cached_property
    def _excited(self) -> _Part:
        """Equations with a parameter of strong instruments; all of them where none has."""
        strong = np.array(self.estimate.first_stage) >= STRONG_FIRST_STAGE
        used = [bool(strong[: present.size][present].any()) for _, present in self._runs]
        return self._part(used if any(used) else [True] * len(used))

    def _part(self, used: Sequence[bool]) -> _Part:
        """Criterion of some runs, by the regressors that move and the instruments that act in them."""
        estimate, rows, count = self.estimate, self.estimate.rows, self.estimate.rows.regressors.shape[1]
        sizes = [size for size, _ in self._runs]
        involved = np.repeat(used, sizes)
        moving = np.flatnonzero(rows.regressors[involved].any(axis=0))
        criterion = self._of_all_rows
        if not (involved.all() and moving.size == count):
            instruments = np.eye(rows.instruments.shape[1])
            if not involved.all():
                _, lengths, V = np.linalg.svd(rows.instruments[involved], full_matrices=False)
                instruments = V[lengths > INDEPENDENT].T / lengths[lengths > INDEPENDENT]
            criterion = self._criterion(involved, moving, instruments)
        strange = tuple(item.name for k, item in enumerate(rows.parameters) if k not in moving)
        degrees = criterion.instruments + len(estimate.misfits) + estimate.undetermined
        return _Part(criterion, degrees - (estimate.unknowns - len(strange) - 1), strange)

    def _sets(
        self, part: _Part, below: Callable[[float], ConfidenceSet], wald: tuple[float, float], level: float
    ) -> ParameterSets | None:
        try:
            least = float(part.criterion.minima.min())
        except np.linalg.LinAlgError:
            return None
        stages = zip(self.estimate.names, self.estimate.first_stage, strict=True)
        degrees = part.degrees
        strength = degrees * float(min(F for name, F in stages if name not in part.strange))
        excess = distributions.t_quantile(level, DEGREES) ** 2
        profile = conditional = below(least + excess)
        if (more := distributions.conditional_ratio_quantile(level, degrees, strength)) > excess:
            conditional = below(least + more)
        anderson_rubin = below(distributions.chi_square_quantile(level, max(degrees, 1)))
        return ParameterSets(ConfidenceSet((wald,)), profile, anderson_rubin, part.strange, conditional)

    @cached_property
    def _of_all_rows(self) -> Criterion:
        rows = self.estimate.rows
        every = np.ones(rows.response.size, dtype=np.bool_)
        return self._criterion(every, np.arange(rows.regressors.shape[1]), np.eye(rows.instruments.shape[1]))

    @cached_property
    def _weights(self) -> WhitenedRows:
        weighting = cast("LinearMethod", by_name(self.estimate.method).of_flights).row_weighting
        made = weighting.last_pass(self.problem, self.estimate.theta, self.estimate.nuisances)
        return cast("WhitenedRows", made)

    @cached_property
    def _runs(self) -> list[tuple[int, Bool[np.ndarray, " n"]]]:
        """Rows of each run, and which regressors move in it, though some of their rows may be zero."""
        sizes = [2 * run.count for run in cast("BinRows", self.estimate.rows.layout).runs]
        parts = np.split(self.estimate.rows.regressors, np.cumsum(sizes)[:-1])
        return [(size, np.any(part, axis=0)) for size, part in zip(sizes, parts, strict=True)]

    @cached_property
    def _sums(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """First row, Q' [phi y] and [phi y]' [phi y] of the runs with the same regressors, at every node."""
        made: dict[bytes, tuple[int, np.ndarray, np.ndarray]] = {}
        sums, start = self._weights.sums(self.nodes.points, self.estimate.rows.instruments), 0
        for (size, present), (E, P) in zip(self._runs, sums, strict=True):
            first, *known = made.get(present.tobytes(), (start, 0.0, 0.0))
            made[present.tobytes()] = (first, known[0] + E, known[1] + P)
            start += size
        return list(made.values())

    def _criterion(
        self,
        rows: Bool[np.ndarray, " rows"],
        regressors: Int[np.ndarray, " own"],
        instruments: Float[np.ndarray, "p q"],
    ) -> Criterion:
        """J of some rows, regressors and combinations of instruments."""
        parts, theta = [item for item in self._sums if rows[item[0] : item[0] + 1].any()], self.estimate.theta
        change = np.zeros((theta.size + 1, regressors.size + 1))
        change[:, 0] = np.append(-theta, 1.0)
        change[regressors, np.arange(1, regressors.size + 1)] = 1.0
        equations = instruments.T @ sum(E for _, E, _ in parts) @ change
        power = change.T @ sum(P for *_, P in parts) @ change
        count = np.count_nonzero(rows) * self.estimate.rows.layout.independent
        member = PoolMember(self.problem, self._weights, theta[regressors], equations, power, count)
        return Criterion((member,), (), self.nodes, known_priors(self.nodes), self.estimate.nuisances)


def known_priors(nodes: Nodes) -> dict[str, Prior]:
    """Priors of the nuisances that are searched for, by their names."""
    priors = {axis.nuisance.name: axis.nuisance.prior for axis in nodes.axes}
    return {name: prior for name, prior in priors.items() if prior is not None}
