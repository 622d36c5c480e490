"""A pool: one value of what its flights share, and values of their own of what belongs to a flight.

A flight is first estimated alone, with instruments and weights of its own. The pool is estimated with these
weights, and with weights by its own residuals again: a flight alone that cannot tell its lag has a residual
at a wrong one. For each combination of the discrete nuisances the pool's criterion is least over everything
else, see `criterion`, once with parameters of each flight's own, and once with these shared as well. The
difference of the two tells whether flights agree in them. Against the sum of what is least for each flight
alone, it tells whether flights differ in what they share: by so much as chance does not explain, the
variance of what is shared is multiplied (Birge 1932).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import cast

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.competing import bounded_sums, least_of_competitors
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.methods import by_name
from eivor.estimation.parameter_sets import DEGREES, ParameterSets
from eivor.estimation.pools.candidate import PoolCandidate
from eivor.estimation.pools.criterion import PoolCriterion
from eivor.estimation.pools.joint import PoolJoint
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.quantiles import chi_square_quantile, chi_square_tail, t_quantile
from eivor.inference.random_effects.between import moment_between
from eivor.inference.random_effects.groups import one_group
from eivor.inference.random_effects.mean import random_effects_means
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.models.regression import Regression
from eivor.models.separable import Nuisance, SeparableProblem
from eivor.models.spectral import BinRows
from eivor.shapes import Float

#: Flights differ, in what is their own or in what they share, when chance explains it so rarely.
DIFFERENT = 0.05


@dataclass(frozen=True)
class OwnMean:
    """One value for all flights of a parameter that belongs to the flight.

    Parameters
    ----------
    value : float
        The common one, or the mean.
    weights : ndarray, shape (F,)
        What each flight counts.
    differing : float or None
        Variance of the mean over flights that differ; None where they agree.
    """

    value: float
    weights: Float[np.ndarray, " F"]
    differing: float | None


@dataclass(frozen=True)
class Pooled:
    """Estimates of a pool.

    Parameters
    ----------
    estimates : tuple of Estimate
        Of each flight alone.
    own : tuple of str
        Linear parameters that belong to the flight.
    candidates : tuple of PoolCandidate
        One for each combination of discrete nuisances.
    nuisances : tuple of Nuisance
        With what is known of them beforehand.
    shared_p_value : float
        Of the test that flights agree in what they share.
    separate : bool
        Never take flights as agreeing in what is their own.
    """

    estimates: tuple[Estimate, ...]
    own: tuple[str, ...]
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
    def _method(self) -> LinearMethod:
        method = by_name(self.estimates[0].method)
        check_linear(method)
        return cast("LinearMethod", method)

    @property
    def best(self) -> int:
        """Place of the candidate that fits best."""
        return int(np.argmin([one.criterion for one in self.candidates]))

    @property
    def inflation(self) -> float:
        """Factor of the variance of what is shared."""
        return self.candidates[0].joint.inflation

    @cached_property
    def own_p_value(self) -> float:
        """Of the test that flights agree in what is their own."""
        together = min(one.common.minimum[1] for one in self.candidates)
        apart = min(one.criterion for one in self.candidates)
        degrees = (len(self.estimates) - 1) * len(self.own)
        return chi_square_tail(max(together - apart, 0.0), degrees)

    @property
    def differs(self) -> bool:
        """Whether flights differ in what is their own, or are not taken as agreeing."""
        return self.separate or self.own_p_value < DIFFERENT

    # -- one flight ------------------------------------------------------------------------------------------

    def member(self, number: int) -> Estimate:
        """Estimate of one flight, with what the pool says of what it shares."""
        return self._estimate(
            [
                _Solution(
                    pool.separate.members[number].rows_at(pool.at),
                    pool.theta[number],
                    pool.joint.slopes[number].nuisance_columns,
                    pool.joint.of_member(number),
                )
                for pool in self.candidates
            ]
        )

    def member_sets(self, name: str, level: float = 0.95) -> tuple[ParameterSets | None, ...]:
        """Sets of a parameter of each flight's own; None where several nuisances are continuous.

        The profile set is that of all flights. In place of the Anderson-Rubin set of all instruments stands
        that of the flight's own, beside what the pool says of the rest: J above its least by the quantile of
        chi-square with a degree of freedom for each of the flight's instruments.
        """
        if len(self.candidates[0].separate.nodes.axes) > 1:
            return (None,) * len(self.estimates)
        place = self._places([name])[0]
        members = self.candidates[self.best].separate.members

        def below(excess: float) -> list[ConfidenceSet]:
            found = self._below([one.separate for one in self.candidates], excess, place)
            return [ConfidenceSet.union(pieces) for pieces in found]

        profiles = below(self._allowance(level))
        robust = {
            count: below(chi_square_quantile(level, count)) for count in {m.instruments for m in members}
        }
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
        return self._estimate([self._of_all(pool) for pool in self.candidates])

    def whole_sets(self, name: str, level: float = 0.95) -> ParameterSets | None:
        """Sets of a parameter that all flights have in common, or of the common value of one that is not.

        None where flights differ in it, and where several nuisances are continuous.
        """
        own = name in self.own
        if len(self.candidates[0].separate.nodes.axes) > 1 or (own and self.differs):
            return None
        place = self._places([name])[0]
        criteria = [one.common if own else one.separate for one in self.candidates]
        instruments = max(member.instruments for member in criteria[0].members)

        def below(excess: float) -> ConfidenceSet:
            return ConfidenceSet.union(self._below(criteria, excess, place)[0])

        return ParameterSets(
            ConfidenceSet((self.whole().interval(name, level),)),
            below(self._allowance(level)),
            below(chi_square_quantile(level, instruments)),
        )

    def lag_set(self, names: Sequence[str], level: float = 0.95) -> ConfidenceSet | None:
        """Profile set of the continuous nuisance, or of its sum with discrete ones.

        None where none is continuous, or several are. A nuisance that is positive and fits down to the least
        value of its grid may be none at all; one that fits up to the largest has no upper bound.
        """
        nodes = self.candidates[0].separate.nodes
        if len(nodes.axes) != 1:
            return None
        (axis,) = nodes.axes
        criteria = [one.separate for one in self.candidates]
        pieces = []
        for pool, lowest in zip(self.candidates, self._least(criteria), strict=True):
            beside = sum(pool.at[name] for name in names if name != axis.nuisance.name)
            for within, cut_short in pool.separate.scan.stretches(lowest + self._allowance(level)):
                low, high = axis.at(within[[0, -1]]).tolist()
                if axis.nuisance.positive and within[0] == axis.places[0]:
                    low = 0.0
                pieces.append((beside + low, inf if cut_short else beside + high))
        return ConfidenceSet.union(pieces)

    def _allowance(self, level: float) -> float:
        """By how much J may exceed its least in a profile set; more where what is shared differs."""
        return self.inflation * t_quantile(level, DEGREES) ** 2

    def _least(self, criteria: Sequence[PoolCriterion]) -> list[float]:
        """For each candidate the least J of those it competes with."""
        points = [one.at for one in self.candidates]
        return least_of_competitors(
            bounded_sums(self.nuisances), points, [one.minimum[1] for one in criteria]
        )

    def _below(
        self, criteria: Sequence[PoolCriterion], excess: float, place: int
    ) -> list[list[tuple[float, float]]]:
        """For each flight pieces where J exceeds the least of those it competes with by no more."""
        found: list[list[tuple[float, float]]] = [[] for _ in self.estimates]
        for lowest, one in zip(self._least(criteria), criteria, strict=True):
            for pieces, more in zip(found, one.below(lowest + excess, place), strict=True):
                pieces.extend(more)
        return found

    def mean(self, name: str, candidate: PoolCandidate | None = None) -> OwnMean:
        """One value for all flights of a parameter that is their own."""
        pool = self.candidates[self.best] if candidate is None else candidate
        place = self._places([name])[0]
        values = np.array([theta[place] for theta in pool.theta])
        rows = [int(places[place]) for places in pool.joint.places]
        if self.differs:
            flights, variances = one_group(values.size), pool.joint.own_variance(rows)
            between = moment_between(flights, values, variances)
            found = random_effects_means(flights, values, variances, between)
            return OwnMean(float(found.value[0]), found.weights, float(found.variance[0]))
        covariance = pool.joint.classical[np.ix_(rows, rows)]
        weights = np.linalg.solve(covariance, np.ones(values.size))
        return OwnMean(float(pool.common_theta[place]), weights / weights.sum(), None)

    def _places(self, names: Sequence[str]) -> list[int]:
        parameters = [parameter.name for parameter in self.estimates[0].best.rows.parameters]
        return [parameters.index(name) for name in names]

    def _of_all(self, pool: PoolCandidate) -> _Solution:
        """Rows of all flights, their response less what a flight's own parameters differ from the mean."""
        joint, places = pool.joint, self._places(self.own)
        means = {place: self.mean(name, pool) for name, place in zip(self.own, places, strict=True)}
        theta = pool.theta[0].copy()
        theta[places] = [means[place].value for place in places]
        made = [member.rows_at(pool.at) for member in pool.separate.members]
        tests = [rows.instruments @ slopes.seen for rows, slopes in zip(made, joint.slopes, strict=True)]
        rows = Regression(
            np.concatenate(
                [
                    one.response - one.regressors @ (own - theta)
                    for one, own in zip(made, pool.theta, strict=True)
                ]
            ),
            np.concatenate([one.regressors for one in made]),
            np.concatenate(tests),
            made[0].parameters,
            _joined([one.layout for one in made]),
        )
        columns = np.concatenate([slopes.nuisance_columns for slopes in joint.slopes])
        vector = np.eye(joint.criterion.unknowns)[joint.places[0]]
        for place, mean in means.items():
            vector[place] = 0.0
            vector[place, [each[place] for each in joint.places]] = mean.weights
        return _Solution(rows, theta, columns, self._covariance(joint, vector, means))

    def _covariance(
        self, joint: PoolJoint, vector: Float[np.ndarray, "v m"], means: dict[int, OwnMean]
    ) -> JointCovariance:
        """Of the mean and of what is shared; where flights differ, with a part for that."""
        found = joint.of(vector)
        variances = np.zeros(vector.shape[0])
        for place, mean in means.items():
            if mean.differing is not None:
                variances[place] = mean.differing + joint.shared_variance(vector[place])
        if not variances.any():
            return found
        between = CovariancePart("between_flights", np.diag(variances), float(len(self.estimates) - 1))
        return JointCovariance((*found.parts, between))

    def _estimate(self, found: Sequence[_Solution]) -> Estimate:
        """Estimate whose candidates are at values that the pool has."""
        first = self.estimates[0]
        sought = tuple(one for one in self.nuisances if one.refined)
        candidates = tuple(
            self._candidate(pool, one, sought) for pool, one in zip(self.candidates, found, strict=True)
        )
        joint = (*first.best.rows.parameters, *(one.parameter for one in sought))
        return Estimate(first.method, joint, candidates, bounded=bounded_sums(self.nuisances))

    def _candidate(self, pool: PoolCandidate, found: _Solution, sought: tuple[Nuisance, ...]) -> Candidate:
        solved = self._method.solve(found.rows)
        system = solved.system
        solution = replace(
            solved.solution,
            theta=found.theta,
            residual=system.right - system.matrix @ found.theta,
            objective=pool.criterion,
        )
        known = [one for one in self.nuisances if one.searched and one.prior is not None]
        solved = replace(
            solved,
            solution=solution,
            nuisance_columns=found.nuisance_columns,
            precision=np.array([0.0 if one.prior is None else one.prior.std**-2.0 for one in sought]),
            misfits=tuple(one.misfit(pool.at) for one in known),
        )
        return Candidate(
            {one.name: pool.at[one.name] for one in self.nuisances},
            solved,
            pool.profiles,
            self.estimates[0].best.covariance_estimator,
            found.covariance,
            pool.criterion,
        )


@dataclass(frozen=True)
class _Solution:
    """Rows, and what a pool says of them."""

    rows: Regression
    theta: Float[np.ndarray, " n"]
    nuisance_columns: Float[np.ndarray, "rows c"]
    covariance: JointCovariance


def _joined(layouts: Sequence[object]) -> BinRows:
    """Rows of several flights, one after the other."""
    runs = [
        replace(run, flight=number)
        for number, layout in enumerate(layouts)
        if isinstance(layout, BinRows)
        for run in layout.runs
    ]
    return BinRows(tuple(runs))
