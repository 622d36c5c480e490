"""Steps of the rigid body against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from eivor.motions.rigid_body.dynamics import body_derivative, coefficients_of, speed_derivative
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.simulation.rigid_body_spec import HeldInputs, RotorCourse, runge_kutta

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
