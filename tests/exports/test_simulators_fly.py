"""Files of simulators: loaded and flown by their programs, and identified again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from eivor.simulation.environment import TrajectoryKind, altitude_reference
from exports.documents import FRICTION, GAIN, GRAVITY, HOVER, LAG, climb, quad_params, saved

STEP, SECONDS = 1.02, 1.0


def flown(parameters: dict[str, Any], command: float) -> tuple[float, np.ndarray]:
    """Climb rate after `SECONDS` of a command in RotorPy, and a rotor's speeds."""
    from rotorpy.vehicles.multirotor import Multirotor

    start, step_s = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}, 0.01
    state = start | {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, HOVER)}
    vehicle = Multirotor(
        parameters, state, "cmd_motor_speeds", integrator_kwargs={"rtol": 1e-8, "atol": 1e-10}
    )
    speeds = [HOVER]
    for _ in range(round(SECONDS / step_s)):
        state = vehicle.step(state, {"cmd_motor_speeds": np.full(4, command)}, step_s)
        speeds.append(state["rotor_speeds"][0])
    return float(state["v"][2]), np.array(speeds)


@pytest.mark.thorough
def test_rotorpy_climbs_and_lags_as_the_flight_did(tmp_path: Path) -> None:
    pytest.importorskip("rotorpy", reason="RotorPy is not installed")
    parameters = quad_params(tmp_path)
    rate, speeds = flown(parameters, STEP * HOVER)
    assert rate == pytest.approx(climb(STEP, SECONDS), rel=0.01)
    left = (STEP - speeds / HOVER) / (STEP - 1.0)
    assert 0.1 / -np.log(left[10]) == pytest.approx(LAG, abs=0.002)
    assert flown(parameters, HOVER)[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.thorough  # of the extra `simulators`
def test_mujoco_climbs_as_the_flight_did(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = mujoco.MjModel.from_xml_path(saved("mujoco", tmp_path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qvel, 0.0, atol=1e-9)
    data.ctrl[:] = STEP**2
    mujoco.mj_step(model, data, round(SECONDS / model.opt.timestep))
    assert data.qvel[2] == pytest.approx(climb(STEP, SECONDS, lagged="thrust"), rel=0.002)
    assert data.qvel[2] == pytest.approx(climb(STEP, SECONDS), rel=0.01)
    data.ctrl[:] = [1.0, 1.0, 1.02, 1.02]  # the rotors on the left
    mujoco.mj_step(model, data, 50)
    assert data.qvel[3] > 0.1  # rolls to the right, about the axis that points forward
    np.testing.assert_allclose(data.qvel[[4, 5]], 0.0, atol=1e-3)
    np.testing.assert_allclose(model.body_inertia[1], [1.43e-5, 1.45e-5, 2.7e-5])
    assert model.actuator_ctrlrange[0, 1] == pytest.approx((2500.0 / HOVER) ** 2)


#: In a process of its own: drone-models must be imported before SciPy.
ACCELERATION = """
import inspect, json, sys, tomllib
from drone_models.first_principles import dynamics
import numpy as np
told = {name: np.asarray(one) for name, one in tomllib.load(open(sys.argv[1], "rb"))["vehicle"].items()}
told["J_inv"] = np.linalg.inv(told["J"])
asked = [name for name, one in inspect.signature(dynamics).parameters.items() if one.kind == one.KEYWORD_ONLY]
per_minute = float(sys.argv[2]) * 60.0 / (2.0 * np.pi)
rest = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), np.zeros(3)
speeds = per_minute * np.array([1.0, 1.0, 1.02, 1.02])
found = dynamics(*rest, 1.02 * speeds, speeds, **{name: told[name] for name in asked})
print(json.dumps([one.tolist() for one in found[2:]]))
"""


@pytest.mark.thorough
def test_drone_models_accelerate_as_the_flight_says(tmp_path: Path) -> None:
    pytest.importorskip("casadi", reason="drone-models is not installed")
    run = subprocess.run(
        [sys.executable, "-c", ACCELERATION, saved("drone-models", tmp_path), repr(HOVER)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"SCIPY_ARRAY_API": "1"},
    )
    velocity, rates, speeds = json.loads(run.stdout)
    lift = 0.5 + 0.5 * 1.02**2
    assert velocity[2] == pytest.approx(GRAVITY * (lift - 1.0) - 0.3, rel=1e-6)
    arm, thrust = 0.043 / 2**0.5, 0.03 * GAIN / 4 * HOVER**2
    assert rates[0] == pytest.approx(2 * arm * thrust * (1.02**2 - 1.0) / 1.43e-5, rel=1e-6)
    assert speeds[0] / 60.0 * 2.0 * np.pi == pytest.approx(0.02 * HOVER / LAG, rel=1e-6)


LOG_STEP_S, FLIGHT_S = 0.01, 40.0


#: Standard deviations of height [m], velocity [m/s] and force [m/s^2] as logged.
NOISE = (0.005, 0.02, 0.3)


#: From a wanted acceleration to a command; then height, velocity and acceleration, and the same after a step.
Command = Callable[[float], float]


Measure = Callable[[], tuple[float, float, float]]


Advance = Callable[[float], None]


def identified_again(
    command: Command, measure: Measure, advance: Advance, channel: str, input_map: str
) -> dict[str, Any]:
    """Quantities of a flight under control, of what a simulator gave."""
    rng = np.random.default_rng(0)
    count = round(FLIGHT_S / LOG_STEP_S)
    wanted = altitude_reference(TrajectoryKind.MULTISINE, count=count, step_s=LOG_STEP_S, rng=rng)
    errors = rng.standard_normal((count, 3)) * NOISE
    rows = []
    for k in range(count):
        height, velocity, acceleration = np.array(measure()) + errors[k]
        correction = 6.0 * (wanted.position[k] - height) + 4.0 * (wanted.velocity[k] - velocity)
        reported = command(wanted.acceleration[k] + correction)
        rows.append((height, velocity, acceleration + GRAVITY, reported))
        advance(reported)
    logged = dict(
        zip(("position_z", "velocity_z", "specific_force_z", channel), np.array(rows).T, strict=True)
    )
    references = {
        f"reference_{name}_z": getattr(wanted, name)[:count]
        for name in ("position", "velocity", "acceleration")
    }
    time = {"time": LOG_STEP_S * np.arange(count)}
    fit = ev.identify_flight(ev.recording_from_columns(time | logged | references, input_map=input_map))
    assert fit.verdict.status.value == "identified", fit.verdict.sentences
    return dict(fit.quantities)


def holds(quantities: dict[str, Any], **truth: float) -> None:
    for name, value in truth.items():
        low, high = quantities[name].interval
        assert low <= value <= high, (name, low, value, high)
        assert high - low < 0.5 * value


@pytest.mark.thorough  # RotorPy takes a millisecond for a step
def test_rotorpy(tmp_path: Path) -> None:
    rotorpy = pytest.importorskip("rotorpy.vehicles.multirotor", reason="RotorPy is not installed")
    rest = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state: dict[str, Any] = rest | {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, HOVER)}
    vehicle = rotorpy.Multirotor(quad_params(tmp_path), state, "cmd_motor_speeds")
    selected = [HOVER]

    def measure() -> tuple[float, float, float]:
        rate = vehicle.statedot(state, {"cmd_motor_speeds": np.full(4, selected[-1])}, LOG_STEP_S)["vdot"]
        return state["x"][2], state["v"][2], rate[2]

    def advance(command: float) -> None:
        selected.append(command)
        state.update(vehicle.step(state, {"cmd_motor_speeds": np.full(4, command)}, LOG_STEP_S))

    again = identified_again(
        lambda wanted: HOVER * (1.0 + 0.5 * wanted / GRAVITY), measure, advance, "rotor_command_1", "square"
    )
    holds(again, viscous_friction=FRICTION, input_gain=GAIN, actuator_lag=LAG, hover_input=HOVER)
