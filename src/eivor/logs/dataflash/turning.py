"""Attitude, what is asked of it by a pilot or by a loop, and injected sweeps.

ATT holds angles in degrees: yaw first, then pitch, then roll. Its setpoints, and the rates' in RATE, are the
pilot's in some modes and a loop's in the others. System identification (SIDD, with the axis in SIDS.Ax) adds
a sweep: to the attitude asked for (1 to 6), to the rates asked for (7 to 9), to the torques (10 to 12), or to
the throttle (13).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.reading import Reading
from eivor.logs.dataflash.sources import (
    ATTITUDE,
    ATTITUDE_MODES,
    ATTITUDE_SETPOINTS,
    RATE_MODES,
    RATE_SETPOINTS,
)
from eivor.logs.silences import SILENCE_S
from eivor.logs.units import UNITS
from eivor.shapes import Float
from eivor.signals.recording import Finding

_DEG = UNITS["deg"][1]
#: A heading in radians that counts its turns is below.
LARGEST_ANGLE = 1e6
_ANGLES = ("roll", "pitch", "yaw")
#: What is swept, by SIDS.Ax, and what one of SIDD.Targ is in its unit.
SWEPT = {
    **{1 + n: (f"reference_{angle}", _DEG) for n, angle in enumerate(_ANGLES)},
    **{4 + n: (f"reference_{angle}", _DEG) for n, angle in enumerate(_ANGLES)},
    **{7 + n: (f"reference_angular_rate_{axis}", _DEG) for n, axis in enumerate("xyz")},
    **{10 + n: (f"injected_torque_{axis}", 1.0) for n, axis in enumerate("xyz")},
    13: ("injected_throttle", 1.0),
}


def add_attitude(reading: Reading) -> None:
    """Add the attitude as a quaternion."""
    table = reading.tables.get("ATT")
    if table is None or not table.has(*ATTITUDE) or not table.clock:
        return
    roll, pitch, yaw = (table.values(name) * _DEG for name in ATTITUDE)
    # a yaw without jumps makes a quaternion without jumps of sign
    quaternion = _quaternion(roll, pitch, _unwrapped(yaw))
    for part, values in zip("wxyz", quaternion, strict=True):
        reading.add(f"attitude_{part}", table, values, "ATT.Roll, .Pitch and .Yaw")


def _quaternion(
    roll: Float[np.ndarray, " n"], pitch: Float[np.ndarray, " n"], yaw: Float[np.ndarray, " n"]
) -> list[Float[np.ndarray, " n"]]:
    """Quaternions w, x, y, z from body to world."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(0.5 * one), np.sin(0.5 * one)) for one in (roll, pitch, yaw))
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def add_setpoints(reading: Reading) -> None:
    """Add the setpoints of attitude and of rates, told apart by who makes them."""
    wanted: list[tuple[str, str, str, tuple[int, ...]]] = [
        (f"reference_{angle}", "ATT", column, reading.with_sweeps(ATTITUDE_MODES))
        for angle, column in ATTITUDE_SETPOINTS.items()
    ]
    wanted += [
        (f"reference_angular_rate_{axis}", "RATE", column, RATE_MODES)
        for axis, column in RATE_SETPOINTS.items()
    ]
    for name, message, column, modes in wanted:
        table = reading.tables.get(message)
        if table is None or not table.has(column) or not table.clock:
            continue
        values = table.values(column) * _DEG
        if column == "DesYaw":
            values = _unwrapped(values)
        by_sticks = reading.modes_at(table, modes)
        for kind, where in (("", by_sticks), ("feedback_", ~by_sticks)):
            if where.any():
                told = values if where.all() else np.where(where, values, np.nan)
                reading.add(f"{kind}{name}", table, told, f"{message}.{column}")


def _unwrapped(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angle without the jumps of whole turns [rad]; zero where it cannot be one."""
    angle = np.where(np.abs(angle) < LARGEST_ANGLE, angle, 0.0)
    turns = np.round(np.diff(angle) / (2.0 * np.pi))
    if np.any(turns):
        angle[1:] -= 2.0 * np.pi * np.cumsum(turns)
    return angle


def add_sweeps(reading: Reading) -> None:
    """Add the injected sweeps, each where it is."""
    sweep, settings = reading.tables.get("SIDD"), reading.tables.get("SIDS")
    if sweep is None or not sweep.has("Targ") or not sweep.clock:
        return
    axes = _axes(sweep, settings, reading.parameters.get("SID_AXIS", 0.0))
    for axis in np.unique(axes).tolist():
        if axis not in SWEPT:
            reading.findings.append(
                Finding("sweep_unused", f"Sweeps of system identification on axis {axis:g} are not used.")
            )
            continue
        name, factor = SWEPT[int(axis)]
        values = np.where(axes == axis, sweep.values("Targ") * factor, np.nan)
        if name.startswith("injected"):
            _add_injection(reading, name, sweep, np.nan_to_num(values))
        else:
            reading.add(name, sweep, values, "SIDD.Targ", is_setpoint=True)


def _axes(sweep: Messages, settings: Messages | None, told: float) -> Float[np.ndarray, " n"]:
    """Axis of each sample of a sweep: by the last settings before it, else by the parameter."""
    if settings is None or not settings.has("Ax") or not settings.clock:
        return np.full(sweep.count, told)
    times = settings.time_s()
    order = np.argsort(times, kind="stable")
    place = np.searchsorted(times[order], sweep.time_s(), side="right")
    return np.asarray(np.append(told, settings.values("Ax")[order])[place])


def _add_injection(reading: Reading, name: str, sweep: Messages, values: Float[np.ndarray, " n"]) -> None:
    """Add a sweep into mixer or throttle: nothing is injected before, between and after its samples."""
    reading.add(name, sweep, values, "SIDD.Targ")
    channel = reading.channels.get(name)
    if channel is None:
        return
    ends = np.append(channel.time_s[1:], np.inf)
    last = np.flatnonzero(ends - channel.time_s > SILENCE_S)
    step = float(np.median(np.diff(channel.time_s))) if channel.time_s.size > 1 else 0.01
    time = np.insert(channel.time_s, last + 1, channel.time_s[last] + step)
    injected = np.insert(channel.values, last + 1, 0.0)
    if time[0] > 0.0:
        time, injected = np.insert(time, 0, 0.0), np.insert(injected, 0, 0.0)
    reading.channels[name] = replace(channel, time_s=time, values=injected)
