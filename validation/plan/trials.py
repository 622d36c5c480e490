"""Planned flights of a vehicle: a first that tells too little, a plan after it, and what flights reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.planning.plan import FlightPlan
from eivor.planning.vehicle import TARGETS, FlightLimits
from eivor.report.other_results import plan
from eivor.simulation.environment import Trajectory, TrajectoryKind, altitude_reference
from validation.plan.flights import OTHER_CONTROLLER, STEP_S, Flyer

PLANNED_FOR = ("friction", "lag")
FIRST_S = 40.0
LIMITS = FlightLimits()


@dataclass(frozen=True)
class Outcome:
    """One planned flight."""

    vehicle: str  # Who flew, and what for
    target: str
    number: int  # Which of the plan's flights
    shape: str  # Kind of the setpoint
    predicted: float  # Half-width of the target in its unit: as the plan printed it, and as the flight has it
    reached: float
    identified: bool  # The target is
    kept: bool  # The vehicle stayed within the limits

    @property
    def ratio(self) -> float:
        """Reached over predicted."""
        return self.reached / self.predicted


def outcomes(vehicle: Flyer, requested: Sequence[tuple[str, int]], seed: int) -> Iterator[Outcome]:
    """Plans after one first flight, and those of their flights that are asked for, as (target, number)."""
    if not requested:
        return
    rng = np.random.default_rng(seed)
    first = altitude_reference(
        TrajectoryKind.HOVER_STEPS, count=round(FIRST_S / STEP_S), step_s=STEP_S, rng=rng
    )
    flight = identify_flight(vehicle.fly(first, 1000 + seed, gains=1.0).recording)
    for target in dict.fromkeys(target for target, _ in requested):
        made = plan(flight, target=target, limits=LIMITS, seed=seed)
        for number in (number for other, number in requested if other == target):
            yield flown_outcome(vehicle, made, number, seed)


def flown_outcome(vehicle: Flyer, made: FlightPlan, number: int, seed: int) -> Outcome:
    """The plan, flown once with the other controller."""
    reference = Trajectory(made.shape.offset, made.velocity, made.acceleration)
    flight = vehicle.fly(reference, 2000 + 100 * seed + number, gains=OTHER_CONTROLLER)
    result = identify_flight(flight.recording)
    requested = TARGETS[made.target]
    quantity = result.quantities[requested.quantity]
    width = quantity.half_width / (abs(quantity.value) if requested.relative else 1.0)
    half_height = 0.5 * (made.limits.height_m[1] - made.limits.height_m[0])
    kept = np.abs(flight.height).max() <= half_height and np.abs(flight.velocity).max() <= made.limits.speed
    return Outcome(
        vehicle.name,
        made.target,
        number,
        made.shape.kind,
        made.predicted[made.target].half_width,
        requested.scale * width,
        quantity.verdict is Status.IDENTIFIED,
        bool(kept),
    )
