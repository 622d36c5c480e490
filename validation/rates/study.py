"""Effectiveness and lag from setpoints, against the truth, and the command that finds out.

    python -m validation.rates.study --size full --kept FILE.jsonl [--page docs/studies/rigid-body.md]

Flights are kept as they are done; a run that was interrupted goes on there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from eivor.inference.verdict import Status
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.lab.study import Share
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import RandomSteps
from eivor.simulation.rigid_body import (
    AxisExcitations,
    Logged,
    RigidBodyFlight,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
    simulate_rigid_body_flights,
)
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement, may_be_within, share_text

CONTROLLER_HZ, GYROSCOPE_HZ = 400.0, 200.0
#: Of the gyroscope [rad/s], and of the gusts' angular acceleration about each axis [rad/s^2], correlated [s].
NOISE, GUSTS, GUST_S = 0.05, (3.0, 3.0, 1.0), 0.3


def _vehicle(mass: float, arm: float, inertia: tuple[float, float, float], lag: float) -> Vehicle:
    """A quadrotor X whose rotors lift some four times its weight, with a delay of 5 ms."""
    rotors = Rotors(
        positions=((arm, arm, 0.0), (arm, -arm, 0.0), (-arm, -arm, 0.0), (-arm, arm, 0.0)),
        spins=(1, -1, 1, -1),
        highest_speed=900.0,
        thrust_quadratic=1.2e-5 * mass,
        torque_ratio=0.016,
        lag_up=lag,
        lag_down=lag,
        delay=0.005,
    )
    return Vehicle(mass, inertia, rotors, BodyDrag(quadratic=(0.01, 0.01, 0.02)))


#: Effectiveness of roll and pitch 250, 120 and 60 rad/s^2 or so.
VEHICLES = {
    "light, quick": _vehicle(0.5, 0.09, (0.0018, 0.0021, 0.0035), 0.02),
    "usual": _vehicle(1.2, 0.16, (0.0155, 0.018, 0.03), 0.035),
    "heavy, slow": _vehicle(3.0, 0.25, (0.12, 0.14, 0.23), 0.06),
}


class Condition(GridStruct, frozen=True):
    """How a cell of the study is flown and logged."""

    name: str  # In words
    steps: float  # Attitude steps of roll and pitch [rad]; none where zero
    setpoint_hz: float  # At which setpoints are logged [Hz]
    judged: Literal["50 Hz", "250 Hz", "small"]  # Its requirements; small ones may be refused


def flight_of(vehicle: str, condition: Condition, seconds: float, seed: int) -> RigidBodyFlightSpec:
    flight = VEHICLES[vehicle]
    steps = RandomSteps(condition.steps, 0.7, 1.8) if condition.steps else None
    return RigidBodyFlightSpec(
        flight,
        rate_hz=CONTROLLER_HZ,
        duration=seconds,
        trajectory=TrajectoryKind.HOVER,
        attitude=AxisExcitations(steps, steps),
        controller=FlightController(
            rate_hz=CONTROLLER_HZ, attitude_hz=CONTROLLER_HZ, derivative_share=0.5, hold=0.2
        ),
        torque_disturbance=TorqueDisturbance(*(OrnsteinUhlenbeck(gust, GUST_S) for gust in GUSTS)),
        sensors=Sensors(angular_rate=Sensor(WhiteNoise(NOISE), rate_hz=GYROSCOPE_HZ)),
        logged=Logged(setpoint_hz=condition.setpoint_hz, reference_hz=50.0),
        seed=seed,
    )


class Grid(GridStruct, frozen=True):
    name: str
    seed: int  # Of the first flight of each cell
    seconds: float  # Of a flight [s]
    flights: Mapping[str, int]  # Of each vehicle and condition, by the size of the study
    conditions: tuple[Condition, ...]  # How


INSTRUMENTS, LEAST_SQUARES = "reference_iv", "least_squares"
EFFECTIVENESS = ("roll_effectiveness", "pitch_effectiveness")
LAG = "effective_lag"


@dataclass(frozen=True, slots=True)
class Turned:
    """What one identification says of one quantity."""

    vehicle: str  # Names of the cell
    condition: str
    number: int  # Of the flight in its cell
    method: str  # What was asked
    quantity: str
    error: float  # Value less truth: of an effectiveness as a share of the truth, of the lag in seconds
    below: float  # Ends of the interval less the truth, likewise
    above: float
    accepted: bool  # The quantity's verdict is identified

    @property
    def held(self) -> bool:
        return self.below <= 0.0 <= self.above


def strength_of(flight: RigidBodyFlight, vehicle: str, condition: Condition, number: int) -> Iterator[Turned]:
    rotors = VEHICLES[vehicle].rotors
    truth = {
        **dict(zip(EFFECTIVENESS, flight.truth.control_effectiveness[:2], strict=True)),
        LAG: rotors.lag_up + rotors.delay,
    }
    for method in (INSTRUMENTS, LEAST_SQUARES) if condition.steps else (INSTRUMENTS,):
        result = identify_flight(flight.recording, model="rates", method=method)
        for name, true in truth.items():
            quantity, unit = result.quantities[name], 1.0 if name == LAG else true
            low, high = quantity.interval
            yield Turned(
                vehicle,
                condition.name,
                number,
                method,
                name,
                (quantity.value - true) / unit,
                (low - true) / unit,
                (high - true) / unit,
                quantity.verdict is Status.IDENTIFIED,
            )


def groups(grid: Grid, size: str, _kept: Path) -> Iterator[Group[tuple[str, str, int], Turned]]:
    """Flights of all cells with one number, side by side."""
    conditions = {condition.name: condition for condition in grid.conditions}

    def made(keys: list[tuple[str, str, int]]) -> Iterator[list[Turned]]:
        specs = [
            flight_of(vehicle, conditions[name], grid.seconds, grid.seed + number)
            for vehicle, name, number in keys
        ]
        for (vehicle, name, number), flight in zip(keys, simulate_rigid_body_flights(specs), strict=True):
            yield list(strength_of(flight, vehicle, conditions[name], number))

    for number in range(grid.flights[size]):
        yield [(vehicle, name, number) for name in conditions for vehicle in VEHICLES], made


#: Largest median of the size of errors: of effectiveness (a share), of the lag [s].
LARGEST = {"50 Hz": (0.08, 0.006), "250 Hz": (0.02, 0.002)}
#: Coverage of what is accepted, and the confidence with which a share of few is compared with it.
COVERAGE, CHANCE_LEVEL = (0.90, 0.98), 0.999


def requirements(run: KeptRun[Grid, Turned]) -> Iterator[Requirement]:
    conditions = run.grid.conditions
    for judged, (share, seconds) in LARGEST.items():
        names = {condition.name for condition in conditions if condition.judged == judged}
        selected = [item for item in run.lines if item.condition in names and item.method == INSTRUMENTS]
        effect, lag = (
            float(np.median(np.abs(_errors(selected, item) or [np.nan]))) for item in (EFFECTIVENESS, (LAG,))
        )
        yield Requirement(f"effectiveness, {judged}", f"<= {share:.0%}", f"{effect:.1%}", effect <= share)
        yield Requirement(
            f"lag, {judged}", f"<= {1e3 * seconds:.0f} ms", f"{1e3 * lag:.1f} ms", lag <= seconds
        )
    accepted = [item for item in run.lines if item.accepted]
    large = {condition.name for condition in conditions if condition.judged != "small"}
    held = [item.held for item in accepted if item.condition in large]
    covered, (low, high) = Share(sum(held), len(held)), COVERAGE
    met = may_be_within(covered.value, covered.count, COVERAGE, CHANCE_LEVEL)
    yield Requirement("coverage of what is accepted", f"{low:.2f} to {high:.2f}", share_text(covered, 2), met)
    missed = sum(not item.held for item in accepted if item.condition not in large)
    yield Requirement("small steps and hover: accepted intervals that miss", "0", f"{missed}", missed == 0)


def tables(run: KeptRun[Grid, Turned]) -> Iterator[str]:
    flights = len({(item.vehicle, item.condition, item.number) for item in run.lines})
    yield f" of {flights} flights of {run.grid.seconds:g} s."
    header = ("flights", "effectiveness", "lag", "accepted", "intervals that hold", "least squares")
    rows = []
    for condition, vehicle in dict.fromkeys((item.condition, item.vehicle) for item in run.lines):
        selected = [item for item in run.lines if (item.condition, item.vehicle) == (condition, vehicle)]
        rows.append((f"{condition}: {vehicle}", *_cells(selected)))
    yield markdown(header, rows)


def _cells(lines: Sequence[Turned]) -> tuple[str, ...]:
    selected = [item for item in lines if item.method == INSTRUMENTS]
    plain = [item for item in lines if item.method == LEAST_SQUARES]
    accepted = [item for item in selected if item.accepted]
    biases = (
        _of(plain, EFFECTIVENESS, lambda bias, _: f"{bias:+.0%}"),
        _of(plain, (LAG,), lambda bias, _: f"{1e3 * bias:+.0f} ms"),
    )
    return (
        _of(selected, EFFECTIVENESS, lambda bias, size: f"{bias:+.1%} ({size:.1%})"),
        _of(selected, (LAG,), lambda bias, size: f"{1e3 * bias:+.1f} ({1e3 * size:.1f}) ms"),
        f"{len(accepted)} of {len(selected)}",
        share_text(Share(sum(item.held for item in accepted), len(accepted)), 2) if accepted else "-",
        ", ".join(biases),
    )


def _of(lines: Sequence[Turned], names: Sequence[str], words: Callable[[float, float], str]) -> str:
    """Median error, and median size of it, of what was told at all."""
    errors = _errors(lines, names)
    return words(float(np.median(errors)), float(np.median(np.abs(errors)))) if errors else "-"


def _errors(lines: Sequence[Turned], names: Sequence[str]) -> list[float]:
    return [item.error for item in lines if item.quantity in names and np.isfinite(item.error)]


STUDY = KeptStudy(
    "rates.study",
    __doc__,
    "rates",
    Grid,
    Turned,
    ("vehicle", "condition", "number"),
    groups,
    requirements,
    tables,
    "median size of errors, and coverage",
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(main())
