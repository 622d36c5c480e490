"""A pool at one combination of its discrete nuisances: where its criterion is least, and what it is there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.estimation.pools.criterion import PoolCriterion
from eivor.estimation.pools.joint import PoolJoint, member_slopes
from eivor.estimation.search import NuisanceProfile, profiles_of
from eivor.models.separable import Values
from eivor.shapes import Float


@dataclass(frozen=True)
class PoolCandidate:
    """A pool at one combination of the discrete nuisances.

    Parameters
    ----------
    separate, common : PoolCriterion
        With parameters of each flight's own, and with all shared.
    at : mapping of str to float
        Every nuisance, where `separate` is least.
    theta : tuple of ndarray, shapes (n,)
        Linear parameters of each flight there.
    joint : PoolJoint
        Linearised there.
    """

    separate: PoolCriterion
    common: PoolCriterion
    at: Values
    theta: tuple[Float[np.ndarray, " n"], ...]
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
        sought = tuple(axis.nuisance for axis in nodes.axes)
        if not sought:
            return ()
        return profiles_of(sought, [axis.values for axis in nodes.axes], self.separate.least(nodes.places))


def pool_candidate(criterion: PoolCriterion, inflation: float) -> PoolCandidate:
    """Linearise a pool where its criterion is least; what is shared has its variance multiplied."""
    nuisances, _ = criterion.minimum
    theta = criterion.parameters(nuisances)
    sought = tuple(axis.nuisance for axis in criterion.nodes.axes)
    slopes = tuple(
        member_slopes(member, sought, nuisances, own)
        for member, own in zip(criterion.members, theta, strict=True)
    )
    at = {**criterion.members[0].fixed, **nuisances}
    joint = PoolJoint(criterion, slopes, inflation)
    centre = criterion.members[0].centre
    shared = tuple(member.recentred(centre) for member in criterion.members)
    return PoolCandidate(criterion, replace(criterion, members=shared, own=()), at, tuple(theta), joint)
