"""The rigid body's simulator against RotorPy, which others wrote."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from eivor.motions.rigid_body.dynamics import coefficients_of, side_by_side
from eivor.simulation.rigid_body_spec import AdaptiveSteps, HeldInputs, Integrator, RungeKutta4
from tests.motions.rigid_body.state_derivatives import state_derivative
from validation.flight_recipe.rotorpy_flight import (
    GRAVITY,
    Vehicle,
    hover_speed,
    rigid_body,
    vehicle_parameters,
)

pytest.importorskip("rotorpy")

#: RotorPy's own default is off by .33 m after five seconds of this flight.
TOLERANCE = {"rtol": 1e-8, "atol": 1e-10}


def every_effect() -> dict[str, Any]:
    """A vehicle with all that RotorPy knows: a hub above the centre of mass, flapping, a full inertia."""
    parameters = vehicle_parameters(Vehicle.HUMMINGBIRD, None)
    raised = {
        name: parameter + np.array([0.01, -0.02, 0.03]) for name, parameter in parameters["rotor_pos"].items()
    }
    products = {"Ixy": 2e-4, "Ixz": -3e-4, "Iyz": 1e-4}
    return parameters | products | {"rotor_pos": raised, "k_flap": 2e-5, "c_Dx": 0.02}


def multirotor(parameters: dict[str, Any], **options: Any) -> Any:
    from rotorpy.vehicles.multirotor import Multirotor

    return Multirotor(parameters, control_abstraction="cmd_motor_speeds", **options)


@pytest.mark.parametrize("vehicle", [Vehicle.CRAZYFLIE, Vehicle.HUMMINGBIRD, "every effect"])
def test_derivatives_at_random_states(vehicle):
    parameters = every_effect() if vehicle == "every effect" else vehicle_parameters(vehicle, None)
    theirs = multirotor(parameters)
    rng, count, fastest = np.random.default_rng(1), 300, parameters["rotor_speed_max"]
    attitude = rng.standard_normal((count, 4))
    attitude /= np.linalg.norm(attitude, axis=1)[:, None]
    state = np.hstack(
        [
            rng.normal(0.0, 2.0, (count, 6)),
            attitude,
            rng.normal(0.0, 5.0, (count, 3)),
            rng.uniform(0.2 * fastest, fastest, (count, 4)),
        ]
    )
    command, wind = rng.uniform(0.0, fastest, (count, 4)), rng.normal(0.0, 2.0, (count, 3))
    ours = state_derivative(side_by_side([rigid_body(parameters)], GRAVITY), state, command, wind)
    for k in range(count):
        packed = np.concatenate(
            [state[k, :6], np.roll(attitude[k], -1), state[k, 10:13], wind[k], state[k, 13:]]
        )
        slope = theirs._s_dot_fn(0.0, packed, command[k])
        expected = np.concatenate([slope[:6], np.roll(slope[6:10], 1), slope[10:13], slope[16:]])
        np.testing.assert_allclose(ours[k], expected, rtol=1e-11, atol=1e-11)


def replayed(parameters: dict[str, Any], integrator: Integrator, seconds: float) -> tuple[Any, Any]:
    """Positions in both simulators after each step of 2 ms, under commands that tumble the vehicle."""
    rng, step = np.random.default_rng(2), 0.002
    hover = np.full(4, hover_speed(parameters))
    count = round(seconds / step)
    held = np.repeat(rng.normal(0.0, 0.04, (count // 50 + 1, 4)), 50, axis=0)[:count]
    commands = hover * (1.0 + held)
    state = {
        "x": np.zeros(3),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": hover,
    }
    theirs = multirotor(parameters, integrator_kwargs=TOLERANCE)
    ours = integrator.stepper(coefficients_of(rigid_body(parameters), GRAVITY), step)
    body, speeds = [0.0] * 6 + [1.0] + [0.0] * 6, hover.tolist()
    positions = []
    for command in commands:
        state = theirs.step(state, {"cmd_motor_speeds": command}, step)
        body, speeds = ours(body, speeds, HeldInputs(command.tolist()))
        positions.append((state["x"], body[:3]))
    return tuple(np.array(column) for column in zip(*positions, strict=True))


BOUNDS = [(Vehicle.CRAZYFLIE, 1e-6), (Vehicle.HUMMINGBIRD, 1e-4)]


@pytest.mark.long
@pytest.mark.usefixtures("unchecked_shapes")  # of five seconds and of a third of one they are the same
@pytest.mark.parametrize(("vehicle", "bound"), BOUNDS)
def test_open_loop_replay_of_five_seconds(vehicle, bound):
    theirs, ours = replayed(vehicle_parameters(vehicle, None), RungeKutta4(), 5.0)
    assert np.ptp(theirs, axis=0).min() > 8.0
    assert np.abs(theirs - ours).max() < bound


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_open_loop_replay_by_adaptive_steps():
    theirs, ours = replayed(vehicle_parameters(Vehicle.CRAZYFLIE, None), AdaptiveSteps(), 1.0)
    assert np.abs(theirs - ours).max() < 1e-7
