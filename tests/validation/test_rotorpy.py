"""RotorPy's flights against closed forms, the rigid body's simulator against RotorPy, the example."""

from __future__ import annotations

import functools
import importlib.util
import itertools
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import polars as pl
import pytest

from eivor.errors import CollinearError, ShapeError, TooFewSamplesError, UsageError
from eivor.motions.rigid_body.dynamics import (
    BODY,
    body_derivative,
    side_by_side,
    speed_derivative,
)
from eivor.signals.recording import Recording
from eivor.simulation.environment import FlightTruth, SensorNoise, SimulatedFlight, TrajectoryKind
from validation.effective_parameters import effective_parameters
from validation.flight_recipe import rotorpy_flight
from validation.flight_recipe.rotorpy_flight import (
    GRAVITY,
    STEP_S,
    RotorpyFlightSpec,
    Vehicle,
    rigid_body,
    simulate_rotorpy_flight,
    vehicle_parameters,
)

pytest.importorskip("rotorpy")


ROOT = Path(__file__).resolve().parents[2]


DATA = ROOT / "src" / "eivor" / "data"


# One flight serves several tests: a second of it costs a quarter of a second.
fly = functools.lru_cache(maxsize=None)(simulate_rotorpy_flight)


def calm(vehicle: Vehicle = Vehicle.CRAZYFLIE, **changes: object) -> RotorpyFlightSpec:
    """Four noise-free seconds in still air."""
    chosen = {"noise": SensorNoise.none(), "duration": 4.0, "seed": 11} | changes
    return RotorpyFlightSpec(vehicle, **chosen)


def values(recording: Recording, name: str) -> np.ndarray:
    return recording.channel(name).values


def commands(flight: SimulatedFlight) -> np.ndarray:
    return np.column_stack([channel.values for channel in flight.recording.family("rotor_command_*")])


def everywhere(truth: FlightTruth) -> np.ndarray:
    return np.ones(truth.time_s.size, dtype=bool)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("vehicle", "lag", "delay"),
    [(Vehicle.CRAZYFLIE, None, 0.0), (Vehicle.CRAZYFLIE, 0.12, 0.02), (Vehicle.HUMMINGBIRD, None, 0.02)],
)
def test_rotors_are_the_exact_lag_of_the_delayed_commands(vehicle, lag, delay):
    flight = fly(RotorpyFlightSpec(vehicle, lag, delay, gust_rms=0.3, duration=2.0, seed=13))
    assert flight.flew
    truth, reported = flight.truth, commands(flight)
    late = round(delay / STEP_S)
    acting = np.vstack([np.full((late, reported.shape[1]), truth.hover_input), reported])
    decay = np.exp(-STEP_S / truth.actuator_lag)
    state = np.full(reported.shape[1], truth.hover_input)
    expected = np.empty_like(truth.rotor_state)
    for k in range(truth.time_s.size):
        expected[k] = state
        state = decay * state + (1.0 - decay) * acting[k]
    np.testing.assert_allclose(truth.rotor_state, expected, rtol=1e-6)
    assert np.std(truth.rotor_state) > 0.005 * truth.hover_input  # the comparison is not of constants


@pytest.mark.thorough
def test_rows_without_motion_or_of_another_flight_have_no_effective_parameters():
    hover = fly(calm(trajectory=TrajectoryKind.HOVER, duration=2.0)).truth
    with pytest.raises(CollinearError, match="a velocity and an input that vary"):
        effective_parameters(hover, everywhere(hover), np.square)
    truth = fly(calm()).truth
    with pytest.raises(ShapeError, match="a mask of 400 rows"):
        effective_parameters(truth, everywhere(truth)[1:], np.square)
    with pytest.raises(TooFewSamplesError, match="at least four rows"):
        effective_parameters(truth, ~everywhere(truth), np.square)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"delay": 0.015}, "a multiple of 0.01"),
        ({"delay": -0.01}, "between 0 and 0.2 s"),
        ({"actuator_lag": 0.0}, r"a lag in \(0, 0.5\] s"),
        ({"gust_rms": -1.0}, "gusts of at least 0"),
        ({"duration": 0.5}, "a duration of 2 to 3600 s"),
        ({"noise": {"velocity": -0.1}}, "finite noise levels"),
    ],
)
def test_specification_is_checked(wrong, message):
    with pytest.raises(UsageError, match=message):
        SensorNoise(**wrong["noise"]) if "noise" in wrong else RotorpyFlightSpec(**wrong)


@functools.cache
def example_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_example", ROOT / "examples/make_example_flight.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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


def test_example_agrees_with_its_truth_file():
    # Lagged commands and the logged velocity explain the logged force up to its own noise.
    frame = pl.read_parquet(DATA / "example_flight.parquet")
    record = json.loads((DATA / "example_flight_truth.json").read_text(encoding="utf-8"))
    decay = np.exp(-STEP_S / record["actuator_lag"])
    reported = frame.select(pl.col("^rotor_command_.*$")).to_numpy().astype(np.float64)
    state = np.full(4, record["hover_input"])
    mapped = np.empty(reported.shape[0])
    for k, command in enumerate(reported):
        mapped[k] = np.square(state).mean()
        state = decay * state + (1.0 - decay) * command
    velocity = frame["velocity_z"].to_numpy().astype(np.float64)
    explained = record["input_gain"] * mapped - record["viscous_friction"] * velocity
    residual = frame["specific_force_body_z"].to_numpy() - explained
    assert abs(residual.mean()) < 0.05
    assert np.std(residual) == pytest.approx(record["noise"]["acceleration"], rel=0.05)


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
