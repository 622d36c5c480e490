"""Pooled estimation of several flights with common and own parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import cast

import numpy as np
import scipy

from eivor.estimation.derived import DEGREES, ParameterSets
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_linear, known_misfits, slope
from eivor.estimation.methods import by_name
from eivor.estimation.variable_projection import (
    Box,
    Nodes,
    NuisanceProfile,
    NuisanceScan,
    argmin,
    bounded_sums,
    least_comparable_criteria,
    nodes_of,
    on_nested_grids,
    profiles_of,
    reaching,
)
from eivor.estimation.weighting import WeightedRows, whitened_by_residuals
from eivor.inference.anderson_rubin import allowed, least_ratio
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.covariance import (
    COSINE_AVERAGES,
    CovariancePart,
    JointCovariance,
    cosine_covariance,
    sandwich,
    unit_scale,
)
from eivor.inference.distributions import chi_square_quantile, chi_square_tail, t_quantile
from eivor.inference.random_effects import moment_between, one_group, random_effects_means
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, Prior, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.tools import Bool, Float

# -- Member --


@dataclass(frozen=True)
class PoolMember:
    """One flight at one combination of the discrete nuisances."""

    problem: SeparableProblem
    weights: WeightedRows
    fixed: Values
    centre: Float[np.ndarray, " n"]  # Linear parameters at which the response is taken
    equations: Float[np.ndarray, "T q n_plus_1"]  # Q' of residual and regressors, at each node
    power: Float[np.ndarray, "T n_plus_1 n_plus_1"]  # Their products with each other
    rows: int

    def rows_at(self, nuisances: Values) -> Regression:
        """Whitened rows, at values of the continuous nuisances."""
        return self.weights.rows({**self.fixed, **nuisances})

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


def pool_member(
    problem: SeparableProblem,
    nodes: Nodes,
    nuisance_values: Values,
    theta: Float[np.ndarray, " n"],
    centre: Float[np.ndarray, " n"],
) -> PoolMember:
    """Products of a flight, whitened by its residual at some values."""
    weights = whitened_by_residuals(problem, theta, nuisance_values)
    made = [weights.rows({**nuisance_values, **point}) for point in nodes.points]
    products = (products_at(rows, centre) for rows in made)
    equations, power = (np.stack(parts) for parts in zip(*products, strict=True))
    return PoolMember(problem, weights, nuisance_values, centre, equations, power, made[0].response.size)


def products_at(
    rows: Regression, centre: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "q n_plus_1"], Float[np.ndarray, "n_plus_1 n_plus_1"]]:
    """Q' of residual and regressors, and their products with each other."""
    columns = np.column_stack([rows.response - rows.regressors @ centre, rows.regressors])
    return rows.instruments.T @ columns, columns.T @ columns


# -- Criterion --

Forms = Float[np.ndarray, "F k b b"]


@dataclass(frozen=True)
class PoolCriterion:
    """J of some flights at one combination of the discrete nuisances."""

    members: tuple[PoolMember, ...]
    flight_specific: tuple[int, ...]
    nodes: Nodes
    known: dict[str, Prior]

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
    def rows(self) -> int:
        """Rows of all flights."""
        return sum(member.rows for member in self.members)

    @property
    def instruments(self) -> int:
        """Independent instruments of all flights."""
        return sum(member.instruments for member in self.members)

    # -- forms -----------------------------------------------------------------------------------------------

    @cached_property
    def _scales(self) -> Float[np.ndarray, " b"]:
        """Lengths of residual and regressors, by which columns are divided."""
        lengths = np.sqrt(np.mean([np.diagonal(np.mean(m.power, axis=0)) for m in self.members], axis=0))
        return np.where(lengths > 0.0, lengths, 1.0)

    def _blocks(self, box: Box) -> tuple[Forms, Forms]:
        """N and D of each flight, residual and regressors in their order."""
        freedom = self.rows - self.unknowns
        outer = np.outer(self._scales, self._scales)
        N, D = [], []
        for member in self.members:
            seen = self.nodes.over(member.equations, box) / self._scales
            N.append(seen.transpose(0, 2, 1) @ seen)
            D.append(self.nodes.over(member.power, box) / (outer * freedom))
        return np.stack(N), np.stack(D)

    def _joined(self, blocks: Forms) -> Float[np.ndarray, "k m m"]:
        """Form of all parameters: residual, each flight's own, and what is shared."""
        flights, specific = len(self.members), len(self.flight_specific)
        width = 1 + flights * specific + len(self.shared)
        joined = np.zeros((blocks.shape[1], width, width))
        for number, block in enumerate(blocks):
            positions = self.indices_of(number)
            joined[:, positions[:, None], positions] += block
        return joined

    def indices_of(self, number: int) -> np.ndarray:
        """Where residual and parameters of a flight are among those of all."""
        flights, specific = len(self.members), len(self.flight_specific)
        positions = np.zeros(1 + self.size, dtype=np.int64)
        positions[[1 + item for item in self.flight_specific]] = 1 + number * specific + np.arange(specific)
        positions[[1 + item for item in self.shared]] = 1 + flights * specific + np.arange(len(self.shared))
        return positions

    def misfit(self, box: Box) -> Float[np.ndarray, " points"]:
        """Squared distance from what is known beforehand, in standard errors."""
        return self.nodes.misfit(box, self.known) if self.known else np.zeros(1)

    def least(self, box: Box) -> Float[np.ndarray, " points"]:
        """Least J at the points of a box."""
        N, D = self._blocks(box)
        return least_ratio(self._joined(N), self._joined(D)) + self.misfit(box)

    # -- the minimum -----------------------------------------------------------------------------------------

    @cached_property
    def scan(self) -> NuisanceScan:
        """The least J over the continuous nuisance, where there is one at most."""
        return NuisanceScan(self.nodes, lambda positions: self.least(self.nodes.box(positions)))

    @cached_property
    def minimum(self) -> tuple[Values, float]:
        """Continuous nuisances where J is least, and J there."""
        if len(self.nodes.axes) < 2:
            position, J = self.scan.minimum
            return self.nodes.values_at(np.array([position])[: len(self.nodes.axes)]), J
        result = argmin(self.least, self.nodes.nodes)
        return self.nodes.values_at(result), float(self.least([*result[:, None]])[0])

    def parameters(self, nuisances: Values) -> list[Float[np.ndarray, " n"]]:
        """Linear parameters of each flight where J is least, at values of the continuous nuisances."""
        made = [products_at(member.rows_at(nuisances), member.centre) for member in self.members]
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

    # -- sets ------------------------------------------------------------------------------------------------

    def below(self, bound: float, position: int) -> list[list[tuple[float, float]]]:
        """For each flight the values of one parameter at which J is at most a bound, as pieces."""
        results: list[list[tuple[float, float]]] = [[] for _ in self.members]
        for within, cut_short in self.scan.stretches(bound):
            box = self.nodes.box(within)
            N, D = self._blocks(box)
            left = (bound - self.misfit(box))[:, None, None] * np.ones((within.size, 1, 1))
            for number, (Q, free) in enumerate(self._others_free(N - left * D)):
                order = [0, 1 + position, *(1 + j for j in range(self.size) if j != position)]
                zeros = np.zeros(within.size)
                fitting = allowed(Q[:, order][:, :, order], np.zeros(Q.shape), zeros)
                pieces = fitting.continued() if cut_short else fitting.pieces()
                if free.any():
                    pieces = [(-inf, inf)]
                scale = self._scales[0] / self._scales[1 + position]
                centre = self.members[number].centre[position]
                results[number] += [(centre + a * scale, centre + b * scale) for a, b in pieces]
        return results

    def _others_free(self, Q: Forms) -> list[tuple[Float[np.ndarray, "k b b"], Bool[np.ndarray, " k"]]]:
        """For each flight the form of its parameters, those of the other flights where the form is least."""
        selected, kept = [1 + item for item in self.flight_specific], [0, *(1 + item for item in self.shared)]
        rest = Q[:, :, kept][:, :, :, kept]
        free = np.zeros(Q.shape[:2], dtype=np.bool_)
        if selected:
            inner, cross = Q[:, :, selected][:, :, :, selected], Q[:, :, selected][:, :, :, kept]
            free = np.linalg.eigvalsh(inner)[:, :, 0] <= 0.0
            inner = np.where(free[:, :, None, None], np.eye(len(selected)), inner)
            rest = rest - np.swapaxes(cross, 2, 3) @ np.linalg.solve(inner, cross)
        total, some = rest.sum(axis=0), free.sum(axis=0)
        results = []
        for number, block in enumerate(Q):
            whole = block.copy()
            whole[:, np.array(kept)[:, None], kept] += total - rest[number]
            results.append((whole, some > free[number]))
        return results


# -- Joint --


@dataclass(frozen=True)
class MemberSlopes:
    """What a flight says of its own vector at the pool's estimate."""

    seen: Float[np.ndarray, "q v"]
    power: Float[np.ndarray, "v v"]
    meat: Float[np.ndarray, "v v"]
    nuisance_columns: Float[np.ndarray, "rows c"]  # Derivatives by the continuous nuisances
    residual_power: float


def member_slopes(
    member: PoolMember, nuisances: tuple[Nuisance, ...], values: Values, theta: Float[np.ndarray, " n"]
) -> MemberSlopes:
    """Jacobian and scores of a flight."""
    rows, index = member.rows_at(values), {**member.fixed, **values}
    moved = [slope(member.weights, nuisance, index, theta) for nuisance in nuisances]
    columns = np.column_stack([np.empty((rows.response.size, 0)), *moved])
    jacobian = np.column_stack([rows.regressors, columns])
    seen = rows.instruments.T @ jacobian
    residual = rows.response - rows.regressors @ theta
    scores = rows.layout.scores(rows.instruments @ seen, residual)
    averages = max(min(COSINE_AVERAGES, len(scores) - jacobian.shape[1]), 1)
    meat = cosine_covariance([scores], len(scores), averages)
    return MemberSlopes(seen, jacobian.T @ jacobian, meat, columns, float(residual @ residual))


@dataclass(frozen=True)
class PoolJoint:
    """Linearised pool: every flight's own parameters, then what is shared, then continuous nuisances."""

    criterion: PoolCriterion
    slopes: tuple[MemberSlopes, ...]
    inflation: float = 1.0

    @cached_property
    def indices(self) -> list[np.ndarray]:
        """Where the vector of each flight is in that of the pool."""
        first = self.flight_parameter_count + len(self.criterion.shared)
        nuisances = np.arange(first, self.criterion.unknowns)
        linear = (self.criterion.indices_of(number)[1:] - 1 for number in range(len(self.slopes)))
        return [np.append(positions, nuisances) for positions in linear]

    @property
    def flight_parameter_count(self) -> int:
        """Parameters that belong to flights, of all flights."""
        return len(self.slopes) * len(self.criterion.flight_specific)

    def _summed(self, part: Callable[[MemberSlopes], Float[np.ndarray, "v v"]]) -> Float[np.ndarray, "m m"]:
        total = np.zeros((self.criterion.unknowns, self.criterion.unknowns))
        for index, slopes in zip(self.indices, self.slopes, strict=True):
            total[index[:, None], index] += part(slopes)
        return total

    @cached_property
    def variance(self) -> float:
        """s^2 of the whitened rows."""
        power = sum(item.residual_power for item in self.slopes)
        return power / (self.criterion.rows - self.criterion.unknowns)

    @cached_property
    def _prior(self) -> Float[np.ndarray, "m m"]:
        """What is known beforehand of nuisances, as information."""
        axes, known = self.criterion.nodes.axes, self.criterion.known
        information = np.zeros(self.criterion.unknowns)
        for number, axis in enumerate(axes, start=information.size - len(axes)):
            if axis.nuisance.name in known:
                information[number] = known[axis.nuisance.name].std ** -2.0
        return np.diag(information)

    @cached_property
    def sensitivity(self) -> Float[np.ndarray, "m m"]:
        """Minus the derivative of all scores."""
        return self._summed(lambda item: item.seen.T @ item.seen) + self.variance * self._prior

    @cached_property
    def classical(self) -> Float[np.ndarray, "m m"]:
        """Covariance for white residuals."""
        return self._widened(sandwich(self.sensitivity, self.variance * self.sensitivity))

    @cached_property
    def by_cosines(self) -> Float[np.ndarray, "m m"]:
        """Covariance by cosine averages in each flight, and what is known beforehand."""
        meat = self._summed(lambda item: item.meat) + self.variance**2 * self._prior
        return self._widened(sandwich(self.sensitivity, meat))

    def _widened(self, covariance: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
        """With the variance of what is shared times the inflation, and what that moves."""
        if self.inflation <= 1.0:
            return covariance
        first = self.flight_parameter_count
        H = self.sensitivity
        moved = np.vstack([-np.linalg.solve(H[:first, :first], H[:first, first:]), np.eye(len(H) - first)])
        return covariance + (self.inflation - 1.0) * moved @ covariance[first:, first:] @ moved.T

    def of(self, mapping: Float[np.ndarray, "v m"]) -> JointCovariance:
        """Covariance of linear combinations of the pool's parameters."""
        robust = mapping @ self.by_cosines @ mapping.T
        cosines = CovariancePart("equal_weighted_cosines", robust, float(COSINE_AVERAGES))
        return JointCovariance((cosines, CovariancePart("classical", mapping @ self.classical @ mapping.T)))

    def shared_variance(self, direction: Float[np.ndarray, " m"]) -> float:
        """What is shared adds so much to the variance of a combination of the flights' own parameters."""
        first, H = self.flight_parameter_count, self.sensitivity
        moved = -np.linalg.solve(H[:first, :first], H[:first, first:]).T @ direction[:first]
        largest = [item[first:, first:] for item in (self.classical, self.by_cosines)]
        return max(float(moved @ covariance @ moved) for covariance in largest)

    def flight_parameter_variance(self, positions: list[int]) -> Float[np.ndarray, " F"]:
        """Variance of a parameter of each flight's own, were what is shared known."""
        first = self.flight_parameter_count
        inner = self.sensitivity[:first, :first]
        meat = self._summed(lambda item: item.meat)[:first, :first]
        white, robust = sandwich(inner, self.variance * inner), sandwich(inner, meat)
        return np.maximum(np.diag(white), np.diag(robust))[positions]

    def of_member(self, number: int) -> JointCovariance:
        """Covariance of one flight's vector: its linear parameters and the continuous nuisances."""
        return self.of(np.eye(self.criterion.unknowns)[self.indices[number]])

    @cached_property
    def first_stage(self) -> Float[np.ndarray, " m"]:
        """Conditional first-stage F of each parameter of the pool."""
        scale = unit_scale(np.diag(self.sensitivity))
        inverse = np.linalg.pinv(np.outer(scale, scale) * self.sensitivity, hermitian=True)
        variances = np.diag(inverse)
        directions = inverse / np.where(variances > 0.0, variances, np.inf)
        power = np.outer(scale, scale) * (self._summed(lambda item: item.power) + self.variance * self._prior)
        explained = 1.0 / np.where(variances > 0.0, variances, np.inf)
        left = np.einsum("ij,ik,kj->j", directions, power, directions) - explained
        vector = self.slopes[0].power.shape[0]
        spare = max(self.criterion.instruments / len(self.slopes) - vector + 1.0, 1.0)
        rest = max(self.criterion.rows - self.criterion.instruments, 1)
        return np.where(left > 0.0, explained / spare / (left / rest), np.inf)


# -- Estimate --


@dataclass(frozen=True)
class PoolCandidate:
    """A pool at one combination of the discrete nuisances."""

    separate: PoolCriterion
    common: PoolCriterion
    nuisances: Values  # Every nuisance, where `separate` is least
    theta: tuple[Float[np.ndarray, " n"], ...]  # Linear parameters of each flight there
    joint: PoolJoint

    @property
    def criterion(self) -> float:
        """J."""
        return self.separate.minimum[1]

    @cached_property
    def common_theta(self) -> Float[np.ndarray, " n"]:
        """Linear parameters where `common` is least."""
        return self.common.parameters(self.common.minimum[0])[0]

    @property
    def profiles(self) -> tuple[NuisanceProfile, ...]:
        """J over the nodes of each continuous nuisance, at the best of the others."""
        nodes = self.separate.nodes
        unknown = tuple(axis.nuisance for axis in nodes.axes)
        if not unknown:
            return ()
        return profiles_of(unknown, [axis.values for axis in nodes.axes], self.separate.least(nodes.nodes))


def pool_candidate(criterion: PoolCriterion, inflation: float) -> PoolCandidate:
    """Linearise a pool where its criterion is least; what is shared has its variance multiplied."""
    nuisances, _ = criterion.minimum
    theta = criterion.parameters(nuisances)
    unknown = tuple(axis.nuisance for axis in criterion.nodes.axes)
    slopes = tuple(
        member_slopes(member, unknown, nuisances, item)
        for member, item in zip(criterion.members, theta, strict=True)
    )
    first = criterion.members[0]
    shared = tuple(member.recentred(first.centre) for member in criterion.members)
    common = replace(criterion, members=shared, flight_specific=())
    joint = PoolJoint(criterion, slopes, inflation)
    return PoolCandidate(criterion, common, {**first.fixed, **nuisances}, tuple(theta), joint)


# -- Pooled --

#: Flights differ, in what is their own or in what they share, when chance explains it so rarely.
DIFFERENT = 0.05


@dataclass(frozen=True)
class CommonValue:
    """One value for all flights of a parameter that belongs to the flight."""

    value: float
    weights: Float[np.ndarray, " F"]
    differing: float | None  # Variance of the mean over flights that differ


@dataclass(frozen=True)
class Pooled:
    """Estimates of a pool."""

    estimates: tuple[Estimate, ...]
    flight_specific: tuple[str, ...]  # Linear parameters that belong to the flight
    candidates: tuple[PoolCandidate, ...]
    nuisances: tuple[Nuisance, ...]
    shared_p_value: float
    separate: bool = False

    @property
    def problems(self) -> tuple[SeparableProblem, ...]:
        """Of each flight."""
        return tuple(member.problem for member in self.candidates[0].separate.members)

    @property
    def nuisance_names(self) -> tuple[str, ...]:
        """Of those that are searched for between the values of their grids."""
        return tuple(axis.nuisance.name for axis in self.candidates[0].separate.nodes.axes)

    @property
    def best(self) -> int:
        """Place of the candidate that fits best."""
        return int(np.argmin([candidate.criterion for candidate in self.candidates]))

    @property
    def inflation(self) -> float:
        """Factor of the variance of what is shared."""
        return self.candidates[0].joint.inflation

    @cached_property
    def agreement_p_value(self) -> float:
        """Of the test that flights agree in what is their own."""
        together = min(candidate.common.minimum[1] for candidate in self.candidates)
        separated = min(candidate.criterion for candidate in self.candidates)
        degrees = (len(self.estimates) - 1) * len(self.flight_specific)
        return chi_square_tail(max(together - separated, 0.0), degrees)

    @property
    def differs(self) -> bool:
        """Whether flights differ in what is their own, or are not taken as agreeing."""
        return self.separate or self.agreement_p_value < DIFFERENT

    # -- one flight ------------------------------------------------------------------------------------------

    def member(self, number: int) -> Estimate:
        """Estimate of one flight, with what the pool says of what it shares."""
        return self._estimate(
            self._candidate(
                pool,
                pool.separate.members[number].rows_at(pool.nuisances),
                pool.theta[number],
                pool.joint.slopes[number].nuisance_columns,
                pool.joint.of_member(number),
            )
            for pool in self.candidates
        )

    def member_sets(self, name: str, level: float = 0.95) -> tuple[ParameterSets | None, ...]:
        """Sets of a parameter of each flight's own; None where several nuisances are continuous."""
        if len(self.candidates[0].separate.nodes.axes) > 1:
            return (None,) * len(self.estimates)
        position = self._positions([name])[0]
        members = self.candidates[self.best].separate.members

        criteria = [candidate.separate for candidate in self.candidates]

        def below(excess: float) -> list[ConfidenceSet]:
            return [ConfidenceSet.union(pieces) for pieces in self._below(criteria, excess, position)]

        profiles = below(self._largest_excess(level))
        counts = {member.instruments for member in members}
        robust = {count: below(chi_square_quantile(level, count)) for count in counts}
        return tuple(
            ParameterSets(
                ConfidenceSet((self.member(number).interval(name, level),)),
                profiles[number],
                robust[member.instruments][number],
            )
            for number, member in enumerate(members)
        )

    # -- all flights -----------------------------------------------------------------------------------------

    def whole(self) -> Estimate:
        """Estimate of the pool: what is shared, and the common value or the mean of what is not."""
        return self._estimate(self._of_all(pool) for pool in self.candidates)

    def whole_sets(self, name: str, level: float = 0.95) -> ParameterSets | None:
        """Sets of a parameter that all flights have in common, or of the common value of one that is not."""
        is_specific = name in self.flight_specific
        if len(self.candidates[0].separate.nodes.axes) > 1 or (is_specific and self.differs):
            return None
        position = self._positions([name])[0]
        criteria = [candidate.common if is_specific else candidate.separate for candidate in self.candidates]
        instruments = max(member.instruments for member in criteria[0].members)

        def below(excess: float) -> ConfidenceSet:
            return ConfidenceSet.union(self._below(criteria, excess, position)[0])

        return ParameterSets(
            ConfidenceSet((self.whole().interval(name, level),)),
            below(self._largest_excess(level)),
            below(chi_square_quantile(level, instruments)),
        )

    def lag_set(self, names: Sequence[str], level: float = 0.95) -> ConfidenceSet | None:
        """Profile set of the continuous nuisance, or of its sum with discrete ones."""
        nodes = self.candidates[0].separate.nodes
        if len(nodes.axes) != 1:
            return None
        (axis,) = nodes.axes
        criteria = [candidate.separate for candidate in self.candidates]
        pieces = []
        for pool, lowest in zip(self.candidates, self._least(criteria), strict=True):
            neighbours = sum(pool.nuisances[name] for name in names if name != axis.nuisance.name)
            for within, cut_short in pool.separate.scan.stretches(lowest + self._largest_excess(level)):
                low, high = axis.values_at(within[[0, -1]]).tolist()
                if axis.nuisance.positive and within[0] == axis.nodes[0]:
                    low = 0.0
                pieces.append((neighbours + low, inf if cut_short else neighbours + high))
        return ConfidenceSet.union(pieces)

    def _largest_excess(self, level: float) -> float:
        """By how much J may exceed its least in a profile set; more where what is shared differs."""
        return self.inflation * t_quantile(level, DEGREES) ** 2

    def _least(self, criteria: Sequence[PoolCriterion]) -> list[float]:
        """For each candidate the least J of those it competes with."""
        points = [candidate.nuisances for candidate in self.candidates]
        minima = [criterion.minimum[1] for criterion in criteria]
        return least_comparable_criteria(bounded_sums(self.nuisances), points, minima)

    def _below(
        self, criteria: Sequence[PoolCriterion], excess: float, position: int
    ) -> list[list[tuple[float, float]]]:
        """For each flight pieces where J exceeds the least of those it competes with by no more."""
        results: list[list[tuple[float, float]]] = [[] for _ in self.estimates]
        for lowest, criterion in zip(self._least(criteria), criteria, strict=True):
            for pieces, more in zip(results, criterion.below(lowest + excess, position), strict=True):
                pieces.extend(more)
        return results

    def mean(self, name: str, candidate: PoolCandidate | None = None) -> CommonValue:
        """One value for all flights of a parameter that is their own."""
        pool = self.candidates[self.best] if candidate is None else candidate
        position = self._positions([name])[0]
        values = np.array([theta[position] for theta in pool.theta])
        rows = [int(index[position]) for index in pool.joint.indices]
        if self.differs:
            flights, variances = one_group(values.size), pool.joint.flight_parameter_variance(rows)
            between = moment_between(flights, values, variances)
            means = random_effects_means(flights, values, variances, between)
            return CommonValue(float(means.value[0]), means.weights, float(means.variance[0]))
        covariance = pool.joint.classical[np.ix_(rows, rows)]
        weights = np.linalg.solve(covariance, np.ones(values.size))
        return CommonValue(float(pool.common_theta[position]), weights / weights.sum(), None)

    def _positions(self, names: Sequence[str]) -> list[int]:
        parameters = [parameter.name for parameter in self.estimates[0].rows.parameters]
        return [parameters.index(name) for name in names]

    def _of_all(self, pool: PoolCandidate) -> Estimate:
        """Rows of all flights, their response less what a flight's own parameters differ from the mean."""
        joint, positions = pool.joint, self._positions(self.flight_specific)
        commons = (self.mean(name, pool) for name in self.flight_specific)
        means = dict(zip(positions, commons, strict=True))
        theta = pool.theta[0].copy()
        theta[positions] = [means[position].value for position in positions]
        made = [member.rows_at(pool.nuisances) for member in pool.separate.members]
        each = list(zip(made, pool.theta, joint.slopes, strict=True))
        rows = Regression(
            np.concatenate([item.response - item.regressors @ (values - theta) for item, values, _ in each]),
            np.concatenate([item.regressors for item in made]),
            np.concatenate([item.instruments @ slopes.seen for item, _, slopes in each]),
            made[0].parameters,
            _joined([item.layout for item in made]),
        )
        columns = np.concatenate([slopes.nuisance_columns for slopes in joint.slopes])
        vector = np.eye(joint.criterion.unknowns)[joint.indices[0]]
        for element, mean in means.items():
            vector[element] = 0.0
            vector[element, [index[element] for index in joint.indices]] = mean.weights
        return self._candidate(pool, rows, theta, columns, self._covariance(joint, vector, means))

    def _covariance(
        self, joint: PoolJoint, vector: Float[np.ndarray, "v m"], means: dict[int, CommonValue]
    ) -> JointCovariance:
        """Of the mean and of what is shared; where flights differ, with a part for that."""
        result = joint.of(vector)
        variances = np.zeros(vector.shape[0])
        for name, mean in means.items():
            if mean.differing is not None:
                variances[name] = mean.differing + joint.shared_variance(vector[name])
        if not variances.any():
            return result
        between = CovariancePart("between_flights", np.diag(variances), float(len(self.estimates) - 1))
        return JointCovariance((*result.parts, between))

    def _estimate(self, candidates: Iterable[Estimate]) -> Estimate:
        first = self.estimates[0]
        refined = (nuisance.parameter for nuisance in self.nuisances if nuisance.refined)
        joint = (*first.rows.parameters, *refined)
        best, *others = sorted(candidates, key=lambda candidate: candidate.criterion)
        return replace(
            best,
            method=first.method,
            joint_parameters=joint,
            others=tuple(others),
            bounded=bounded_sums(self.nuisances),
        )

    def _candidate(
        self,
        pool: PoolCandidate,
        rows: Regression,
        theta: Float[np.ndarray, " n"],
        nuisance_columns: Float[np.ndarray, "rows c"],
        covariance: JointCovariance,
    ) -> Estimate:
        method = by_name(self.estimates[0].method)
        check_linear(method)
        solved = cast("LinearMethod", method).solve(rows)
        residual = solved.system.right - solved.system.matrix @ theta
        misfits, precision = known_misfits(self.nuisances, pool.nuisances)
        return replace(
            solved,
            solution=replace(solved.solution, theta=theta, residual=residual, objective=pool.criterion),
            nuisance_columns=nuisance_columns,
            precision=precision,
            misfits=misfits,
            nuisances={nuisance.name: pool.nuisances[nuisance.name] for nuisance in self.nuisances},
            profiles=pool.profiles,
            covariance_estimator=self.estimates[0].covariance_estimator,
            streamed_covariance=covariance,
            flight_criterion=pool.criterion,
        )


def _joined(layouts: Sequence[object]) -> BinRows:
    bins = ((number, layout) for number, layout in enumerate(layouts) if isinstance(layout, BinRows))
    return BinRows(tuple(replace(run, flight=number) for number, layout in bins for run in layout.runs))


# -- Pooling --

#: Nodes of a nuisance, at least: products of lags that are close make differences that are small.
FEWEST_NODES = 33


def pooled(
    problems: Sequence[SeparableProblem],
    estimates: Sequence[Estimate],
    names: Sequence[str],
    *,
    nuisances: tuple[Nuisance, ...],
    separate: bool = False,
) -> Pooled:
    """Pool flights that share some parameters."""
    nuisances = reaching(nuisances, [estimate.nuisances for estimate in estimates])
    nodes = nodes_of(nuisances, FEWEST_NODES)
    parameters = [parameter.name for parameter in estimates[0].rows.parameters]
    index = tuple(parameters.index(name) for name in names)

    criteria = on_nested_grids(
        nuisances,
        lambda fixed, _: _criterion(problems, estimates, index, nodes, fixed),
        lambda criterion: criterion.minimum[1],
    )
    p_value, inflation = _differences(criteria)
    candidates = tuple(pool_candidate(criterion, inflation) for criterion in criteria)
    return Pooled(tuple(estimates), tuple(names), candidates, nuisances, p_value, separate)


def _criterion(
    problems: Sequence[SeparableProblem],
    estimates: Sequence[Estimate],
    specific: tuple[int, ...],
    nodes: Nodes,
    fixed: Values,
) -> PoolCriterion:
    alone = [_nearest(estimate, fixed) for estimate in estimates]
    known = {
        axis.nuisance.name: replace(
            prior, mean=prior.mean - sum(fixed[name] for name in axis.nuisance.known_with)
        )
        for axis in nodes.axes
        if (prior := axis.nuisance.prior) is not None
    }

    def weighted(valueses: Sequence[Values], theta: Sequence[Float[np.ndarray, " n"]]) -> PoolCriterion:
        shared = np.median(theta, axis=0)
        members = []
        for problem, values, parameters in zip(problems, valueses, theta, strict=True):
            centre = shared.copy()
            centre[list(specific)] = parameters[list(specific)]
            members.append(pool_member(problem, nodes, {**values, **fixed}, parameters, centre))
        return PoolCriterion(tuple(members), specific, nodes, known)

    first = weighted([item.nuisances for item in alone], [item.theta for item in alone])
    nuisances = first.minimum[0]
    return weighted([nuisances] * len(alone), first.parameters(nuisances))


def _nearest(estimate: Estimate, fixed: Values) -> Estimate:
    refined = {profile.nuisance.name for profile in estimate.profiles}
    names = [name for name in fixed if name not in refined]
    return min(
        estimate.candidates,
        key=lambda candidate: sum(abs(candidate.nuisances[name] - fixed[name]) for name in names),
    )


def _differences(criteria: Sequence[PoolCriterion]) -> tuple[float, float]:
    """P-value of agreement in what is shared, and by what its variance is multiplied."""
    first = criteria[0]
    together = min(replace(criterion, known={}).minimum[1] for criterion in criteria)
    alone = sum(
        min(
            replace(criterion, members=(criterion.members[number],), known={}).minimum[1]
            for criterion in criteria
        )
        for number in range(len(first.members))
    )
    degrees = (len(first.members) - 1) * (len(first.shared) + len(first.nodes.axes))
    excess = max(together - alone, 0.0)
    p_value = chi_square_tail(excess, degrees)
    return p_value, max(excess / degrees, 1.0) if p_value < DIFFERENT else 1.0
