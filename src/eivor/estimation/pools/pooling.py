"""A pool of flights: its criterion at every combination of the discrete nuisances, from the flights alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.long_grids import reaching
from eivor.estimation.nested_grids import on_nested_grids
from eivor.estimation.pools.candidate import pool_candidate
from eivor.estimation.pools.criterion import PoolCriterion
from eivor.estimation.pools.member import pool_member
from eivor.estimation.pools.pooled import DIFFERENT, Pooled
from eivor.estimation.products.nodes import Nodes, nodes_of
from eivor.inference.quantiles import chi_square_tail
from eivor.models.separable import Nuisance, SeparableProblem, Values
from eivor.shapes import Float

#: Nodes of a nuisance, at least: products of lags that are close make differences that are small.
FEWEST_NODES = 33


def pooled(
    problems: Sequence[SeparableProblem],
    estimates: Sequence[Estimate],
    own: Sequence[str],
    *,
    nuisances: tuple[Nuisance, ...],
    separate: bool = False,
) -> Pooled:
    """Pool flights that share some parameters.

    Parameters
    ----------
    problems : sequence of SeparableProblem
        Of each flight, with the same nuisances.
    estimates : sequence of Estimate
        Of each, by whitened instruments.
    own : sequence of str
        Linear parameters that belong to the flight.
    nuisances : tuple of Nuisance
        Those of the pool: those of the problems, with what is known of them beforehand.
    separate : bool
        Never take flights as agreeing in what is their own.
    """
    nuisances = reaching(nuisances, [estimate.best.at for estimate in estimates])
    nodes = nodes_of(nuisances, FEWEST_NODES)
    parameters = [parameter.name for parameter in estimates[0].best.rows.parameters]
    places = tuple(parameters.index(name) for name in own)

    def made(fixed: dict[str, float], _beside: PoolCriterion | None) -> PoolCriterion:
        return _criterion(problems, estimates, places, nodes, fixed)

    criteria = on_nested_grids(nuisances, made, lambda one: one.minimum[1])
    p_value, inflation = _differences(criteria)
    candidates = tuple(pool_candidate(criterion, inflation) for criterion in criteria)
    return Pooled(tuple(estimates), tuple(own), candidates, nuisances, p_value, separate)


def _criterion(
    problems: Sequence[SeparableProblem],
    estimates: Sequence[Estimate],
    own: tuple[int, ...],
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

    def weighted(at: Sequence[Values], theta: Sequence[Float[np.ndarray, " n"]]) -> PoolCriterion:
        shared = np.median(theta, axis=0)
        members = []
        for problem, values, parameters in zip(problems, at, theta, strict=True):
            centre = shared.copy()
            centre[list(own)] = parameters[list(own)]
            members.append(pool_member(problem, nodes, {**values, **fixed}, parameters, centre))
        return PoolCriterion(tuple(members), own, nodes, known)

    first = weighted([one.at for one in alone], [one.theta for one in alone])
    nuisances = first.minimum[0]
    return weighted([nuisances] * len(alone), first.parameters(nuisances))


def _nearest(estimate: Estimate, fixed: Values) -> Candidate:
    """The candidate of a flight alone whose discrete nuisances are nearest to some values."""
    refined = {profile.nuisance.name for profile in estimate.best.profiles}
    names = [name for name in fixed if name not in refined]
    return min(estimate.candidates, key=lambda one: sum(abs(one.at[name] - fixed[name]) for name in names))


def _differences(criteria: Sequence[PoolCriterion]) -> tuple[float, float]:
    """P-value of agreement in what is shared, and by what its variance is multiplied."""
    first = criteria[0]
    together = min(replace(one, known={}).minimum[1] for one in criteria)
    alone = sum(
        min(replace(one, members=(one.members[number],), known={}).minimum[1] for one in criteria)
        for number in range(len(first.members))
    )
    degrees = (len(first.members) - 1) * (len(first.shared) + len(first.nodes.axes))
    excess = max(together - alone, 0.0)
    p_value = chi_square_tail(excess, degrees)
    return p_value, max(excess / degrees, 1.0) if p_value < DIFFERENT else 1.0
