"""What is said of a pool as a whole: agreement of its instruments, and what stands out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from eivor.estimation.pools.pooled import Pooled
from eivor.flights.circumstances import Circumstances
from eivor.flights.diagnostics import FitDiagnostics
from eivor.flights.motion import Motion
from eivor.inference.diagnostics.over_identification import OverIdentification
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.signals.recording import Finding


def agreement(alone: Sequence[FitDiagnostics]) -> OverIdentification | None:
    """Whether the instruments agree in the flights of a pool, each by itself.

    Flights differ in trim, battery and air, which is nothing that instruments disagree about. The p-value is
    that of half the flights: with p_(k) the k-th smallest of n, k half of them, n/k p_(k) is a p-value
    however the flights hang together (Ruger 1978).
    """
    found = [one.agreement for one in alone if one.agreement is not None]
    known = sorted(one.p_value for one in found if np.isfinite(one.p_value))
    if not known:
        return None
    half = (len(known) + 1) // 2
    p_value = min(len(known) / half * known[half - 1], 1.0)
    return OverIdentification(sum(one.J for one in found), sum(one.degrees for one in found), p_value, None)


def linear_names(pool: Pooled) -> tuple[str, ...]:
    """Linear parameters of a flight, in their order."""
    return tuple(parameter.name for parameter in pool.estimates[0].best.rows.parameters)


def pool_findings(motion: Motion[Any], pool: Pooled, at: Circumstances) -> Iterator[Finding]:
    """What stands out in a pool."""
    own = " and ".join(motion.wording[name].words for name in pool.own)
    if pool.differs:
        why = f" (p {pool.own_p_value:.2g})" if not pool.separate else ""
        yield Finding(
            "flights_differ",
            f"The flights differ in {own}{why}: its value here is their mean, whose interval counts the "
            "differences. Each flight's own is listed by flight.",
        )
    if pool.inflation > 1.0:
        shared = [name for name in linear_names(pool) if name not in pool.own]
        names = [motion.wording[name].words for name in shared]
        names += [
            axis.nuisance.parameter.name.replace("_", " ") for axis in pool.candidates[0].separate.nodes.axes
        ]
        yield Finding(
            "shared_differs",
            f"The flights differ in what a vehicle keeps ({', '.join(names)}) by more than chance says "
            f"(p {pool.shared_p_value:.2g}): its intervals are {pool.inflation**0.5:.2g} times as wide.",
        )
    searched = any(one.name == ACTUATOR_LAG.name and one.refined for one in pool.nuisances)
    if at.single_frequency_hz and searched and at.given_lag is None:
        yield Finding(
            "lag_by_differences",
            f"The references of all flights have one frequency ({at.single_frequency_hz:.2g} Hz), at which "
            f"lag and {own} act alike: the lag rests on the differences of the {own} between flights.",
        )
