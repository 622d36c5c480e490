"""RotorPy's flights against closed forms, the rigid body's simulator against RotorPy, the example."""

from __future__ import annotations

import functools
import importlib.util
import itertools
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from eivor.motions.rigid_body.dynamics import BODY, body_derivative, side_by_side, speed_derivative
from validation.flight_recipe import rotorpy_flight
from validation.flight_recipe.rotorpy_flight import (
    GRAVITY,
    Vehicle,
    rigid_body,
    simulate_rotorpy_flight,
    vehicle_parameters,
)

pytest.importorskip("rotorpy")

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "src" / "eivor" / "data"


@functools.cache
def example_script():
    spec = importlib.util.spec_from_file_location("make_example", ROOT / "examples/make_example_flight.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.thorough
@pytest.mark.parametrize("stamps", [600, pytest.param(6000, marks=pytest.mark.long)])
def test_example_is_what_its_script_makes(stamps, monkeypatch):
    """Each stamp follows from the one before it: the first tenth serves, and the long one has them all."""
    count = itertools.count(1)
    monkeypatch.setattr(rotorpy_flight, "is_lost", lambda *_: next(count) == stamps)
    script = example_script()
    flight = simulate_rotorpy_flight(script.SPEC)
    stored, made = pl.read_parquet(DATA / "example_flight.parquet").head(stamps), script.table(flight)
    assert stored.schema == made.schema
    assert stored.height == made.height
    for name in stored.columns:
        step = next((step for start, step in script.RESOLUTION.items() if name.startswith(start)), 1e-9)
        # Rounding may fall to the other side on another machine, hence one step of the resolution.
        np.testing.assert_allclose(stored[name], made[name], atol=1.01 * step, rtol=0.0)
    record = json.loads((DATA / "example_flight_truth.json").read_text(encoding="utf-8"))
    fresh = script.truth_record(flight)
    assert record.keys() == fresh.keys()
    for name in ("viscous_friction", "input_gain", "actuator_lag", "delay", "hover_input"):
        assert record[name] == pytest.approx(fresh[name], rel=1e-12)
    assert record["seed"] == 20240617


def every_effect():
    """A vehicle with all that RotorPy knows: a hub above the centre of mass, flapping, a full inertia."""
    parameters = vehicle_parameters(Vehicle.HUMMINGBIRD, None)
    raised = {
        name: parameter + np.array([0.01, -0.02, 0.03]) for name, parameter in parameters["rotor_pos"].items()
    }
    products = {"Ixy": 2e-4, "Ixz": -3e-4, "Iyz": 1e-4}
    return parameters | products | {"rotor_pos": raised, "k_flap": 2e-5, "c_Dx": 0.02}


def multirotor(parameters, **options):
    from rotorpy.vehicles.multirotor import Multirotor

    return Multirotor(parameters, control_abstraction="cmd_motor_speeds", **options)


def state_derivative(coefficients, state, command, wind):
    """Time derivatives of many bodies and their rotors at once."""
    flat = state.T
    speeds = [flat[BODY:]]
    change = speed_derivative(coefficients, speeds, [command.T])
    body = body_derivative(coefficients, flat[:BODY], speeds, change, tuple(wind.T), (0.0, 0.0, 0.0))
    return np.vstack([*body, *change]).T


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
