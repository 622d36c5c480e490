"""Rotors that the vehicle file has in another order than the flight shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.inference.verdict import Status
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import Order, observed_order
from eivor.simulation.excitation import RandomSteps
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AxisExcitations, RigidBodyFlightSpec, TorqueDisturbance

SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=8.0, seed=0)
ROTORS = SPEC.vehicle.rotors
TRUE = KnownVehicle("simulated", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins)


def ordered(*acts_as: int) -> KnownVehicle:
    """A vehicle file in which the true rotors have these numbers, below zero with the other spin."""
    positions, spins = [(0.0, 0.0)] * 4, [0] * 4
    for true, number in enumerate(acts_as):
        positions[abs(number) - 1] = TRUE.positions[true]
        spins[abs(number) - 1] = TRUE.spins[true] * (1 if number > 0 else -1)
    return replace(TRUE, positions=tuple(positions), spins=tuple(spins))


def shown(flight: PreparedFlight, vehicle: KnownVehicle) -> Order | None:
    return observed_order([flight], RigidBody(vehicle).layout)


def flown(specs: list[RigidBodyFlightSpec]) -> list[PreparedFlight]:
    logs = [flight.recording for flight in simulate_rigid_body_flights(specs)]
    return [prepare(log, RigidBody(TRUE), FlightOptions()) for log in logs]


@pytest.fixture(scope="module")
def flight() -> PreparedFlight:
    return flown([SPEC])[0]


@pytest.mark.thorough
def test_the_right_order_is_not_accused(flight):
    assert shown(flight, TRUE) is None


@pytest.mark.parametrize(
    ("acts_as", "words"),
    [
        ((1, 3, 2, 4), "Rotors 2 and 3 look exchanged: so the rotors explain"),
        ((2, 1, 3, 4), "Rotors 1 and 2 look exchanged:"),
        ((3, 2, 1, 4), "Rotors 1 and 3 look exchanged:"),
        ((1, -2, 3, 4), "Rotor 2 looks to spin the other way than the vehicle file says:"),
        ((2, 3, 1, 4), "The commands 1, 2, 3, 4 look to act as the rotors 2, 3, 1, 4 of the vehicle file:"),
    ],
)
def test_another_order_is_named(flight, acts_as, words):
    result = shown(flight, ordered(*acts_as))
    assert result is not None
    assert result.acts_as == acts_as
    assert result.sentence.startswith(words)
    assert result.explained > 0.9
    assert Order.of_numbers(result.numbers) == result


def test_signs_alone_are_left_to_the_gains(flight):
    assert shown(flight, replace(TRUE, spins=tuple(-spin for spin in TRUE.spins))) is None
    assert shown(flight, replace(TRUE, positions=tuple((x, -y) for x, y in TRUE.positions))) is None


@pytest.mark.thorough
def test_of_more_rotors_two_may_be_exchanged():
    angles = np.arange(6) * np.pi / 3.0 + 0.3
    positions = tuple((float(np.cos(angle)), float(np.sin(angle))) for angle in angles)
    rotors = replace(
        ROTORS,
        positions=tuple((0.043 * x, 0.043 * y, 0.0) for x, y in positions),
        spins=(1, -1, 1, -1, 1, -1),
    )
    spec = replace(SPEC, vehicle=replace(SPEC.vehicle, mass=0.045, rotors=rotors))
    six = KnownVehicle("six", positions, rotors.spins)
    log = next(iter(simulate_rigid_body_flights([spec]))).recording
    flight = prepare(log, RigidBody(six), FlightOptions())
    swapped = replace(
        six, positions=(*positions[:3], positions[4], positions[3], positions[5]), spins=(1, -1, 1, 1, -1, -1)
    )
    assert shown(flight, six) is None
    result = shown(flight, swapped)
    assert result is not None
    assert result.acts_as == (1, 2, 3, 5, 4, 6)


@pytest.mark.thorough
def test_a_result_refuses_and_says_which(flight):
    result = identify_flight(flight.recording, model=RigidBody(ordered(1, 3, 2, 4)))
    assert result.verdict.status is Status.REFUSED
    assert any(reason.sentence.startswith("Rotors 2 and 3 look") for reason in result.verdict.reasons)
    assert result.diagnostics["rotor_2_acts_as"] == 3.0


@pytest.mark.long
def test_no_clean_flight_is_accused():
    rough = TorqueDisturbance(*[OrnsteinUhlenbeck(4.0, 0.3)] * 3)
    kinds = (
        {"attitude": AxisExcitations()},
        {"attitude": AxisExcitations(), "torque_disturbance": rough},
        {"attitude": AxisExcitations(*[RandomSteps(0.08)] * 3), "torque_disturbance": rough},
        {"attitude": AxisExcitations(yaw=RandomSteps(0.7))},
    )
    specs = [replace(SPEC, duration=15.0, seed=seed, **kind) for seed in range(5) for kind in kinds]
    accused = wrong = 0
    for flight in flown(specs):
        accused += shown(flight, TRUE) is not None
        result = shown(flight, ordered(1, 3, 2, 4))
        wrong += result is not None and result.acts_as != (1, 3, 2, 4)
    assert (accused, wrong) == (0, 0)
