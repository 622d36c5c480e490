"""Files of simulators: loaded and flown by their programs, and identified again."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from exports.documents import GAIN, GRAVITY, HOVER, LAG, climb, quad_params, saved

STEP, SECONDS = 1.02, 1.0


def flown(parameters, command):
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
def test_rotorpy_climbs_and_lags_as_the_flight_did(tmp_path):
    pytest.importorskip("rotorpy", reason="RotorPy is not installed")
    parameters = quad_params(tmp_path)
    rate, speeds = flown(parameters, STEP * HOVER)
    assert rate == pytest.approx(climb(STEP, SECONDS), rel=0.01)
    left = (STEP - speeds / HOVER) / (STEP - 1.0)
    assert 0.1 / -np.log(left[10]) == pytest.approx(LAG, abs=0.002)
    assert flown(parameters, HOVER)[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.thorough  # of the extra `simulators`
def test_mujoco_climbs_as_the_flight_did(tmp_path):
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
def test_drone_models_accelerate_as_the_flight_says(tmp_path):
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
