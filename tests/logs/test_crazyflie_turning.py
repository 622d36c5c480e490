"""What a Crazyflie's log holds of turning: torque setpoints, and what was asked of attitude and rates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_writer import UsdLog, fixed

from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from eivor.signals.recording import Recording
from motions.turning_logs import Vehicle, turned

FULL = 65535.0
#: Variable of the firmware, canonical channel, and its factor from the canonical value.
TURNING = (
    ("gyro.x", "angular_rate_x", 180.0 / np.pi),
    ("gyro.y", "angular_rate_y", 180.0 / np.pi),
    ("gyro.z", "angular_rate_z", 180.0 / np.pi),
    ("controller.cmd_roll", "torque_setpoint_x", FULL),
    ("controller.cmd_pitch", "torque_setpoint_y", -FULL),
    ("controller.cmd_yaw", "torque_setpoint_z", -FULL),
    ("ctrltarget.roll", "reference_roll", 180.0 / np.pi),
    ("ctrltarget.pitch", "reference_pitch", -180.0 / np.pi),
)


def read(tmp_path: Path, log: UsdLog) -> Recording:
    (tmp_path / "log03").write_bytes(log.bytes())
    return read_log(tmp_path / "log03")


def test_units_and_signs(tmp_path):
    """By the firmware's mixer: cmd_roll is for the left motors, cmd_pitch for those in front."""
    variables = {
        "controller.cmd_roll": 6553.5,
        "controller.cmd_pitch": 6553.5,
        "controller.cmd_yaw": 6553.5,
        "ctrltarget.roll": 0.0,
        "controller.roll": 90.0,
        "ctrltarget.pitch": 90.0,
        "controller.pitch": 45.0,
        "ctrltarget.yaw": 180.0,
        "controller.rollRate": 180.0,
        "controller.pitchRate": 180.0,
        "controller.yawRate": 180.0,
    }
    log = read(tmp_path, fixed(2, [f"{name}(f)" for name in variables], [list(variables.values())] * 3))
    values = {name: channel.values[0] for name, channel in log.channels.items()}
    assert values == pytest.approx(
        {
            "torque_setpoint_x": 0.1,
            "torque_setpoint_y": -0.1,  # the nose goes up: about the left axis backwards
            "torque_setpoint_z": -0.1,  # the body turns clockwise
            "feedback_reference_roll": np.pi / 2.0,  # ctrltarget.roll is zero throughout: not in use
            "reference_pitch": -np.pi / 2.0,
            "feedback_reference_pitch": -np.pi / 4.0,
            "reference_angular_rate_z": np.pi,
            "feedback_reference_angular_rate_x": np.pi,
            "feedback_reference_angular_rate_y": -np.pi,
            "feedback_reference_angular_rate_z": np.pi,
        }
    )
    assert all(channel.held for channel in log.channels.values())
    assert "reference_roll" not in values


def test_the_mellinger_controller_has_a_group_of_its_own(tmp_path):
    names = ["controller.cmd_roll(f)", "ctrlMel.cmd_roll(f)"]
    log = read(tmp_path, fixed(2, names, [[0.0, FULL]] * 3))
    assert log.channels["torque_setpoint_x"].values[0] == 1.0


def test_what_is_turned_by_the_mixer_turns_that_way():
    """The signs above against the motors' places: m1 to m4 as the firmware adds up what it is asked."""
    positions = np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    spins = np.array([-1.0, 1.0, -1.0, 1.0])  # of the reaction: m1 and m3 turn counterclockwise
    for item, motors in (
        ((1.0, 0.0, 0.0), (-0.5, -0.5, 0.5, 0.5)),
        ((0.0, -1.0, 0.0), (0.5, -0.5, -0.5, 0.5)),
        ((0.0, 0.0, -1.0), (1.0, -1.0, 1.0, -1.0)),
    ):
        thrust = np.array(motors)
        torque = (thrust @ positions[:, 1], -thrust @ positions[:, 0], thrust @ spins)
        assert np.sign(torque) == pytest.approx(np.array(item))


@pytest.mark.thorough
def test_the_rates_model_takes_such_a_log(tmp_path):
    vehicle = Vehicle()
    flight = turned(3, vehicle=vehicle, seconds=40.0, command_hz=200.0)
    clock = flight.channels["angular_rate_x"].time_s
    columns = []
    for _, name, factor in TURNING:
        channel = flight.channels[name]
        indices = np.searchsorted(channel.time_s, clock + 1e-9, side="right") - 1
        columns.append(factor * channel.values[np.maximum(indices, 0)])
    log = UsdLog()
    log.add_type(0xFFFF, "fixedFrequency", *(f"{name}(f)" for name, _, _ in TURNING))
    for second, row in zip(clock, np.column_stack(columns), strict=True):
        log.add_record(0xFFFF, 1_000_000 + round(1e6 * second), *row)
    result = identify_flight(read(tmp_path, log), model="rates")
    assert result.verdict.status is Status.IDENTIFIED
    for axis, truth in zip(("roll", "pitch"), vehicle.effectiveness, strict=False):
        assert result.quantities[f"{axis}_effectiveness"].value == pytest.approx(truth, rel=0.08)
    # the reader takes the delay of a low-pass off the gyroscope's stamps that this flight did not have
    late = read_log(tmp_path / "log03").channels["angular_rate_x"].delay_s
    assert result.quantities["effective_lag"].value + late == pytest.approx(
        vehicle.effective_lag_s, abs=0.006
    )
