"""Attitude, what is asked of it by a pilot or by a loop, and injected sweeps.

ATT holds angles in degrees: yaw first, then pitch, then roll. Its setpoints, and the rates' in RATE, are the
pilot's in some modes and a loop's in the others. System identification (SIDD, with the axis in SIDS.Ax) adds
a sweep: to the attitude asked for (1 to 6), to the rates asked for (7 to 9), to the torques (10 to 12), or to
the throttle (13).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from eivor.linalg.row_blocks import PASSED_ROWS, row_blocks
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
from eivor.shapes import Bool, Float
from eivor.signals.recording import Channel, Finding, clean_channel

_DEG = UNITS["deg"][1]
#: Of which functions of half of roll, pitch and yaw the two products are that each part is the sum of, or the
#: difference (x and z).
_COS, _SIN = (np.cos, np.sin), (np.sin, np.cos)
_FACTORS = {
    "w": (_COS, _COS, _COS),
    "x": (_SIN, _COS, _COS),
    "y": (_COS, _SIN, _COS),
    "z": (_COS, _COS, _SIN),
}
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
    for part in "wxyz":
        reading.add_made(
            f"attitude_{part}", table, partial(_quaternion, table, part), "ATT.Roll, .Pitch and .Yaw"
        )


def _quaternion(table: Messages, part: str) -> Float[np.ndarray, " n"]:
    """Part w, x, y or z of the quaternion from body to world."""
    made = _yaw(table)
    others = [(table.stored(name), table.layout.fields[name].factor * _DEG) for name in ("Roll", "Pitch")]
    for start, stop in row_blocks(0, table.count, PASSED_ROWS):
        angles = [factor * stored[start:stop].astype(np.float64) for stored, factor in others]
        halves = [0.5 * angle for angle in (*angles, made[start:stop])]
        first, second = (
            np.prod([of(half) for of, half in zip(functions, halves, strict=True)], axis=0)
            for functions in zip(*_FACTORS[part], strict=True)
        )
        made[start:stop] = first + second if part in "wy" else first - second
    return made


def _yaw(table: Messages) -> Float[np.ndarray, " n"]:
    """Yaw without jumps [rad], which makes a quaternion without jumps of sign."""
    yaw = table.values("Yaw")
    yaw *= _DEG
    return _unwrapped(yaw)


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
        by_sticks = reading.modes_at(table, modes)
        for kind, where in (("", by_sticks), ("feedback_", ~by_sticks)):
            if where.any():
                told = partial(_setpoint, table, column, None if where.all() else where)
                reading.add_made(f"{kind}{name}", table, told, f"{message}.{column}")


def _setpoint(table: Messages, column: str, where: Bool[np.ndarray, " n"] | None) -> Float[np.ndarray, " n"]:
    """Setpoint [rad, rad/s], and no value where it is of another kind; None where it is not."""
    values = table.values(column)
    values *= _DEG
    values = _unwrapped(values) if column == "DesYaw" else values
    if where is not None:
        values[~where] = np.nan
    return values


def _unwrapped(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Take the jumps of whole turns out of an angle [rad], in place; zero where it cannot be one."""
    angle[~((angle > -LARGEST_ANGLE) & (angle < LARGEST_ANGLE))] = 0.0
    turns = np.diff(angle)
    turns /= 2.0 * np.pi
    np.round(turns, out=turns)
    if np.any(turns):
        np.cumsum(turns, out=turns)
        turns *= 2.0 * np.pi
        angle[1:] -= turns
    return angle


def add_sweeps(reading: Reading) -> None:
    """Add the injected sweeps, each where it is."""
    sweep, settings = reading.tables.get("SIDD"), reading.tables.get("SIDS")
    if sweep is None or not sweep.has("Targ") or not sweep.clock:
        return
    axes = _axes(sweep, settings, reading.parameters.get("SID_AXIS", 0.0))
    present = np.unique(axes).tolist()
    for axis in present:
        if axis not in SWEPT:
            sentence = f"Sweeps of system identification on axis {axis:g} are not used."
            reading.findings.append(Finding("sweep_unused", sentence))
    for name, factor in dict.fromkeys(SWEPT[axis] for axis in present if axis in SWEPT):
        swept = np.isin(axes, [axis for axis, (of, _) in SWEPT.items() if of == name])
        _add_sweep(reading, name, sweep, np.where(swept, sweep.values("Targ") * factor, 0.0))


def _axes(sweep: Messages, settings: Messages | None, told: float) -> Float[np.ndarray, " n"]:
    """Axis of each sample of a sweep: by the last settings before it, else by the parameter."""
    if settings is None or not settings.has("Ax") or not settings.clock:
        return np.full(sweep.count, told)
    times = settings.time_s()
    order = np.argsort(times, kind="stable")
    place = np.searchsorted(times[order], sweep.time_s(), side="right")
    return np.asarray(np.append(told, settings.values("Ax")[order])[place])


def _add_sweep(reading: Reading, name: str, sweep: Messages, values: Float[np.ndarray, " n"]) -> None:
    """Add a sweep: beside its samples nothing is injected, and sticks ask for what they do."""
    asked = reading.channels.get(name)
    reading.add(name, sweep, np.nan_to_num(values), "SIDD.Targ")
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
    channel = replace(channel, time_s=time, values=injected)
    reading.keep(channel if asked is None else _beside(asked, channel))


def _beside(asked: Channel, sweep: Channel) -> Channel:
    """What sticks ask for, and in its place a sweep where there is one; zero where there is neither."""
    place = np.searchsorted(sweep.time_s, asked.time_s, side="right") - 1
    rests = (place < 0) | (sweep.values[np.maximum(place, 0)] == 0.0)
    moves = np.flatnonzero(sweep.values != 0.0)
    time = np.concatenate([asked.time_s[rests], sweep.time_s[moves]])
    values = np.concatenate([np.nan_to_num(asked.values[rests]), sweep.values[moves]])
    order = np.argsort(time, kind="stable")
    return clean_channel(
        sweep.name, time[order], values[order], sweep.unit, source=sweep.source, held=sweep.held
    )
