"""Planned flights against flights, and the command that flies them.

    python -m validation.plan.study --kept FILE.jsonl [--size small|full] [--page docs/studies/coverage.md]

Each vehicle of the grid beside this file flies a first flight that tells too little, along small steps about
a hover. A plan is made after its result, for friction and for lag in turn, and flown with another controller,
in other gusts and with other noise. The flight's half-widths are held against those that the plan printed.
Every flight is kept in the file, and a run that was interrupted goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float

from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.planning.plan import FlightPlan
from eivor.planning.vehicle import TARGETS, FlightLimits
from eivor.report.other_results import plan
from eivor.signals.filters import actuator_state
from eivor.signals.recording import GRAVITY, Recording
from eivor.simulation.environment import (
    SensorNoise,
    Trajectory,
    TrajectoryKind,
    altitude_reference,
    gusts,
)
from eivor.simulation.vertical import (
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
    vertical_recording,
)
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, Vehicle, simulate_rotorpy_flight
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement
from validation.suite_files import versions

STEP_S = 0.01
#: Vertical gusts of every flight, the sensors' noise is that of the studies of the recipe [m/s].
GUST_RMS = 0.3
#: Gains of the second controller over those of the first: slower on climb rate, quicker on height.
OTHER_CONTROLLER = 0.75


@dataclass(frozen=True)
class FlownPlan:
    recording: Recording  # Its log
    height: Float[np.ndarray, " n"]  # Its motion [m, m/s], on the reference's own zero
    velocity: Float[np.ndarray, " n"]


class Flyer(Protocol):
    """A vehicle that flies along a reference."""

    @property
    def name(self) -> str:
        """What to call it."""

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        """Fly with the first controller's gains times `gains`."""


@dataclass(frozen=True)
class OwnVehicle:
    """A vehicle of the own simulator."""

    name: str  # What to call it
    friction: float  # K [1/s], share of full command, lag [s]
    hover_input: float
    lag_s: float

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        count = reference.position.size
        air, sensors, attitude = (
            np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(seed).spawn(3)
        )
        gust = gusts(count=count, axes=1, step_s=STEP_S, rms=GUST_RMS, correlation_s=1.0, rng=air)
        angles = gusts(count=count, axes=2, step_s=STEP_S, rms=0.05, correlation_s=1.0, rng=attitude)
        tilt = np.cos(actuator_state(angles, step_s=STEP_S, lag_s=0.15, delay_s=0.0)).prod(axis=1)
        errors = SensorNoise().errors(count, 1, sensors)
        environment = VerticalEnvironment(
            reference.position[:, None],
            reference.velocity[:, None],
            reference.acceleration[:, None],
            gust,
            tilt[:, None],
            errors["position"],
            errors["velocity"],
            errors["acceleration"],
        )
        vehicles = VerticalVehicles(
            *(np.array([value]) for value in (self.friction, GRAVITY / self.hover_input**2, self.lag_s, 0.0))
        )
        velocity = gains * min(0.35 / (self.lag_s + STEP_S / 2.0), 5.0)
        controller = AltitudeController(0.3 * velocity / gains**2, velocity, 0.05 * velocity**2)
        motion = simulate_vertical(vehicles, environment, step_s=STEP_S, controller=controller)
        recording = vertical_recording(f"{self.name}, seed {seed}", "vertical", environment, motion, 0)
        return FlownPlan(recording, motion.position[:, 0], motion.velocity[:, 0])


@dataclass(frozen=True)
class RotorpyVehicle:
    vehicle: Vehicle  # Which one

    @property
    def name(self) -> str:
        return f"RotorPy {self.vehicle}"

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        duration = reference.position.size * STEP_S
        spec = RotorpyFlightSpec(self.vehicle, gust_rms=GUST_RMS, seed=seed, duration=duration)
        flight = simulate_rotorpy_flight(spec, reference, gains)
        height, velocity = (
            _quiet(flight.recording.channels[f"{what}_z"].values) for what in ("position", "velocity")
        )
        return FlownPlan(flight.recording, height, velocity)


def _quiet(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values without their noise: means over a tenth of a second."""
    return np.convolve(np.pad(values, 5, mode="edge"), np.ones(11) / 11.0, mode="valid")


OWN = (
    OwnVehicle("light, quick", 0.6, 0.35, 0.02),
    OwnVehicle("usual", 0.3, 0.5, 0.045),
    OwnVehicle("heavy, slow", 0.2, 0.6, 0.09),
)
ROTORPY = tuple(RotorpyVehicle(vehicle) for vehicle in Vehicle)
#: Every vehicle by its name.
_ALL: tuple[Flyer, ...] = (*OWN, *ROTORPY)
VEHICLES: Mapping[str, Flyer] = {vehicle.name: vehicle for vehicle in _ALL}


PLANNED_FOR = ("friction", "lag")
FIRST_S = 40.0
#: Flights of a plan.
FLOWN_EACH = 2
LIMITS = FlightLimits()


class Planned(GridStruct, frozen=True):
    """How often a vehicle flies each of its plans, by the size of the study."""

    name: str
    small: int
    full: int

    def __post_init__(self) -> None:
        if self.name not in VEHICLES:
            raise ValueError(f"expected one of {', '.join(VEHICLES)}; received {self.name!r}")


class Grid(GridStruct, frozen=True):
    seed: int
    vehicle: list[Planned]


@dataclass(frozen=True)
class Outcome:
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
        return self.reached / self.predicted


def outcomes(vehicle: Flyer, seed: int, keys: Sequence[tuple[str, str, int]]) -> Iterator[list[Outcome]]:
    """Plans after first flights, and those of their flights that are named: so many follow each."""
    for first in dict.fromkeys(number // FLOWN_EACH for *_, number in keys):
        rng = np.random.default_rng(seed + first)
        reference = altitude_reference(
            TrajectoryKind.HOVER_STEPS, count=round(FIRST_S / STEP_S), step_s=STEP_S, rng=rng
        )
        flight = identify_flight(vehicle.fly(reference, 1000 + seed + first, gains=1.0).recording)
        numbers = [(target, number) for _, target, number in keys if number // FLOWN_EACH == first]
        for target in dict.fromkeys(target for target, _ in numbers):
            made = plan(flight, target=target, limits=LIMITS, seed=seed + first)
            assert isinstance(made, FlightPlan)
            for number in (number for other, number in numbers if other == target):
                yield [flown_outcome(vehicle, made, number, seed)]


def flown_outcome(vehicle: Flyer, made: FlightPlan, number: int, seed: int) -> Outcome:
    reference = Trajectory(made.shape.offset, made.velocity, made.acceleration)
    flight = vehicle.fly(reference, 2000 + 100 * seed + number, gains=OTHER_CONTROLLER)
    result = identify_flight(flight.recording)
    target = TARGETS[made.target]
    quantity = result.quantities[target.quantity]
    width = quantity.half_width / (abs(quantity.value) if target.relative else 1.0)
    half_height = 0.5 * (made.limits.height_m[1] - made.limits.height_m[0])
    kept = np.abs(flight.height).max() <= half_height and np.abs(flight.velocity).max() <= made.limits.speed
    return Outcome(
        vehicle.name,
        made.target,
        number,
        made.shape.kind,
        made.predicted[made.target].half_width,
        target.scale * width,
        quantity.verdict is Status.IDENTIFIED,
        bool(kept),
    )


#: Asked of the median ratio of reached to predicted: within these of one, by what is planned for.
RATIOS = {"friction": (0.87, 1.15), "lag": (0.87, 1.15)}
#: Asked: the share of flights in which what was planned for is identified.
IDENTIFIED = 0.9
HEADER = ("vehicle", "planned for", "flights", "predicted", "reached", "ratio", "identified", "within limits")


def groups(grid: Grid, size: str, _kept: Path) -> Iterator[Group[tuple[str, str, int], Outcome]]:
    for entry in grid.vehicle:
        numbers = range(getattr(entry, size))
        keys = [(entry.name, target, number) for target in PLANNED_FOR for number in numbers]
        yield keys, partial(outcomes, VEHICLES[entry.name], grid.seed)


def requirements(run: KeptRun[Grid, Outcome]) -> Iterator[Requirement]:
    for target, bounds in RATIOS.items():
        median = float(np.median([item.ratio for item in run.lines if item.target == target]))
        what = f"median of reached over predicted, {TARGETS[target].words}"
        yield Requirement.within(what, median, bounds, ".2f")
    count = len(run.lines)
    reported, kept = (sum(getattr(item, name) for item in run.lines) for name in ("identified", "kept"))
    yield Requirement(
        "what was planned for is identified",
        f"at least {IDENTIFIED:g}",
        f"{reported} of {count}",
        reported >= IDENTIFIED * count,
    )
    yield Requirement("no limit is left", "every flight", f"{kept} of {count}", kept == count)


def tables(run: KeptRun[Grid, Outcome]) -> Iterator[str]:
    """For each vehicle and target medians of both half-widths, their ratio, and shares."""
    yield f" with {versions()}: {len(run.lines)} planned flights."
    rows = [
        _row(
            vehicle, target, [item for item in run.lines if (item.vehicle, item.target) == (vehicle, target)]
        )
        for vehicle, target in dict.fromkeys((item.vehicle, item.target) for item in run.lines)
    ]
    rows += [
        _row("**all**", target, [item for item in run.lines if item.target == target])
        for target in PLANNED_FOR
    ]
    yield markdown(HEADER, rows)


def _row(vehicle: str, target: str, lines: Sequence[Outcome]) -> tuple[str, ...]:
    unit = TARGETS[target].unit
    predicted, reached, ratio = (
        float(np.median([getattr(item, name) for item in lines]))
        for name in ("predicted", "reached", "ratio")
    )
    return (
        vehicle,
        TARGETS[target].words,
        str(len(lines)),
        f"{predicted:.2g} {unit}",
        f"{reached:.2g} {unit}",
        f"{ratio:.2f}",
        f"{sum(item.identified for item in lines)} of {len(lines)}",
        f"{sum(item.kept for item in lines)} of {len(lines)}",
    )


STUDY = KeptStudy(
    "plan.study",
    __doc__,
    "planned flights",
    Grid,
    Outcome,
    ("vehicle", "target", "number"),
    groups,
    requirements,
    tables,
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(main())
