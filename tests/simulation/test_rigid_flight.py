"""Flights of a whole vehicle: logs against the truth, one route against another, and what is refused."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from eivor.errors import ParameterError
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.rigid_body.dynamics import body_derivative, coefficients_of, speed_derivative, wrench
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import FlightController, Sensor, mixer_of, torque_limits
from eivor.simulation.excitation import DrydenGust, RandomSteps, SteppedExcitation
from eivor.simulation.known_logs import log_of_rigid_body_flight, viscous_friction
from eivor.simulation.rigid_body import RigidBodyTruth, simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import (
    AxisExcitations,
    HeldInputs,
    Logged,
    RigidBodyFlightSpec,
    RotorCourse,
    Sensors,
    TorqueDisturbance,
    Wind,
    quaternions,
    runge_kutta,
)

VEHICLE = Vehicle(
    1.2,
    (0.0153, 0.0155, 0.0296),
    Rotors(
        positions=((0.16, 0.16, 0.0), (0.16, -0.16, 0.0), (-0.16, -0.16, 0.0), (-0.16, 0.16, 0.0)),
        spins=(1, -1, 1, -1),
        highest_speed=900.0,
        thrust_quadratic=1.4e-5,
        torque_ratio=0.016,
        lag_up=0.04,
        lag_down=0.04,
        inertia=2e-5,
        drag=1.3e-4,
        inflow=2.6e-4,
    ),
    BodyDrag(quadratic=(0.01, 0.01, 0.02)),
)
STEPS = AxisExcitations(RandomSteps(0.2, 0.1), RandomSteps(0.2, 0.1), RandomSteps(0.3, 0.1))
QUIET = RigidBodyFlightSpec(VEHICLE, duration=3.0, attitude=STEPS, sensors=Sensors.exact(), seed=4)
LOUD = RigidBodyFlightSpec(
    replace(VEHICLE, rotors=replace(VEHICLE.rotors, delay=0.006, lag_down=0.06)),
    duration=1.0,
    attitude=STEPS,
    injection=AxisExcitations(roll=SteppedExcitation((0.05, -0.05), 0.1)),
    controller=FlightController(rate_hz=250.0, attitude_hz=250.0, derivative_share=0.3, hold=0.3),
    wind=Wind((1.0, 0.0, 0.0), z=DrydenGust(0.3, 3.0, 2.0)),
    torque_disturbance=TorqueDisturbance(pitch=OrnsteinUhlenbeck(1.0, 0.3)),
    sensors=Sensors(
        angular_rate=Sensor(WhiteNoise(0.02), cutoff_hz=60.0, delay_s=0.004),
        velocity=Sensor(WhiteNoise(0.05), bias=0.1, delay_s=0.02),
        rotor_speed=Sensor(WhiteNoise(5.0)),
    ),
    seed=5,
)


@cache
def fly(spec):
    return next(simulate_rigid_body_flights([spec]))


def values(flight, name):
    return flight.recording.channel(name).values


def vectors(flight, stem, parts="xyz"):
    return np.column_stack([values(flight, f"{stem}_{part}") for part in parts])


@pytest.mark.usefixtures("unchecked_shapes")
def test_log_of_exact_sensors_is_the_truth():
    flight = fly(QUIET)
    truth = flight.truth
    assert flight.flew
    for stem, parts, expected in (
        ("angular_rate", "xyz", truth.angular_rate),
        ("specific_force_body", "xyz", truth.specific_force),
        ("velocity", "xyz", truth.velocity),
        ("attitude", "wxyz", truth.attitude),
        ("rotor_speed", "1234", truth.rotor_speed),
        ("rotor_command", "1234", truth.rotor_command),
        ("torque_setpoint", "xyz", truth.torque_setpoint),
    ):
        np.testing.assert_allclose(vectors(flight, stem, parts), expected, atol=1e-12)
    np.testing.assert_array_equal(values(flight, "input"), truth.thrust_setpoint)
    assert "injected_torque_x" not in flight.recording.channels
    held = {name for name, channel in flight.recording.channels.items() if channel.held}
    assert held == {
        name
        for name in flight.recording.channels
        if name.startswith(("rotor_command", "reference", "feedback", "torque")) or name == "input"
    }


@pytest.mark.usefixtures("unchecked_shapes")
def test_equations_of_the_truth_hold():
    """Least squares of the rates' increments on interval means gives the parameters that the truth names."""
    truth = fly(replace(QUIET, vehicle=replace(VEHICLE, rotors=replace(VEHICLE.rotors, inertia=0.0)))).truth
    parameters, step = truth.parameters, QUIET.step_s
    x, y, _ = np.array(VEHICLE.rotors.positions).T
    spins = np.array(VEHICLE.rotors.spins)
    p, q, r = truth.angular_rate.T[:, :, None]
    turn = Rotation.from_quat(truth.attitude, scalar_first=True)
    u, v, w = turn.inv().apply(truth.air_velocity).T[:, :, None]
    n = truth.rotor_speed
    lx, ly, lz = u - r * y, v + r * x, w + p * y - q * x
    phi = mean_squares(truth.rotor_command[:-1], n[:-1], step, 0.04)
    (first, second, _), (roll, pitch, yaw) = parameters.gyroscopic_ratios, parameters.torque_gains
    for axis, (series, thrust, gain) in enumerate(
        [
            ([(q * r)[:, 0], -(n * lz) @ y], phi @ y, roll),
            ([(p * r)[:, 0], (n * lz) @ x], -(phi @ x), pitch),
            ([-(n * (x * ly - y * lx)).sum(axis=1)], phi @ spins, yaw),
        ]
    ):
        columns = [0.5 * (item[1:] + item[:-1]) for item in series] + [thrust]
        expected = [*((first,), (second,), ())[axis], parameters.rotor_rate_drag[axis], gain]
        scale = np.linalg.norm(columns, axis=1)
        slope = np.diff(truth.angular_rate[:, axis]) / step
        result = np.linalg.lstsq(np.array(columns).T / scale, slope)[0] / scale
        assert result[-1] == pytest.approx(expected[-1], rel=1e-3)
        np.testing.assert_allclose(result, expected, rtol=0.01)  # trapezoids across kinks


def mean_squares(command, speed, step_s, lag_s):
    """Mean of the squared speed over each step, from its course under a held command."""
    away, left = speed - command, np.exp(-step_s / lag_s)
    once, twice = lag_s * (1.0 - left) / step_s, lag_s * (1.0 - left**2) / (2.0 * step_s)
    return command**2 + 2.0 * command * away * once + away**2 * twice


@pytest.mark.usefixtures("unchecked_shapes")
def test_sensor_filters_delays_and_errs():
    sensor = Sensor(WhiteNoise(0.0), bias=0.5, cutoff_hz=20.0, delay_s=0.01)
    step = np.r_[np.zeros(100), np.ones(400)][:, None]
    rng = np.random.default_rng(0)
    read = sensor.readings(step + sensor.errors(500, 1, rng), 0.002)[:, 0] - 0.5
    np.testing.assert_allclose(read[:105], 0.0, atol=1e-12)
    assert read[-1] == pytest.approx(1.0, abs=1e-9)
    late = np.sum(1.0 - read[100:]) * 0.002  # the area that is missing is the delay
    assert late == pytest.approx(sensor.lateness_s, abs=0.0015)
    assert Sensor(WhiteNoise(0.3)).errors(4000, 2, rng).std(axis=0) == pytest.approx([0.3, 0.3], rel=0.05)


@pytest.mark.usefixtures("unchecked_shapes")
def test_logged_rates_can_be_means_that_the_controller_does_not_get():
    mean = replace(QUIET, duration=0.6, sensors=replace(QUIET.sensors, angular_rate=Sensor(averaged_s=0.01)))
    flight = fly(mean)
    rates = flight.truth.angular_rate
    np.testing.assert_array_equal(rates, fly(replace(QUIET, duration=0.6)).truth.angular_rate)
    expected = np.mean([rates[4 - late : rates.shape[0] - late] for late in range(5)], axis=0)
    np.testing.assert_allclose(vectors(flight, "angular_rate")[4:], expected, atol=1e-12)
    np.testing.assert_allclose(values(flight, "angular_rate_y")[1], rates[:2, 1].mean(), atol=1e-15)


@pytest.mark.usefixtures("unchecked_shapes")
def test_stamps_have_their_rate_offset_and_error():
    sensor = Sensor(rate_hz=100.0, offset_s=0.006, jitter_s=0.001)
    rows = sensor.rows(5000, 0.002)
    assert rows[:3].tolist() == [3, 8, 13]
    stamps = sensor.stamps(rows, 0.002, np.random.default_rng(1))
    assert np.diff(stamps).min() > 0.0
    assert np.std(stamps - 0.002 * rows) == pytest.approx(0.001, rel=0.1)
    assert Sensor(rate_hz=300.0).rows(1000, 0.002).size == 600
    assert np.array_equal(Sensor(rate_hz=1000.0).rows(100, 0.002), np.arange(100))


@pytest.mark.usefixtures("unchecked_shapes")
def test_each_group_has_its_own_stamps_and_some_are_left_out():
    spec = replace(
        QUIET,
        duration=0.4,
        sensors=replace(QUIET.sensors, angular_rate=Sensor(rate_hz=250.0)),
        logged=Logged(100.0, 50.0, 25.0, omitted=("rotor_command_*", "reference_velocity_z")),
    )
    channels = fly(spec).recording.channels
    assert not {"rotor_command_1", "reference_velocity_z"} & set(channels)
    counts = {"angular_rate_x": 100, "input": 20, "torque_setpoint_z": 20, "reference_position_z": 10}
    assert {name: channels[name].time_s.size for name in counts} == counts
    assert channels["velocity_z"].time_s.size == 200


def same(first, second):
    for part in fields(RigidBodyTruth):
        item, other = getattr(first.truth, part.name), getattr(second.truth, part.name)
        if isinstance(item, np.ndarray):
            np.testing.assert_allclose(item, other, rtol=1e-9, atol=1e-11)
        else:
            assert item == other
    assert first.recording.channels.keys() == second.recording.channels.keys()
    for name in first.recording.channels:
        np.testing.assert_allclose(values(first, name), values(second, name), rtol=1e-9, atol=1e-11)


@pytest.mark.usefixtures("unchecked_shapes")
def test_flights_side_by_side_are_those_alone():
    """Other vehicles, delays, filters, gains and winds beside it make no difference."""
    short = replace(LOUD, duration=0.3)
    other = replace(
        short,
        vehicle=replace(VEHICLE, mass=1.0),
        seed=9,
        sensors=Sensors(),
        wind=Wind(),
        injection=AxisExcitations(),
        controller=replace(LOUD.controller, hold=0.0, derivative_share=0.0),
    )
    together = list(simulate_rigid_body_flights([short, other, replace(short, seed=6)]))
    same(together[0], fly(short))
    same(together[1], fly(other))
    assert not np.array_equal(together[2].truth.attitude, together[0].truth.attitude)


@pytest.mark.usefixtures("unchecked_shapes")
def test_flights_of_several_lengths_keep_their_order():
    specs = [replace(QUIET, duration=0.2), replace(QUIET, duration=0.1), replace(QUIET, duration=0.2, seed=1)]
    flights = list(simulate_rigid_body_flights(specs))
    assert [flight.truth.time_s.size for flight in flights] == [100, 50, 100]


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate_hz": 1.0}, "rate_hz between"),
        ({"duration": 0.0}, "duration between"),
        ({"rate_hz": 400.0}, "rate_hz of the controller"),
        ({"controller": FlightController(attitude_hz=200.0)}, "attitude_hz of the controller"),
        ({"vehicle": replace(VEHICLE, rotors=replace(VEHICLE.rotors, delay=0.003))}, "multiple of 0.002 s"),
    ],
)
def test_specification_is_checked(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(QUIET, **change)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FlightController(quickness=3.0), "quickness between"),
        (lambda: Sensor(delay_s=-1.0), "delay_s between"),
        (lambda: Sensor(bias=float("nan")), "a finite bias"),
        (lambda: Sensors(attitude=Sensor(averaged_s=0.01)), "averaged part by part"),
        (lambda: Wind((1.0, 2.0)), "three speeds"),
        (lambda: Logged(setpoint_hz=-1.0), "setpoint_hz between"),
    ],
)
def test_parts_are_checked(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


@pytest.mark.usefixtures("unchecked_shapes")
def test_filters_must_fit_the_rate():
    with pytest.raises(ParameterError, match="below half the simulation's rate"):
        fly(replace(QUIET, sensors=replace(QUIET.sensors, angular_rate=Sensor(cutoff_hz=300.0))))


@pytest.mark.usefixtures("unchecked_shapes")
def test_rotors_must_reach_every_axis():
    equal = replace(VEHICLE, rotors=replace(VEHICLE.rotors, spins=(1, 1, 1, 1)))
    with pytest.raises(ParameterError, match="a torque about each axis"):
        fly(replace(QUIET, vehicle=equal))


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_lost_vehicle_is_told():
    storm = replace(
        QUIET, duration=1.0, torque_disturbance=TorqueDisturbance(roll=OrnsteinUhlenbeck(600.0, 1.0))
    )
    assert not fly(storm).flew
    with pytest.raises(ParameterError, match="stays upright"):
        log_of_rigid_body_flight(storm)


@pytest.mark.usefixtures("unchecked_shapes")
def test_friction_of_the_truth_is_that_of_the_flights_speeds():
    """Up and down at 1 and 3 m/s: half of the squares' weight is not half of the samples."""
    truth = fly(replace(QUIET, duration=0.1)).truth
    dragged = replace(truth.parameters, drag=(0.1, 0.1, 0.2), quadratic_drag=(0.0, 0.0, 0.05))

    def flown(*climbs, attitude=(1.0, 0.0, 0.0, 0.0)):
        air = np.array([[0.0, 0.0, climb] for climb in climbs])
        return replace(
            truth, parameters=dragged, air_velocity=air, attitude=np.tile(attitude, (len(climbs), 1))
        )

    assert viscous_friction(flown(0.0, 0.0)) == 0.2
    assert viscous_friction(flown(2.0, -2.0)) == pytest.approx(0.2 + 0.05 * 2.0)
    assert viscous_friction(flown(1.0, -3.0)) == pytest.approx(0.2 + 0.05 * 28.0 / 10.0)
    sideways = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    assert viscous_friction(flown(2.0, attitude=sideways)) == pytest.approx(0.2)


ANGLES = np.pi / 3.0 * np.arange(6) + 0.2
HEXACOPTER = Vehicle(
    2.0,
    (0.02, 0.03, 0.04),
    Rotors(
        positions=tuple((0.3 * np.cos(a), 0.25 * np.sin(a), 0.0) for a in ANGLES.tolist()),
        spins=(1, -1, 1, -1, 1, -1),
        highest_speed=800.0,
        thrust_quadratic=1e-5,
        thrust_linear=1e-3,
        torque_ratio=0.02,
        lag_up=0.03,
        lag_down=0.03,
    ),
)
STILL = (0.0, 0.0, 0.0)


def test_mixer_gives_the_thrust_and_torques_that_are_asked_for():
    speeds = mixer_of(HEXACOPTER).commands(0.4, (0.1, -0.05, 0.08))
    force, torque = wrench(coefficients_of(HEXACOPTER), STILL, STILL, speeds)
    assert force[2] == pytest.approx(0.4 * HEXACOPTER.full_thrust)
    limits = torque_limits(HEXACOPTER)
    assert torque == pytest.approx((0.1 * limits[0], -0.05 * limits[1], 0.08 * limits[2]))


def test_quaternions_are_yaw_then_pitch_then_roll():
    angles = np.array([[0.3, -0.4, 1.2], [-0.1, 0.2, -2.0]])
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
    np.testing.assert_allclose(quaternions(angles), expected * np.sign(expected[:, :1]), atol=1e-12)


# Steps of the rigid body against closed forms.

ARM = 0.03
ROTORS = Rotors(
    positions=((ARM, ARM, 0.0), (ARM, -ARM, 0.0), (-ARM, -ARM, 0.0), (-ARM, ARM, 0.0)),
    spins=(1, -1, 1, -1),
    highest_speed=2500.0,
    thrust_quadratic=2.3e-8,
    torque_ratio=0.034,
    lag_up=0.07,
    lag_down=0.07,
)
SMALL = Vehicle(0.03, (1.4e-5, 1.5e-5, 2.6e-5), ROTORS)
DRAGGED = replace(
    SMALL, rotors=replace(ROTORS, drag=1e-6, inflow=7.5e-7), drag=BodyDrag(quadratic=(1e-3, 1e-3, 2e-3))
)
LEVEL = [0.0] * 6 + [1.0] + [0.0] * 6


def turning(rates):
    return LEVEL[:10] + list(rates)


def flown(coefficients, body, speeds, held, *, step_s, seconds):
    """States of body and rotors at the start and after each step."""
    stepper = runge_kutta(coefficients, step_s)
    bodies, rotors = [body], [speeds]
    for _ in range(round(seconds / step_s)):
        body, speeds = stepper(body, speeds, held)
        bodies.append(body)
        rotors.append(speeds)
    return np.array(bodies), np.array(rotors)


def rotations(bodies):
    return Rotation.from_quat(bodies[:, 6:10], scalar_first=True)


unchecked = pytest.mark.usefixtures("unchecked_shapes")  # thousands of steps of the same shapes


def test_small_steps_agree_with_scipys_integrator():
    vehicle = replace(DRAGGED, rotors=replace(DRAGGED.rotors, lag_down=0.02, inertia=1e-9))
    c, hover = coefficients_of(vehicle), vehicle.hover_speed
    held = HeldInputs([1.1 * hover, hover, 0.9 * hover, hover], wind=(2.0, 0.0, 0.0))
    body, speeds = turning((1.0, -2.0, 0.5)), [hover, hover, 1.1 * hover, 0.9 * hover]
    bodies, _ = flown(c, body, speeds, held, step_s=0.001, seconds=0.1)

    def slope(time, state):
        now = RotorCourse(c, time).after(speeds, held.command)
        change = speed_derivative(c, now, held.command)
        return body_derivative(c, state.tolist(), now, change, held.wind, held.disturbance)

    solved = solve_ivp(slope, (0.0, 0.1), np.array(body), method="DOP853", rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(bodies[-1], solved.y[:, -1], atol=1e-9)


def test_rotors_that_speed_up_turn_the_body_the_other_way():
    """RotorPy has no inertia of rotors; here the yaw rate is that of the closed form."""
    vehicle = replace(SMALL, rotors=replace(ROTORS, inertia=2e-9, torque_ratio=0.0, lag_down=0.03))
    hover = vehicle.hover_speed
    command = [1.2 * hover, 0.9 * hover, 1.2 * hover, 0.9 * hover]
    bodies, rotors = flown(
        coefficients_of(vehicle), LEVEL, [hover] * 4, HeldInputs(command), step_s=0.002, seconds=0.2
    )
    time = 0.002 * np.arange(bodies.shape[0])
    gained = -0.2 * hover * np.expm1(-time / 0.07), 0.1 * hover * np.expm1(-time / 0.03)
    np.testing.assert_allclose(rotors[:, 0] - hover, gained[0], atol=1e-9)
    np.testing.assert_allclose(rotors[:, 1] - hover, gained[1], atol=1e-9)
    # rotors 1 and 3 turn clockwise: as they speed up, the body is pushed counterclockwise
    expected = 2e-9 / 2.6e-5 * 2.0 * (gained[0] - gained[1])
    np.testing.assert_allclose(bodies[:, 12], expected, atol=1e-7)


@unchecked
def test_rotors_and_body_exchange_momentum():
    """Rotors that speed up while the body tumbles: the sum of both momenta stays."""
    idle = replace(ROTORS, inertia=3e-8, torque_ratio=0.0, thrust_quadratic=1e-30)
    vehicle = replace(SMALL, rotors=idle)
    bodies, rotors = flown(
        coefficients_of(vehicle),
        turning((2.0, -1.0, 1.0)),
        [0.0] * 4,
        HeldInputs([1000.0, 200.0, 400.0, 0.0]),
        step_s=0.001,
        seconds=1.0,
    )
    current = bodies[:, 10:] @ vehicle.inertia_matrix
    current[:, 2] -= 3e-8 * rotors @ np.array(idle.spins)
    total = rotations(bodies).apply(current)
    np.testing.assert_allclose(
        total, np.tile(total[0], (total.shape[0], 1)), atol=1e-7 * np.linalg.norm(total[0])
    )
