"""What drag off the centre of mass and spinning rotors turn, against the simulated rotors and on flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import NoInstruments
from eivor.motions.rigid_body.dynamics import body_derivative, coefficients_of, effective_parameters, wrench
from eivor.motions.rigid_body.motion import SETTLED_S, RigidBody
from eivor.motions.rigid_body.regression import drag_moments, gyroscopic_moment
from eivor.motions.rigid_body.vehicle import DRAG_MOMENT, GYROSCOPIC_MOMENT, KnownVehicle, Vehicle
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import Sensors

SPEC = shipped_rigid_body_flight("crazyflie")
STILL, HOVER = (0.0, 0.0, 0.0), SPEC.vehicle.hover_speed
INERTIA_OF_A_ROTOR, HEIGHT_M = 2e-8, 0.006


def moved(by: tuple[float, float, float], vehicle: Vehicle = SPEC.vehicle) -> Vehicle:
    """Vehicle whose rotors all stand elsewhere from its centre of mass."""
    positions = tuple(tuple(np.add(position, by).tolist()) for position in vehicle.rotors.positions)
    return replace(vehicle, rotors=replace(vehicle.rotors, positions=positions))


@pytest.mark.parametrize("by", [(0.01, 0.0, 0.0), (0.0, -0.02, 0.0), (0.0, 0.0, 0.015)])
def test_drag_beside_the_centre_of_mass_turns_by_the_velocities_along_the_other_axes(by):
    """The simulator's torques at equal speeds, velocity by velocity."""
    coefficients = coefficients_of(moved(by))
    speeds = [HOVER] * 4
    resting = np.array(wrench(coefficients, STILL, STILL, speeds)[1])
    of_velocity = np.column_stack(
        [
            np.array(wrench(coefficients, tuple(item), STILL, speeds)[1]) - resting
            for item in np.eye(3).tolist()
        ]
    )
    assert np.abs(of_velocity).max() > 1e-6
    velocity = np.array([1.3, -0.7, 0.4])
    torque = np.array(wrench(coefficients, tuple(velocity.tolist()), STILL, speeds)[1]) - resting
    for axis in range(3):
        others = [along for along in range(3) if along != axis]
        columns = drag_moments(axis, velocity[:, None])[:, 0]
        assert of_velocity[axis, others] @ columns == pytest.approx(torque[axis], abs=1e-12)


def test_rotors_that_spin_turn_as_in_the_simulator():
    spinning = replace(SPEC.vehicle, rotors=replace(SPEC.vehicle.rotors, inertia=INERTIA_OF_A_ROTOR))
    rates, speeds = (0.4, -0.9, 0.0), [1500.0, 1600.0, 1700.0, 1550.0]
    body = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, *rates]
    turned = [
        np.array(body_derivative(coefficients_of(item), body, speeds, [0.0] * 4, STILL, STILL)[10:12])
        for item in (spinning, SPEC.vehicle)
    ]
    spin = np.array([np.dot(speeds, SPEC.vehicle.rotors.spins)])
    for axis in (0, 1):
        expected = (
            INERTIA_OF_A_ROTOR
            / SPEC.vehicle.inertia[axis]
            * gyroscopic_moment(axis, np.array(rates)[:, None], spin)
        )
        assert turned[0][axis] - turned[1][axis] == pytest.approx(expected[0], rel=1e-9)
        assert abs(expected[0]) > 1e-3


def test_damping_of_rotors_above_the_centre_of_mass_is_told_with_their_height():
    high = moved((0.0, 0.0, 0.02))
    damping = effective_parameters(high).rate_damping
    for axis in (0, 1):
        slopes = []
        for rate in (0.0, 1.0):
            rates = tuple(rate * (index == axis) for index in range(3))
            body = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, *rates]
            slopes.append(
                body_derivative(coefficients_of(high), body, [HOVER] * 4, [0.0] * 4, STILL, STILL)[10 + axis]
            )
        assert slopes[0] - slopes[1] == pytest.approx(damping[axis], rel=1e-9)


def known(vehicle: Vehicle) -> KnownVehicle:
    """What its file says, which has neither a height nor where the centre of mass lies."""
    return KnownVehicle(
        "simulated", tuple((x, y) for x, y, _ in SPEC.vehicle.rotors.positions), vehicle.rotors.spins
    )


def test_turning_has_columns_for_it_where_velocity_is_logged():
    (flight,) = simulate_rigid_body_flights([replace(SPEC, duration=4.0, seed=5)])
    motion = RigidBody(known(SPEC.vehicle))
    without = {
        name: channel
        for name, channel in flight.recording.channels.items()
        if not name.startswith("velocity")
    }
    for log, there in ((flight.recording, True), (replace(flight.recording, channels=without), False)):
        problem = motion.problem((prepare(log, motion, FlightOptions()),), NoInstruments())
        names = {parameter.name for parameter in problem.parameters}
        assert {item.name for item in GYROSCOPIC_MOMENT} <= names
        assert all((item.name in names) == there for pair in DRAG_MOMENT for item in pair)


def test_the_equations_hold_for_rotors_that_spin_above_and_beside_the_centre_of_mass():
    """At the true lag, by least squares in time; without these columns the residual is many times larger."""
    rotors = replace(SPEC.vehicle.rotors, inertia=INERTIA_OF_A_ROTOR)
    vehicle = moved((0.004, -0.003, HEIGHT_M), replace(SPEC.vehicle, rotors=rotors))
    record = replace(SPEC, vehicle=vehicle, sensors=Sensors.exact(), duration=10.0, seed=5)
    (flight,) = simulate_rigid_body_flights([record])
    motion = RigidBody(known(vehicle))
    problem = motion.problem((prepare(flight.recording, motion, FlightOptions()),), NoInstruments())
    truth, drag = effective_parameters(vehicle), 4.0 * vehicle.rotors.drag * HOVER
    first, second, third = vehicle.inertia
    expected = (
        {"roll_by_spin": INERTIA_OF_A_ROTOR / first, "roll_by_drag_y": HEIGHT_M * drag / first},
        {"pitch_by_spin": INERTIA_OF_A_ROTOR / second, "pitch_by_drag_x": -HEIGHT_M * drag / second},
        {"yaw_by_drag_x": -0.003 * drag / third, "yaw_by_drag_y": -0.004 * drag / third},
    )
    neighbours = {
        item.name for item in (*GYROSCOPIC_MOMENT, *(item for pair in DRAG_MOMENT for item in pair))
    }
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        result, left = in_time(problem, axis, set())
        assert result[f"{name}_coupling"] == pytest.approx(truth.gyroscopic_ratios[axis], abs=0.015)
        assert result[f"{name}_gain"] == pytest.approx(truth.torque_gains[axis], rel=2e-3)
        for parameter, value in expected[axis].items():
            assert result[parameter] == pytest.approx(value, rel=0.1)
        assert in_time(problem, axis, neighbours)[1] > 8.0 * left


def in_time(problem: LaggedRuns, axis: int, without: set[str]) -> tuple[dict[str, float], float]:
    """Least squares of an equation at the true lag over what counts of a flight, and what it leaves."""
    item = problem.columns[axis]
    names = [parameter.name for parameter in problem.parameters]
    fixed = item.fixed.shape[1]
    columns = dict(zip(names[:fixed], item.fixed.T, strict=True))
    moving = item.moving({"actuator_lag": SPEC.vehicle.rotors.lag_up, "delay": 0.0})
    columns |= zip((names[fixed + entry] for entry in item.moved), moving.T, strict=True)
    kept = {name: column for name, column in columns.items() if column.any() and name not in without}
    (run,) = item.runs
    rows = np.column_stack([*kept.values(), np.ones(len(moving))])[run]
    scale = np.abs(rows).max(axis=0)
    response = item.responses[run, 0]
    theta = np.linalg.lstsq(rows / scale, response, rcond=None)[0] / scale
    left = float(np.std(response - rows @ theta))
    return dict(zip(kept, theta[:-1].tolist(), strict=True)), left


def test_a_log_that_begins_in_the_air_counts_once_rotors_no_longer_know_how_they_began():
    (flight,) = simulate_rigid_body_flights([replace(SPEC, duration=4.0, seed=5)])
    prepared = prepare(flight.recording, RigidBody(known(SPEC.vehicle)), FlightOptions())
    begin = prepared.signals.step_s * float(np.flatnonzero(prepared.used)[0])
    assert begin == pytest.approx(SETTLED_S, abs=0.02)
