"""Descriptions of vehicles: what they say, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import ParameterError, UsageError
from eivor.motions.rigid_body.dynamics import coefficients_of, side_by_side, specific_force
from eivor.motions.rigid_body.vehicle import BodyDrag, Rotors, Vehicle
from eivor.motions.vertical.model import GRAVITY
from tests.motions.rigid_body.state_derivatives import state_derivative

ROTORS = Rotors(
    positions=((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)),
    spins=(1, -1),
    highest_speed=1000.0,
    thrust_quadratic=1e-5,
    torque_ratio=0.02,
    lag_up=0.05,
    lag_down=0.05,
)
VEHICLE = Vehicle(1.0, (0.01, 0.02, 0.025), ROTORS)


@pytest.mark.parametrize(("linear", "quadratic"), [(0.0, 1e-5), (2e-3, 0.0), (2e-3, 1e-5)])
def test_speed_of_thrust_inverts_it(linear, quadratic):
    rotors = replace(ROTORS, thrust_linear=linear, thrust_quadratic=quadratic)
    assert rotors.speed_of_thrust(rotors.thrust(432.1)) == pytest.approx(432.1, rel=1e-12)
    assert rotors.speed_of_thrust(-1.0) == 0.0


def test_hover_carries_the_weight():
    hover = VEHICLE.hover_speed
    assert 2.0 * ROTORS.thrust(hover) == pytest.approx(GRAVITY, rel=1e-12)
    assert VEHICLE.full_thrust == pytest.approx(20.0)
    body = [0.0] * 6 + [1.0] + [0.0] * 6
    force = specific_force(coefficients_of(VEHICLE), body, [hover, hover], (0.0, 0.0, 0.0))
    assert force == pytest.approx((0.0, 0.0, GRAVITY))


def test_inertia_has_its_elements_in_order():
    matrix = replace(VEHICLE, inertia=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)).inertia_matrix
    np.testing.assert_array_equal(matrix, [[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass above zero"),
        ({"inertia": (1.0, 2.0)}, "three numbers .* or six"),
        ({"inertia": (1.0, 2.0, -3.0)}, "positive definite"),
        ({"inertia": (1.0, 1.0, 1.0, 2.0, 0.0, 0.0)}, "positive definite"),
        ({"inertia": (float("nan"), 1.0, 1.0)}, "positive definite"),
    ],
)
def test_vehicle_is_checked(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(VEHICLE, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spins": (1,)}, "a spin for each"),
        ({"spins": (1, 2)}, r"spins of \+1 or -1"),
        ({"positions": ((0.1, 0.0, 0.0),), "spins": (1,)}, "positions of 2 to"),
        ({"positions": ((0.1, 0.0), (0.1, 0.0, 0.0))}, "three numbers for position"),
        ({"positions": ((float("inf"), 0.0, 0.0), (0.1, 0.0, 0.0))}, "finite position"),
        ({"lag_up": 0.0}, "lag_up above zero"),
        ({"inertia": -1.0}, "inertia of zero or more"),
        ({"thrust_quadratic": 0.0}, "rotors with thrust"),
        ({"lowest_speed": 1000.0}, "below the highest_speed"),
    ],
)
def test_rotors_are_checked(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(ROTORS, **change)


@pytest.mark.parametrize(
    ("drag", "message"),
    [({"linear": (1.0,)}, "three numbers"), ({"quadratic": (0.0, 0.0, -1.0)}, "zero or more")],
)
def test_drag_is_checked(drag, message):
    with pytest.raises(ParameterError, match=message):
        BodyDrag(**drag)


def test_batch_of_states_is_each_of_them():
    rng = np.random.default_rng(4)
    state, command, wind = (
        rng.standard_normal((5, 2, 15)),
        rng.uniform(0.0, 1e3, (5, 2, 2)),
        rng.standard_normal((5, 2, 3)),
    )
    together = state_derivative(side_by_side([VEHICLE]), state, command, wind)
    alone = state_derivative(side_by_side([VEHICLE]), state[3, 1], command[3, 1], wind[3, 1])
    np.testing.assert_allclose(together[3, 1], alone, rtol=1e-13, atol=1e-13)


def test_several_need_equally_many_rotors():
    three = replace(ROTORS, positions=(*ROTORS.positions, (0.0, 0.1, 0.0)), spins=(1, -1, 1))
    with pytest.raises(UsageError, match="equally many rotors"):
        side_by_side([VEHICLE, replace(VEHICLE, rotors=three)])
