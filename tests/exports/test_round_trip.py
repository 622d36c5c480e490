"""What was exported is flown by the simulator and identified again: the intervals hold the numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from eivor.simulation.environment import TrajectoryKind, altitude_reference
from exports.simulated import FRICTION, GAIN, GRAVITY, HOVER, LAG, quad_params, saved

STEP_S, SECONDS = 0.01, 40.0
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
    count = round(SECONDS / STEP_S)
    wanted = altitude_reference(TrajectoryKind.MULTISINE, count=count, step_s=STEP_S, rng=rng)
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
    time = {"time": STEP_S * np.arange(count)}
    fit = ev.identify_flight(ev.recording_from_columns(time | logged | references, input_map=input_map))
    assert fit.verdict.status.value == "identified", fit.verdict.sentences
    return dict(fit.quantities)


def holds(quantities: dict[str, Any], **truth: float) -> None:
    for name, value in truth.items():
        low, high = quantities[name].interval
        assert low <= value <= high, (name, low, value, high)
        assert high - low < 0.5 * value


@pytest.mark.thorough  # the climb in `test_consumers` says the same quicker
def test_mujoco(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = mujoco.MjModel.from_xml_path(saved("mujoco", tmp_path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    steps = round(STEP_S / model.opt.timestep)

    def measure() -> tuple[float, float, float]:
        mujoco.mj_forward(model, data)
        return data.qpos[2], data.qvel[2], data.qacc[2]

    def advance(record: float) -> None:
        data.ctrl[:] = record
        mujoco.mj_step(model, data, steps)

    again = identified_again(lambda wanted: 1.0 + wanted / GRAVITY, measure, advance, "input", "linear")
    holds(again, viscous_friction=FRICTION, input_gain=GRAVITY, actuator_lag=LAG, hover_input=1.0)


@pytest.mark.thorough  # RotorPy takes a millisecond for a step
def test_rotorpy(tmp_path: Path) -> None:
    rotorpy = pytest.importorskip("rotorpy.vehicles.multirotor", reason="RotorPy is not installed")
    rest = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state: dict[str, Any] = rest | {
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "rotor_speeds": np.full(4, HOVER),
    }
    vehicle = rotorpy.Multirotor(quad_params(tmp_path), state, "cmd_motor_speeds")
    selected = [HOVER]

    def measure() -> tuple[float, float, float]:
        rate = vehicle.statedot(state, {"cmd_motor_speeds": np.full(4, selected[-1])}, STEP_S)["vdot"]
        return state["x"][2], state["v"][2], rate[2]

    def advance(command: float) -> None:
        selected.append(command)
        state.update(vehicle.step(state, {"cmd_motor_speeds": np.full(4, command)}, STEP_S))

    again = identified_again(
        lambda wanted: HOVER * (1.0 + 0.5 * wanted / GRAVITY), measure, advance, "rotor_command_1", "square"
    )
    holds(again, viscous_friction=FRICTION, input_gain=GAIN, actuator_lag=LAG, hover_input=HOVER)
