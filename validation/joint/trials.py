"""Trials of the study: one flight, identified by the rigid body and by the vertical motion in three ways."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eivor.errors import EivorError
from eivor.flights.identify import identified
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.models.separable import Prior
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.motions.vertical.motion import Vertical
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from validation.flight_recipe.grid import FlightCase, FlightGrid
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec
from validation.joint.flights import flight_of, known
from validation.joint.truth import effective_along, effective_vertical, used_steps
from validation.kept_study import keep, kept_lines

#: Standard error of a lag that is given [s].
GIVEN_STD_S = 0.003
#: Distinguishes the stream of given lags from those of the flight.
GIVEN_KEY = 77
#: Flights that are simulated side by side.
TOGETHER = 9
JOINT, GIVEN, TURNING, ALONE = "rigid body", "lag given", "lag from turning", "alone"
#: Name of K in the results of either motion.
FRICTION = "viscous_friction"
#: Verdict of a flight whose vehicle was lost, or that could not be identified at all.
LOST, FAILED = "lost", "failed"


@dataclass(frozen=True, slots=True)
class Told:
    """What one identification of one flight says of K."""

    flight: str  # Name of the flight, and how it was identified
    formula: str
    verdict: str  # K's own
    of_flight: str  # The overall one
    # Effective value over the samples that were used, estimate and interval [1/s]; zeros without an estimate
    truth: float = 0.0
    value: float = 0.0
    low: float = 0.0
    high: float = 0.0

    @property
    def accepted(self) -> bool:
        """K is identified."""
        return self.verdict == Status.IDENTIFIED.value

    @property
    def held(self) -> bool:
        """The interval holds the truth."""
        return self.low <= self.truth <= self.high

    @property
    def length(self) -> float:
        """Of the interval [1/s]; infinite without an estimate."""
        return self.high - self.low if self.verdict not in (LOST, FAILED) else float("inf")


def formulas(
    flight: RigidBodyFlight, vehicle: Vehicle, seed: int
) -> Mapping[str, Callable[[], FlightEstimate]]:
    """Each way to identify a flight."""
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(GIVEN_KEY,))))
    reported = vehicle.rotors.lag_up + vehicle.rotors.delay + GIVEN_STD_S * float(stream.standard_normal())
    lag = Prior(max(reported, 0.1 * GIVEN_STD_S), GIVEN_STD_S)
    log = flight.recording
    return {
        JOINT: lambda: identify_flight(log, model=RigidBody(known(vehicle))),
        GIVEN: lambda: identify_flight(log, lag=lag),
        TURNING: lambda: identify_flight(log),
        ALONE: lambda: identified([log], Vertical(), FlightOptions(), [None]),
    }


def strength_of(case: FlightCase, flight: RigidBodyFlight, vehicle: Vehicle) -> list[Told]:
    """What each way says of a flight."""
    if not flight.flew:
        return [Told(case.name, formula, LOST, LOST) for formula in (JOINT, GIVEN, TURNING, ALONE)]
    results = []
    for formula, identify in formulas(flight, vehicle, case.spec.seed).items():
        try:
            result = identify()
        except EivorError:
            results.append(Told(case.name, formula, FAILED, FAILED))
            continue
        effective = effective_along if formula == JOINT else effective_vertical
        friction = result.quantities[FRICTION]
        results.append(
            Told(
                case.name,
                formula,
                friction.verdict.value,
                result.verdict.status.value,
                effective(flight, vehicle, used_steps(flight, result.prepared[0])),
                friction.value,
                *friction.interval,
            )
        )
    return results


def run(grid: FlightGrid, kept: Path) -> list[Told]:
    """Run what is left of the study, and return all that its file has."""
    result = read_told(kept)
    done = {item.flight for item in result}
    left = [case for case in grid.cases if case.name not in done]
    for first in range(0, len(left), TOGETHER):
        cases = left[first : first + TOGETHER]
        specs = [flight_of(case.spec) for case in cases if isinstance(case.spec, RotorpyFlightSpec)]
        flights = simulate_rigid_body_flights(specs)
        for case, spec, flight in zip(cases, specs, flights, strict=True):
            reported = strength_of(case, flight, spec.vehicle)
            result += reported
            keep(kept, reported)
    return result


def read_told(path: Path) -> list[Told]:
    """What a file of the study has."""
    return kept_lines(path, Told)
