"""Bootstrap of flights: a pool estimated again from flights drawn with replacement.

Whole flights are drawn, so that whatever is alike within a flight (gusts, a bias, the shape of its
reference) stays together, and nothing is assumed of it. In each replicate every nuisance is searched again,
see `eivor.estimation.pool_replicates`; the motion derives its quantities from what was found and from sums
over the samples of the flights that were drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import EivorError, UsageError
from eivor.estimation.pool_replicates import PoolFlights, Replicate, pool_flights
from eivor.flights.drawn import Drawn
from eivor.flights.motion import Motion
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.resampling.replicates import Bootstrap, check_draws
from eivor.models.separable import SeparableProblem
from eivor.shapes import Float

#: Replicates that are made when their number is not named.
RUNS = 999


def bootstrap_flights(
    fit: FlightEstimate, *, runs: int = RUNS, seed: int | np.random.Generator = 0
) -> Bootstrap:
    """Bootstrap the estimate of a pool of flights by drawing whole flights.

    Parameters
    ----------
    fit : FlightEstimate
        Of several flights, from `identify_flight` with its default method. Of any motion.
    runs : int
        Replicates to make.
    seed : int or numpy.random.Generator
        The same seed gives the same replicates.

    Returns
    -------
    Bootstrap
        Replicates of the linear parameters, of the nuisances that were searched for, and of what the motion
        derives from them. Take the expanded intervals, the default: with ten flights the percentiles
        themselves are too narrow by a sixth.

    Raises
    ------
    UsageError
        Without an estimate by whitened instruments of two flights or more.

    Notes
    -----
    Some seconds for a pool of ten flights of a minute; a replicate takes a few milliseconds, whatever the
    flights' length.
    """
    checks.kind(
        "fit", fit, FlightEstimate, "a pool's estimate", "Make one by ev.identify_flight(recordings)."
    )
    check_draws(runs, seed)
    found = _fitted(fit)
    pool = pool_flights(found.problem, found.estimate)
    again = _Again(fit.motion, found.problem, pool, _sums(fit.motion, found.problem, pool))
    whole = again.quantities(pool.whole, np.ones(len(pool.flights)))
    random = np.random.default_rng(seed)
    made = np.array(list(again.replicates(random, runs))).reshape(-1, len(whole))
    return Bootstrap(
        tuple(whole),
        _units(fit.motion, found, tuple(whole)),
        np.array(list(whole.values())),
        made,
        runs - made.shape[0],
        len(pool.flights),
        float("nan"),
        None if isinstance(seed, np.random.Generator) else seed,
    )


def _fitted(result: FlightEstimate) -> Fit:
    if result.fit is None:
        raise UsageError(
            "a pool with an estimate", "one without", "See its verdict for what the flights lack."
        )
    return result.fit


#: A motion's sums by name, of each flight at each node of a candidate.
Sums = Mapping[str, Float[np.ndarray, "F T"]]


def _sums(motion: Motion[Any], problem: SeparableProblem, pool: PoolFlights) -> tuple[Sums, ...]:
    """Sums that the motion needs, for each candidate."""
    flights = list(pool.flights)
    found: list[Sums] = []
    for candidate in pool.candidates:
        at_nodes = [motion.flight_sums(problem, at) for at in candidate.points]
        found.append(
            {name: np.stack([sums[name][flights] for sums in at_nodes], axis=1) for name in at_nodes[0]}
        )
    return tuple(found)


@dataclass(frozen=True)
class _Again:
    """How a draw of flights becomes quantities.

    Parameters
    ----------
    motion : Motion
        Which derives them.
    problem : SeparableProblem
        The pool's.
    pool : PoolFlights
        Its flights.
    sums : tuple
        The motion's, for each candidate.
    """

    motion: Motion[Any]
    problem: SeparableProblem
    pool: PoolFlights
    sums: tuple[Sums, ...]

    def replicates(self, random: np.random.Generator, runs: int) -> Iterator[list[float]]:
        """Quantities of those runs that give an estimate."""
        for _ in range(runs):
            try:
                found, times = self.pool.replicate(random)
                quantities = self.quantities(found, times)
            except (EivorError, np.linalg.LinAlgError):
                continue
            yield list(quantities.values())

    def quantities(self, found: Replicate, times: Float[np.ndarray, " F"]) -> Mapping[str, float]:
        """What the motion makes of a replicate, and of the sums over its flights."""
        names = [parameter.name for parameter in self.pool.parameters]
        sums = {
            name: float(times @ values @ found.weights) for name, values in self.sums[found.candidate].items()
        }
        parameters = dict(zip(names, found.theta.tolist(), strict=True))
        return self.motion.resampled(self.problem, Drawn(parameters, found.at, sums))


def _units(motion: Motion[Any], found: Fit, names: tuple[str, ...]) -> tuple[str, ...]:
    """Unit of each quantity: that of the parameter, or of the motion's table."""
    nuisances = [nuisance.parameter for nuisance in found.problem.nuisances]
    known = {one.name: one.unit for one in (*nuisances, *found.estimate.joint_parameters)}
    return tuple(known[name] if name in known else motion.wording[name].unit for name in names)
