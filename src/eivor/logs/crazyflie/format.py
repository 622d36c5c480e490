"""Crazyflie microSD logs as a row of the table of formats: how one is told, and what the card should log."""

from __future__ import annotations

from pathlib import Path

from eivor.logs.crazyflie.header import MAGIC
from eivor.logs.log_format import LogFormat, ReadOptions
from eivor.signals.recording import Recording

#: Variables that make each channel, as config.txt names them.
TO_LOG = {
    "velocity_z": "stateEstimate.vz",
    "position_z": "stateEstimate.z",
    "acceleration_z": "stateEstimate.az",
    "input": "motor.m1 to motor.m4",
    "reference_position_z": "ctrltarget.z",
    "reference_velocity_z": "ctrltarget.vz",
    "reference_acceleration_z": "ctrltarget.az",
    "battery_voltage": "pm.vbat",
    **{f"specific_force_body_{axis}": f"acc.{axis}" for axis in "xyz"},
    **{f"angular_rate_{axis}": f"gyro.{axis}" for axis in "xyz"},
    **{f"attitude_{part}": f"stateEstimate.q{part}" for part in "wxyz"},
    "cos_tilt": "stateEstimate.qw, .qx, .qy and .qz",
    **{f"rotor_command_{rotor}": f"motor.m{rotor}" for rotor in range(1, 5)},
    **{f"rotor_speed_{rotor}": f"rpm.m{rotor}" for rotor in range(1, 5)},
    **{
        f"torque_setpoint_{axis}": f"controller.cmd_{angle}"
        for axis, angle in zip("xyz", ("roll", "pitch", "yaw"), strict=True)
    },
    "reference_roll": "ctrltarget.roll",
    "reference_pitch": "ctrltarget.pitch",
    "reference_angular_rate_z": "ctrltarget.yaw",
}
_ADVICE = (
    "Name these variables below 'on:fixedFrequency' in config.txt on the card: stateEstimate.z, .vz and .az, "
    "stateEstimate.qw, .qx, .qy and .qz, ctrltarget.z, .vz and .az, motor.m1 to .m4, acc.x, .y and .z, "
    "gyro.x, .y and .z, pm.vbat, each with its group and on a line of its own.",
    "Log at 250 Hz or more, synchronous with the stabilizer (mode 1), with a buffer of 4096 bytes or more, "
    "and end the logging before the power goes (usd.logging = 0).",
    "Fly height steps with the position controller, so that ctrltarget.z changes: a hover cannot be "
    "identified.",
)


def _sniff(head: bytes, _file: Path) -> bool:
    """Whether a version of one byte follows the first one, which no text has."""
    return head.startswith(MAGIC) and head[2:3] in (b"", b"\x00")


def _read(file: Path, options: ReadOptions) -> Recording:
    from eivor.logs.crazyflie.reader import read_crazyflie

    return read_crazyflie(file, options)


def _advice(channel: str) -> tuple[str, ...]:
    """What to name in config.txt."""
    if not channel:
        return _ADVICE
    if channel not in TO_LOG:
        return ()
    sentence = f"Add {TO_LOG[channel]} to config.txt on the card."
    return (sentence, *_ADVICE[:1]) if channel == "velocity_z" else (sentence,)


CRAZYFLIE = LogFormat(
    "crazyflie",
    "Crazyflie microSD",
    _sniff,
    _read,
    takes_map=True,
    advice=_advice,
    setpoints="ctrltarget.z, ctrltarget.vz and ctrltarget.az (the height reference and its feed-forward), "
    "motor.m1 to motor.m4 (the commands); of turning ctrltarget.roll, .pitch and .yaw, and "
    "controller.cmd_roll, .cmd_pitch and .cmd_yaw.",
)
