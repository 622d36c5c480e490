"""Combinations of parameters against the equations of motion that they stand in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.motions.rigid_body.dynamics import (
    body_derivative,
    coefficients_of,
    effective_parameters,
    specific_force,
)
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle

ROTORS = Rotors(
    positions=((0.1, 0.12, 0.0), (0.1, -0.12, 0.0), (-0.1, -0.12, 0.0), (-0.1, 0.12, 0.0)),
    spins=(1, -1, 1, -1),
    highest_speed=1000.0,
    thrust_quadratic=1e-5,
    thrust_linear=1e-3,
    torque_ratio=0.02,
    lag_up=0.05,
    lag_down=0.06,
    inertia=1e-5,
    delay=0.004,
    drag=1e-4,
    inflow=2e-4,
)
VEHICLE = Vehicle(
    1.0,
    (0.01, 0.012, 0.02),
    ROTORS,
    BodyDrag(linear=(0.1, 0.2, 0.3), quadratic=(0.01, 0.02, 0.03), rotational=(1e-3, 2e-3, 3e-3)),
)


@pytest.mark.parametrize(
    "thrust", [{}, {"thrust_linear": 0.0}, {"thrust_quadratic": 0.0, "thrust_linear": 0.01}]
)
def test_equations_hold_at_hover(thrust):
    """The equations of the module's docstring at hover speeds, term by term."""
    vehicle = replace(VEHICLE, rotors=replace(ROTORS, **thrust))
    parameters, rotors = effective_parameters(vehicle), vehicle.rotors
    hover = vehicle.hover_speed
    change = np.array([300.0, -200.0, 100.0, 50.0])
    p, q, r, vx, vy, vz = 0.3, -0.2, 0.4, 1.0, -2.0, 0.5
    coefficients, still = coefficients_of(vehicle), (0.0, 0.0, 0.0)
    body = [0.0, 0.0, 0.0, vx, vy, vz, 1.0, 0.0, 0.0, 0.0, p, q, r]
    slope = body_derivative(coefficients, body, [hover] * 4, change.tolist(), still, still)
    phi = (
        hover
        if rotors.thrust_quadratic == 0.0
        else hover**2 + rotors.thrust_linear / rotors.thrust_quadratic * hover
    )
    first, second, third = parameters.gyroscopic_ratios
    # Equal rotors: neither the shear of the flow nor their own momentum leaves a torque.
    assert slope[10] == pytest.approx(first * q * r - parameters.rate_damping[0] * p, rel=1e-9)
    assert slope[11] == pytest.approx(second * p * r - parameters.rate_damping[1] * q, rel=1e-9)
    reaction = parameters.rotor_reaction * (change @ rotors.spins)
    assert slope[12] == pytest.approx(third * p * q - parameters.rate_damping[2] * r + reaction, rel=1e-9)
    speed = np.sqrt(vx**2 + vy**2 + vz**2)
    force = specific_force(coefficients, body, [hover] * 4, still)
    for axis, v in enumerate((vx, vy, vz)):
        thrust_part = parameters.thrust_gain * 4.0 * phi if axis == 2 else 0.0
        expected = thrust_part - parameters.drag[axis] * v - parameters.quadratic_drag[axis] * speed * v
        assert force[axis] == pytest.approx(expected, rel=1e-9)


def test_torques_are_those_of_the_gains():
    parameters, coefficients = effective_parameters(VEHICLE), coefficients_of(VEHICLE)
    speeds, still = np.array([500.0, 510.0, 520.0, 540.0]), (0.0, 0.0, 0.0)
    slope = body_derivative(
        coefficients, [0.0] * 6 + [1.0] + [0.0] * 6, speeds.tolist(), [0.0] * 4, still, still
    )
    phi = speeds**2 + 100.0 * speeds
    x, y, _ = np.array(ROTORS.positions).T
    roll, pitch, yaw = parameters.torque_gains
    np.testing.assert_allclose(
        slope[10:], [roll * (y @ phi), -pitch * (x @ phi), yaw * (phi @ ROTORS.spins)], rtol=1e-9
    )


def test_translational_lift_is_that_of_all_rotors():
    vehicle = replace(VEHICLE, rotors=replace(ROTORS, translational_lift=1e-3))
    assert effective_parameters(vehicle).translational_lift == pytest.approx(4e-3)
    moving = [0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0] + [0.0] * 6
    up = [
        specific_force(coefficients_of(v), moving, [500.0] * 4, (0.0, 0.0, 0.0))[2]
        for v in (vehicle, VEHICLE)
    ]
    assert up[0] - up[1] == pytest.approx(4e-3 * 9.0)


def test_what_rotors_drag_at_hover_is_that_of_their_speed():
    parameters, hover = effective_parameters(replace(VEHICLE, drag=BodyDrag())), VEHICLE.hover_speed
    x, y, _ = np.array(ROTORS.positions).T
    arms = np.array([np.sum(y**2), np.sum(x**2), np.sum(x**2 + y**2)])
    np.testing.assert_allclose(parameters.rate_damping, hover * arms * parameters.rotor_rate_drag)
    np.testing.assert_allclose(parameters.drag, 4.0 * hover * np.array(parameters.rotor_drag))


def test_gyroscopic_ratios_belong_to_one_body():
    first, second, third = effective_parameters(VEHICLE).gyroscopic_ratios
    assert first + second + third + first * second * third == pytest.approx(0.0, abs=1e-15)
