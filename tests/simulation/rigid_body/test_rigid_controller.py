"""Mixer, loops and delay line by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eivor.motions.rigid_body.dynamics import coefficients_of, turned, wrench
from eivor.motions.rigid_body.vehicle import Rotors, Vehicle
from eivor.simulation.controller import (
    Cascade,
    DelayLine,
    FlightController,
    gains_of,
    mixer_of,
    mixers_side_by_side,
    torque_limits,
)
from eivor.simulation.rigid_body_spec import quaternions

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


def test_torque_of_one_is_that_of_one_side():
    full, sides = HEXACOPTER.rotors.highest_speed, np.array(HEXACOPTER.rotors.positions)
    coefficients = coefficients_of(HEXACOPTER)
    for axis, side in enumerate([sides[:, 1] > 0, sides[:, 0] < 0, np.array(HEXACOPTER.rotors.spins) > 0]):
        torque = wrench(coefficients, STILL, STILL, (full * side).tolist())[1]
        assert torque[axis] == pytest.approx(torque_limits(HEXACOPTER)[axis])


def test_commands_stay_within_the_rotors_limits():
    mixer = mixer_of(replace(HEXACOPTER, rotors=replace(HEXACOPTER.rotors, lowest_speed=100.0)))
    speeds = mixer.commands(0.5, (1.0, 1.0, 1.0))
    assert max(speeds) == pytest.approx(800.0)
    assert min(speeds) == pytest.approx(100.0)
    idle = mixer_of(HEXACOPTER).commands(0.0, (0.0, 0.0, 0.0))
    assert 0.0 < max(idle) < 80.0


def test_mixers_side_by_side_are_each_of_them():
    light = replace(HEXACOPTER, mass=1.0, rotors=replace(HEXACOPTER.rotors, torque_ratio=0.01))
    (speeds,) = mixers_side_by_side([HEXACOPTER, light]).commands(
        np.array([0.4, 0.5]), (np.array([0.1, 0.2]), np.zeros(2), np.array([0.0, 0.1]))
    )
    np.testing.assert_allclose(speeds[:, 1], mixer_of(light).commands(0.5, (0.2, 0.0, 0.1)))


def test_attitude_loop_turns_the_shorter_way():
    gains = gains_of(FlightController(), HEXACOPTER, 0.0)
    cascade = Cascade(gains, 0.002, 0.02)
    now, wanted = quaternions(np.array([[0.1, -0.2, 0.3], [0.15, -0.1, 0.35]])).tolist()
    rates = cascade.rates(wanted, now)
    opposite = cascade.rates([-part for part in wanted], now)
    assert rates == pytest.approx(opposite)
    small = [rate / gain for rate, gain in zip(rates, gains.attitude, strict=True)]
    turn = Rotation.from_quat(now, scalar_first=True).inv() * Rotation.from_quat(wanted, scalar_first=True)
    np.testing.assert_allclose(small, turn.as_rotvec(), rtol=1e-2, atol=1e-4)


def test_a_weak_axis_is_not_driven_by_noise():
    weak = replace(
        HEXACOPTER, rotors=replace(HEXACOPTER.rotors, torque_ratio=1e-3, lag_up=5e-3, lag_down=5e-3)
    )
    gains = gains_of(FlightController(), weak, 0.0)
    assert gains.rate[2] == pytest.approx(0.5)
    assert gains.rate[0] < 0.5
    assert gains.attitude[2] < 0.3 * gains.attitude[0]


def test_derivative_is_that_of_the_filtered_rates():
    steady = FlightController(integral_share=0.0)
    quick = replace(steady, derivative_share=0.5, derivative_cutoff_hz=2.0)
    plain, damped = (Cascade(gains_of(item, HEXACOPTER, 0.0), 0.002, 0.02) for item in (steady, quick))
    decay, slope, gap = np.exp(-2.0 * np.pi * 2.0 / 500.0), 0.0, 0.0
    gains = gains_of(quick, HEXACOPTER, 0.0)
    before = 0.0
    for rate in (0.0, 0.01, 0.03, 0.02):
        slope = decay * slope + (1.0 - decay) * (rate - before) / 0.002
        before = rate
        gap = plain.torques(STILL, (rate, 0.0, 0.0))[0] - damped.torques(STILL, (rate, 0.0, 0.0))[0]
        assert gap == pytest.approx(gains.derivative[0] * slope)
    assert gap != 0.0


def test_quaternions_are_yaw_then_pitch_then_roll():
    angles = np.array([[0.3, -0.4, 1.2], [-0.1, 0.2, -2.0]])
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
    np.testing.assert_allclose(quaternions(angles), expected * np.sign(expected[:, :1]), atol=1e-12)


def test_small_turns_are_about_the_own_axes():
    start = quaternions(np.array([[0.3, -0.4, 1.2]]))[0]
    moved = turned(start.tolist(), 1e-4, -2e-4, 3e-4)
    turn = Rotation.from_quat(start, scalar_first=True).inv() * Rotation.from_quat(moved, scalar_first=True)
    np.testing.assert_allclose(turn.as_rotvec(), [1e-4, -2e-4, 3e-4], atol=1e-9)


def test_values_arrive_later():
    line = DelayLine(2, [0.0])
    assert [line.pass_on([float(k)])[0] for k in range(1, 6)] == [0.0, 0.0, 1.0, 2.0, 3.0]
    assert DelayLine(0).pass_on([5.0]) == [5.0]
    first = DelayLine(1)
    assert [first.pass_on([float(k)])[0] for k in range(1, 4)] == [1.0, 1.0, 2.0]


def test_each_flight_has_its_own_delay():
    line = DelayLine(np.array([0, 2, 1]), [np.zeros((4, 3))])
    arrived = [line.pass_on([np.full((4, 3), float(k))])[0][0].tolist() for k in range(1, 5)]
    assert arrived == [[1.0, 0.0, 0.0], [2.0, 0.0, 1.0], [3.0, 1.0, 2.0], [4.0, 2.0, 3.0]]
