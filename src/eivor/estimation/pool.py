"""Pooled estimation of several flights with common and own parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from eivor.estimation import profile_sets as sets
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_method, known_misfits, nuisance_columns
from eivor.estimation.methods import by_name
from eivor.estimation.variable_projection import NuisanceProfile, nodes_of, profiles_of
from eivor.estimation.weighting import whitened_by_residuals
from eivor.inference import covariance as cov
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.distributions import chi_square_quantile, chi_square_tail, t_quantile
from eivor.inference.random_effects import Grouped, one_group
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.tools import Float


@dataclass(frozen=True)
class MemberSlopes:
    """Jacobian and scores of a flight at the pool's estimate."""

    projected: Float[np.ndarray, "q v"]
    power: Float[np.ndarray, "v v"]
    meat: Float[np.ndarray, "v v"]
    nuisance_columns: Float[np.ndarray, "rows c"]  # Derivatives by the continuous nuisances
    residual_power: float


def member_slopes(
    member: sets.PoolMember, nuisances: tuple[Nuisance, ...], values: Values, theta: Float[np.ndarray, " n"]
) -> MemberSlopes:
    """Jacobian and scores of a flight."""
    rows = member.weights.rows(values)
    columns = nuisance_columns(member.weights, nuisances, values, theta)
    jacobian = np.column_stack([rows.regressors, *columns.T])
    projected = rows.instruments.T @ jacobian
    residual = rows.response - rows.regressors @ theta
    scores = rows.layout.scores(rows.instruments @ projected, residual)
    averages = max(min(cov.COSINE_AVERAGES, len(scores) - jacobian.shape[1]), 1)
    meat = cov.cosine_covariance([scores], len(scores), averages)
    return MemberSlopes(projected, jacobian.T @ jacobian, meat, columns, float(residual @ residual))


@dataclass(frozen=True)
class PoolJoint:
    """Linearised pool: every flight's own parameters, then shared ones, then continuous nuisances."""

    criterion: sets.Criterion
    slopes: tuple[MemberSlopes, ...]
    known: Float[np.ndarray, "k q"]  # Rows of what is known of nuisances beforehand, over standard errors
    inflation: float = 1.0

    @cached_property
    def indices(self) -> list[np.ndarray]:
        """Positions of each flight's vector in that of the pool."""
        first = self.flight_parameter_count + len(self.criterion.shared)
        nuisances = np.arange(first, self.criterion.unknowns)
        linear = (self.criterion.positions(number)[1:] - 1 for number in range(len(self.slopes)))
        return [np.append(positions, nuisances) for positions in linear]

    @property
    def flight_parameter_count(self) -> int:
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
        """Information of the nuisances' priors."""
        information = np.zeros((self.criterion.unknowns, self.criterion.unknowns))
        first = self.criterion.unknowns - self.known.shape[1]
        information[first:, first:] = self.known.T @ self.known
        return information

    @cached_property
    def sensitivity(self) -> Float[np.ndarray, "m m"]:
        """Minus the derivative of all scores."""
        return self._summed(lambda item: item.projected.T @ item.projected) + self.variance * self._prior

    @cached_property
    def classical(self) -> Float[np.ndarray, "m m"]:
        """Covariance for white residuals."""
        return self._widened(cov.sandwich(self.sensitivity, self.variance * self.sensitivity))

    @cached_property
    def by_cosines(self) -> Float[np.ndarray, "m m"]:
        """Covariance by cosine averages in each flight, and by priors."""
        meat = self._summed(lambda item: item.meat) + self.variance**2 * self._prior
        return self._widened(cov.sandwich(self.sensitivity, meat))

    def _widened(self, covariance: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
        """Covariance with the variance of shared parameters times the inflation, and its effect."""
        if self.inflation <= 1.0:
            return covariance
        first = self.flight_parameter_count
        H = self.sensitivity
        response = np.vstack([-np.linalg.solve(H[:first, :first], H[:first, first:]), np.eye(len(H) - first)])
        return covariance + (self.inflation - 1.0) * response @ covariance[first:, first:] @ response.T

    def combined(self, mapping: Float[np.ndarray, "v m"]) -> cov.JointCovariance:
        """Covariance of linear combinations of the pool's parameters."""
        robust = mapping @ self.by_cosines @ mapping.T
        cosines = cov.CovariancePart("equal_weighted_cosines", robust, float(cov.COSINE_AVERAGES))
        return cov.JointCovariance(
            (cosines, cov.CovariancePart("classical", mapping @ self.classical @ mapping.T))
        )

    def shared_variance(self, direction: Float[np.ndarray, " m"]) -> float:
        """Variance that shared parameters add to a combination of the flights' own parameters."""
        first, H = self.flight_parameter_count, self.sensitivity
        response = -np.linalg.solve(H[:first, :first], H[:first, first:]).T @ direction[:first]
        covariances = (self.classical, self.by_cosines)
        return max(float(response @ covariance[first:, first:] @ response) for covariance in covariances)

    def flight_parameter_variance(self, positions: list[int]) -> Float[np.ndarray, " F"]:
        """Variance of a parameter of each flight's own, for known shared parameters."""
        first = self.flight_parameter_count
        inner = self.sensitivity[:first, :first]
        meat = self._summed(lambda item: item.meat)[:first, :first]
        white, robust = cov.sandwich(inner, self.variance * inner), cov.sandwich(inner, meat)
        return np.maximum(np.diag(white), np.diag(robust))[positions]

    @cached_property
    def first_stage(self) -> Float[np.ndarray, " m"]:
        """Conditional first-stage F of each parameter of the pool."""
        scale = cov.unit_scale(np.diag(self.sensitivity))
        inverse = np.linalg.pinv(np.outer(scale, scale) * self.sensitivity, hermitian=True)
        variances = np.diag(inverse)
        directions = inverse / np.where(variances > 0.0, variances, np.inf)
        power = np.outer(scale, scale) * (self._summed(lambda item: item.power) + self.variance * self._prior)
        explained = 1.0 / np.where(variances > 0.0, variances, np.inf)
        unexplained = np.einsum("ij,ik,kj->j", directions, power, directions) - explained
        vector = self.slopes[0].power.shape[0]
        spare = max(self.criterion.instruments / len(self.slopes) - vector + 1.0, 1.0)
        rest = max(self.criterion.rows - self.criterion.instruments, 1)
        return np.where(unexplained > 0.0, explained / spare / (unexplained / rest), np.inf)


#: Level of the tests that flights agree, in their own parameters or in shared ones.
DIFFERENT = 0.05


#: Common value of a parameter of the flights' own, the flights' weights in it, and the variance of
#: the mean over flights that differ.
CommonValue = tuple[float, Float[np.ndarray, " F"], float | None]


@dataclass(frozen=True)
class Pooled:
    """Estimates of a pool."""

    estimates: tuple[Estimate, ...]
    flight_specific: tuple[str, ...]  # Linear parameters that belong to the flight
    differing: tuple[str, ...]  # Those of them that the flights should share, and do not
    criterion: sets.Criterion
    nuisances: tuple[Nuisance, ...]
    shared_p_value: float
    inflation: float  # Factor of the variance of what is shared
    separate: bool = False

    @property
    def tested(self) -> tuple[str, ...]:
        """Parameters of the flight in which all may agree."""
        return tuple(name for name in self.flight_specific if name not in self.differing)

    @cached_property
    def common(self) -> sets.Criterion:
        """J of flights that agree in their own parameters, but for those that differ."""
        positions, members = self._positions(self.differing), list[sets.PoolMember]()
        for member in self.criterion.members:
            centre = self.criterion.members[0].centre.copy()
            centre[positions] = member.centre[positions]
            members.append(member.recentred(centre))
        return replace(self.criterion, members=tuple(members), flight_specific=tuple(positions))

    @property
    def values(self) -> Values:
        """Every nuisance, where J is least."""
        return self.criterion.minimum[0]

    @cached_property
    def theta(self) -> tuple[Float[np.ndarray, " n"], ...]:
        """Linear parameters of each flight there."""
        return tuple(self.criterion.parameters(self.values))

    @cached_property
    def joint(self) -> PoolJoint:
        """The pool linearised there, with the variance of shared parameters inflated."""
        slopes = tuple(
            member_slopes(member, self.criterion.nodes.nuisances, self.values, theta)
            for member, theta in zip(self.criterion.members, self.theta, strict=True)
        )
        known = known_misfits(self.nuisances, self.values)[1]
        return PoolJoint(self.criterion, slopes, known, self.inflation)

    @property
    def profiles(self) -> tuple[NuisanceProfile, ...]:
        """J over the nodes of each nuisance, at the best of the others."""
        nodes = self.criterion.nodes
        if not nodes.nuisances:
            return ()
        return profiles_of(nodes.nuisances, self.criterion.profile_over(nodes.places))

    @property
    def problems(self) -> tuple[SeparableProblem, ...]:
        return tuple(member.weights.problem for member in self.criterion.members)

    @cached_property
    def agreement_p_value(self) -> float:
        """P-value of the test that flights agree in their own parameters."""
        degrees = (len(self.estimates) - 1) * len(self.tested)
        return chi_square_tail(max(self.common.minimum[1] - self.criterion.minimum[1], 0.0), degrees)

    @property
    def differs(self) -> bool:
        """Whether flights differ in their own parameters, or are not taken as agreeing."""
        return self.separate or self.agreement_p_value < DIFFERENT

    def has_mean(self, name: str) -> bool:
        """Whether the pool's value of a parameter is a mean of flights that differ."""
        return name in self.differing or (self.differs and name in self.flight_specific)

    def member(self, number: int) -> Estimate:
        """Estimate of one flight, with the pool's values of shared parameters."""
        return self._estimate(
            self.criterion.members[number].weights.rows(self.values),
            self.theta[number],
            self.joint.slopes[number].nuisance_columns,
            self.joint.combined(np.eye(self.criterion.unknowns)[self.joint.indices[number]]),
        )

    @property
    def has_sets(self) -> bool:
        """Whether parameters are few enough for sets."""
        return self.criterion.size <= sets.FEW_PARAMETERS

    def member_sets(self, name: str, level: float = 0.95) -> tuple[sets.ParameterSets | None, ...]:
        """Sets of a parameter of each flight's own; None of many parameters."""
        if not self.has_sets:
            return (None,) * len(self.estimates)
        position = self._positions([name])[0]
        members = self.criterion.members

        minimum = self.criterion.minimum[1]
        profiles = self.criterion.sets_below(minimum + self._largest_excess(level), position)
        robust = {
            count: self.criterion.sets_below(minimum + chi_square_quantile(level, count), position)
            for count in {member.instruments for member in members}
        }
        return tuple(
            sets.ParameterSets(
                ConfidenceSet((self.member(number).interval(name, level),)),
                profiles[number],
                robust[member.instruments][number],
            )
            for number, member in enumerate(members)
        )

    def common_sets(self, name: str, level: float = 0.95) -> sets.ParameterSets | None:
        """Sets of a parameter that all flights have in common, or of the common value of one that is not."""
        if not self.has_sets or (self.has_mean(name) and name not in self.differing):
            return None
        if name in self.differing:  # among the flights' values: a mean of two has an interval wide open
            mean = ConfidenceSet((self.pooled_estimate().interval(name, level),))
            members = (item.robust.intervals for item in self.member_sets(name, level) if item is not None)
            hull = ConfidenceSet.union(piece for pieces in members for piece in pieces).hull
            if np.ptp(hull) < mean.length:
                return sets.ParameterSets(mean, ConfidenceSet((hull,)), ConfidenceSet((hull,)))
            return None
        position = self._positions([name])[0]
        criterion = self.common if name in self.flight_specific else self.criterion
        instruments, minimum = max(member.instruments for member in criterion.members), criterion.minimum[1]
        return sets.ParameterSets(
            ConfidenceSet((self.pooled_estimate().interval(name, level),)),
            criterion.sets_below(minimum + self._largest_excess(level), position)[0],
            criterion.sets_below(minimum + chi_square_quantile(level, instruments), position)[0],
        )

    def lag_set(self, names: Sequence[str], level: float = 0.95) -> ConfidenceSet | None:
        """Profile set of the first nuisance, or of its sum with others."""
        if not self.criterion.nodes.nuisances or not self.has_sets:
            return None
        bound = self.criterion.minimum[1] + self._largest_excess(level)
        return self.criterion.sum_set(names, self.values, bound)

    def _largest_excess(self, level: float) -> float:
        """Largest excess of J over its minimum in a profile set; more where shared values differ."""
        return self.inflation * t_quantile(level, sets.DEGREES) ** 2

    def mean(self, name: str) -> CommonValue:
        """Common value of a parameter that is the flights' own."""
        position = self._positions([name])[0]
        values = np.array([theta[position] for theta in self.theta])
        rows = [int(index[position]) for index in self.joint.indices]
        if self.has_mean(name):
            flights = Grouped(one_group(values.size), values, self.joint.flight_parameter_variance(rows))
            means = flights.means(flights.moment_between())
            return float(means.value[0]), means.weights, float(means.variance[0])
        covariance = self.joint.classical[np.ix_(rows, rows)]
        weights = np.linalg.solve(covariance, np.ones(values.size))
        common = self.common.parameters(self.common.minimum[0])[0]
        return float(common[position]), weights / weights.sum(), None

    def _positions(self, names: Sequence[str]) -> list[int]:
        parameters = [parameter.name for parameter in self.estimates[0].rows.parameters]
        return [parameters.index(name) for name in names]

    def pooled_estimate(self) -> Estimate:
        """Estimate of the pool: shared parameters, and the common value or the mean of others."""
        # rows of all flights, their responses corrected to the mean of the flights' own parameters
        joint, positions = self.joint, self._positions(self.flight_specific)
        means = dict(zip(positions, map(self.mean, self.flight_specific), strict=True))
        theta = self.theta[0].copy()
        theta[positions] = [means[position][0] for position in positions]
        flight_rows = [member.weights.rows(self.values) for member in self.criterion.members]
        pool = list(zip(flight_rows, self.theta, joint.slopes, strict=True))
        layouts = [part.layout for part in flight_rows if isinstance(part.layout, BinRows)]
        rows = Regression(
            np.concatenate([part.response - part.regressors @ (values - theta) for part, values, _ in pool]),
            np.concatenate([part.regressors for part in flight_rows]),
            np.concatenate([part.instruments @ slopes.projected for part, _, slopes in pool]),
            flight_rows[0].parameters,
            BinRows(tuple(replace(run, flight=k) for k, layout in enumerate(layouts) for run in layout.runs)),
        )
        columns = np.concatenate([slopes.nuisance_columns for slopes in joint.slopes])
        vector = np.eye(joint.criterion.unknowns)[joint.indices[0]]
        for element, (_, weights, _) in means.items():
            vector[element] = 0.0
            vector[element, [index[element] for index in joint.indices]] = weights
        return self._estimate(rows, theta, columns, self._covariance(joint, vector, means))

    def _covariance(
        self, joint: PoolJoint, vector: Float[np.ndarray, "v m"], means: dict[int, CommonValue]
    ) -> cov.JointCovariance:
        """Covariance of means and shared parameters, with a part between flights that differ."""
        result = joint.combined(vector)
        variances = np.zeros(vector.shape[0])
        for element, (_, _, differing) in means.items():
            if differing is not None:
                variances[element] = differing + joint.shared_variance(vector[element])
        if not variances.any():
            return result
        part = cov.CovariancePart("between_flights", np.diag(variances), float(len(self.estimates) - 1))
        return cov.JointCovariance((*result.parts, part))

    def _estimate(
        self,
        rows: Regression,
        theta: Float[np.ndarray, " n"],
        nuisance_columns: Float[np.ndarray, "rows c"],
        covariance: cov.JointCovariance,
    ) -> Estimate:
        method, J = by_name(self.estimates[0].method), self.criterion.minimum[1]
        check_method(method)
        solved = cast("LinearMethod", method).solve(rows)
        residual = solved.system.right - solved.system.matrix @ theta
        misfits, known = known_misfits(self.nuisances, self.values)
        searched = (nuisance.parameter for nuisance in self.nuisances if nuisance.searched)
        return replace(
            solved,
            joint_parameters=(*solved.joint_parameters, *searched),
            solution=replace(solved.solution, theta=theta, residual=residual, objective=J),
            nuisance_columns=nuisance_columns,
            known=known,
            misfits=misfits,
            nuisances={nuisance.name: self.values[nuisance.name] for nuisance in self.nuisances},
            profiles=self.profiles,
            covariance_estimator=self.estimates[0].covariance_estimator,
            streamed_covariance=covariance,
            flight_criterion=J,
        )


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
    nodes = nodes_of(nuisances, FEWEST_NODES)
    problems = [problem.with_nuisances(nuisances) for problem in problems]
    parameters = [parameter.name for parameter in estimates[0].rows.parameters]
    specific = [parameters.index(name) for name in names]

    def weighted(values: Sequence[Values], theta: Sequence[Float[np.ndarray, " n"]]) -> sets.Criterion:
        shared, members = np.median(theta, axis=0), []
        for problem, point, parameters, estimate in zip(problems, values, theta, estimates, strict=True):
            centre = shared.copy()
            centre[specific] = parameters[specific]
            # products of a flight, whitened by its residual at some values
            weights = whitened_by_residuals(problem, parameters, {**point, **nodes.fixed})
            (products,) = sets.NuisanceProducts.of_rows(weights, nodes).values()
            count = weights.basis.shape[0] * estimate.rows.layout.independent
            members.append(sets.PoolMember(weights, centre, products.combined(sets.about(centre)), count))
        return sets.Criterion(tuple(members), tuple(specific), nodes, sets.known_priors(nodes))

    first = weighted([item.nuisances for item in estimates], [item.theta for item in estimates])
    values = first.minimum[0]
    criterion = weighted([values] * len(estimates), first.parameters(values))
    p_value, inflation = _differences(criterion)
    differing: tuple[str, ...] = ()
    if inflation > 1.0 and criterion.shared:  # by one parameter alone, as flights of two batteries
        freed = [replace(criterion, flight_specific=(*specific, index)) for index in criterion.shared]
        p_values = [_differences(item)[0] for item in freed]
        best = freed[int(np.argmax(p_values))]
        if max(p_values) >= DIFFERENT:
            specific, inflation = list(best.flight_specific), 1.0
            differing = (parameters[specific[-1]],)
            criterion = weighted([best.minimum[0]] * len(estimates), best.parameters(best.minimum[0]))
    return Pooled(
        tuple(estimates), (*names, *differing), differing, criterion, nuisances, p_value, inflation, separate
    )


def _differences(criterion: sets.Criterion) -> tuple[float, float]:
    """P-value of agreement in shared parameters, and the factor of their variance."""
    joint = replace(criterion, known={}).minimum[1]
    separate = sum(replace(criterion, members=(member,), known={}).minimum[1] for member in criterion.members)
    degrees = (len(criterion.members) - 1) * (len(criterion.shared) + len(criterion.nodes.nuisances))
    excess = max(joint - separate, 0.0)
    p_value = chi_square_tail(excess, degrees)
    return p_value, max(excess / degrees, 1.0) if p_value < DIFFERENT else 1.0
