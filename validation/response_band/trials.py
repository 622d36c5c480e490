"""Trials of the study: a simulated flight, its draws, and when their band holds the true response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

import eivor as ev
from eivor.errors import EivorError
from eivor.simulation.environment import SimulatedFlight
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from eivor.tools import Float

#: Times after a step of the command at which the climb rate is asked [s].
TIMES_S = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
#: Share of the draws that a band holds at each of them, and how many draws there are.
LEVEL, DRAWS = 0.90, 1000
SEED = 20261122
#: What is drawn for each flight, evenly: K [1/s], hover command, lag [s].
VEHICLES = {"viscous_friction": (0.2, 0.6), "hover_input": (0.3, 0.6), "actuator_lag": (0.02, 0.08)}


@dataclass(frozen=True, slots=True)
class Told:
    """What one flight says."""

    name: str  # Of its kind
    run: int  # Number of the flight
    verdict: str  # Of the flight; empty where nothing was estimated
    # At each of `TIMES_S`, whether the band holds the true climb rate: of draws at all delays that fit, and
    # at the one that fits best
    held: list[bool]
    held_at_best: list[bool]
    width: list[float]  # Half of the band over the true climb rate


def trials(name: str, settings: Mapping[str, float], position: int, runs: Sequence[int]) -> Iterator[Told]:
    """Fly some of a kind side by side: the kind's place and a run give the same flight in any company."""
    specs = [_spec(settings, position, run) for run in runs]
    for run, spec, flight in zip(runs, specs, simulate_vertical_flights(specs), strict=True):
        yield _report(name, run, spec, flight)


def _spec(settings: Mapping[str, float], position: int, run: int) -> VerticalFlightSpec:
    rng = np.random.default_rng([SEED, position, run])
    vehicle = {key: float(rng.uniform(low, high)) for key, (low, high) in VEHICLES.items()}
    return VerticalFlightSpec(
        viscous_friction=vehicle["viscous_friction"],
        hover_input=vehicle["hover_input"],
        actuator_lag=vehicle["actuator_lag"],
        delay=settings.get("delay", 0.0),
        gust_rms=settings.get("gust_rms", 0.0),
        vigour=settings.get("vigour", 1.0),
        seed=int(rng.integers(2**31)),
    )


def _report(name: str, run: int, spec: VerticalFlightSpec, flight: SimulatedFlight) -> Told:
    numbers = (spec.viscous_friction, spec.input_gain, spec.actuator_lag, spec.delay)
    (truth,) = climb_rates(*(np.array([number]) for number in numbers))
    try:
        fit = ev.identify_flight(flight.recording)
        low, high = _band(fit, "all", run)
    except EivorError:
        return Told(name, run, "", [], [], [])
    least, most = _band(fit, "best", run)
    return Told(
        name,
        run,
        fit.verdict.status.value,
        ((low <= truth) & (truth <= high)).tolist(),
        ((least <= truth) & (truth <= most)).tolist(),
        (0.5 * (high - low) / truth).tolist(),
    )


def _band(fit: ev.FlightEstimate, delays: Literal["best", "all"], seed: int) -> Float[np.ndarray, "2 times"]:
    draws, best = fit.sample(DRAWS, seed=seed, delays=delays), fit.parameters
    columns = (
        draws.get(name, np.full(DRAWS, best[name]))
        for name in ("viscous_friction", "input_gain", "actuator_lag", "delay")
    )
    ends = (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    band: Float[np.ndarray, "2 times"] = np.quantile(climb_rates(*columns), ends, axis=0)
    return band


def climb_rates(
    friction: Float[np.ndarray, " n"],
    gain: Float[np.ndarray, " n"],
    lag: Float[np.ndarray, " n"],
    delay: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n times"]:
    """Climb rate after a step of the mapped command, of which one per cent is 1 [m/s per unit]."""
    rows = friction[:, None], gain[:, None], np.maximum(lag, 1e-4)[:, None]
    since = np.maximum(np.array(TIMES_S) - delay[:, None], 0.0)
    each, steep, slow = rows
    steady = -np.expm1(-each * since) / each
    passing = (np.exp(-each * since) - np.exp(-since / slow)) / (1.0 / slow - each)
    return steep * (steady - passing)
