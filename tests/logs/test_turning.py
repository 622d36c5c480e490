"""What a Crazyflie's log holds of turning: torque setpoints, and what was asked of attitude and rates."""

from __future__ import annotations

import numpy as np
import pytest
from dataflash_writer import FIRMWARES, DataflashWriter
from usd_writer import fixed

import eivor as ev
from motions.turning_logs import STEP_S, Vehicle, turned

FULL = 65535.0


def test_units_and_signs(read):
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
    log = read(fixed(2, [f"{name}(f)" for name in variables], [list(variables.values())] * 3))
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


def test_the_mellinger_controller_has_a_group_of_its_own(read):
    names = ["controller.cmd_roll(f)", "ctrlMel.cmd_roll(f)"]
    log = read(fixed(2, names, [[0.0, FULL]] * 3))
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


DEG = 180.0 / np.pi
#: Signs of forward, left, up in forward, right, down.
DOWN = {"x": 1.0, "y": -1.0, "z": -1.0}
LETTERS = {"x": "R", "y": "P", "z": "Y"}
STABILIZE, SYSTEM_IDENTIFICATION = 0, 25


def turning_log(flight, mode):
    """Write turning as firmware 4.6 does with LOG_BITMASK's bit 0: RATE and ATT at 400 Hz, IMU at 25 Hz."""
    writer = DataflashWriter().text(FIRMWARES["4.6"]).parameters(SID_AXIS=10.0)
    time = flight.channels["angular_rate_x"].time_s
    writer.add("MODE", 0.0, "MBB", Mode=mode, ModeNum=mode, Rsn=1)
    writer.add("EV", [0.0, time[-1]], "B", Id=[28, 18])
    rate, gyro = {}, {}
    for letter, axis in LETTERS.items():
        turns = DOWN[letter] * flight.channels[f"angular_rate_{letter}"].values
        out = DOWN[letter] * flight.channels[f"torque_setpoint_{letter}"].values
        rate |= {f"{axis}Des": 0.0, axis: turns * DEG, f"{axis}Out": out}
        gyro[f"Gyr{letter.upper()}"] = turns[::16]
    writer.add("RATE", time, "f" * 12, **rate, ADes=0.0, A=0.0, AOut=0.4)
    writer.add("IMU", time[::16], "Bffffff", I=0, **gyro, AccX=0.0, AccY=0.0, AccZ=-9.8)
    attitude = {"AEKF": 3}
    for angle, letter in (("Roll", "x"), ("Pitch", "y"), ("Yaw", "z")):
        requested = DOWN[letter] * flight.channels[f"reference_{angle.lower()}"].values * DEG
        attitude |= {f"Des{angle}": requested, angle: 0.0}
    return writer.add("ATT", time[::8], "Bffffff", **attitude)


@pytest.mark.thorough
def test_a_short_sweep_of_the_attitude_serves_its_axis(read):
    """Half a minute with resting sticks, 15 s of a sweep of roll: pitch, which did not move, is refused."""
    time = np.arange(round(30.0 / STEP_S)) * STEP_S
    within = (time >= 10.0) & (time < 25.0)
    since = time[within] - 10.0
    swept = np.zeros((time.size, 3))
    swept[within, 0] = 0.12 * np.sin(2.0 * np.pi * (0.3 * since + 0.5 * 7.7 / 15.0 * since**2))
    flight = turned(0, command_hz=400.0, rate_hz=400.0, seconds=30.0, size=0.0, swept=swept)
    writer = turning_log(flight, SYSTEM_IDENTIFICATION)
    writer.add("SIDS", 10.0, "Bf", Ax=1, Mag=7.0)
    writer.add("SIDD", time[within], "ff", Time=since, Targ=swept[within, 0] * DEG)
    fit = ev.identify_flight(read(writer), model="rates")
    assert fit.prepared[0].usable_references == ("reference_roll",)
    assert fit.verdict.status is ev.Status.REFUSED
    assert fit.quantities["pitch_effectiveness"].verdict is ev.Status.REFUSED
    roll = fit.quantities["roll_effectiveness"]
    assert roll.verdict in {ev.Status.IDENTIFIED, ev.Status.WEAK}
    assert roll.interval[0] <= Vehicle().effectiveness[0] <= roll.interval[1]
