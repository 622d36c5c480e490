"""Channels of a Crazyflie log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eivor.logs.channel_map import ChannelRule, Expression, parse_expression, tilt_of_angles
from eivor.logs.common import UNITS, low_pass_delay_s, noted, source_tables
from eivor.signals.channels import held_by_default
from eivor.signals.recording import Channel, Finding
from eivor.tools import Float

#: Value of a motor's duty cycle, and of the controllers' thrust, at full power.
FULL_POWER = 65535.0
#: Cutoffs of the low-passes behind which the sensors are [Hz].
ACCELEROMETER_HZ = 30.0
GYRO_HZ = 80.0

#: A quaternion in 32 bits, and the names of its parts once it is unpacked.
PACKED_QUATERNION = "stateEstimateZ.quat"
UNPACKED = tuple(f"{PACKED_QUATERNION}.{part}" for part in "xyzw")

#: Setpoints of the velocity, which old firmware overwrites with its feedback, and of the height beside them.
VELOCITY_SETPOINTS = {"ctrltarget.vz": "ctrltarget.z", "ctrltargetZ.vz": "ctrltargetZ.z"}


@dataclass(frozen=True, slots=True)
class VariableSource:
    """One place where a quantity may be."""

    quantity: str
    rules: tuple[ChannelRule, ...]
    zero_is_absent: bool = True

    @property
    def columns(self) -> tuple[str, ...]:
        """Variables that it needs."""
        return tuple(dict.fromkeys(column for rule in self.rules for column in rule.expression.columns))


#: What one of a variable's unit is in SI units.
_UNITS = {"": 1.0, "milli": 1e-3, "power": 1.0 / FULL_POWER} | {
    unit: UNITS[unit][1] for unit in ("g", "deg", "rpm")
}


def _source(row: Mapping[str, Any]) -> VariableSource:
    name, low_pass_hz = row["channel"], row.get("low_pass_hz", 0.0)
    rule = ChannelRule(
        name,
        Expression.of_column(row["variable"]),
        row.get("sign", 1.0) * _UNITS[row.get("unit", "")],
        held=held_by_default(name),
        estimated=row.get("estimated", False),
        delay_s=low_pass_delay_s(low_pass_hz) if low_pass_hz else 0.0,
    )
    return VariableSource(row.get("quantity", name), (rule,), row.get("zero_is_absent", True))


def _quaternion(columns: Sequence[str]) -> VariableSource:
    texts = (PACKED_QUATERNION if column in UNPACKED else column for column in columns)
    expressions = (Expression(text, (name,), (name,)) for text, name in zip(texts, columns, strict=True))
    rules = (ChannelRule(f"attitude_{part}", item) for part, item in zip("wxyz", expressions, strict=True))
    return VariableSource("attitude", tuple(rules))


def _angles(group: str) -> VariableSource:
    """Attitude of yaw, negated pitch and roll [deg], in this order."""
    half = {
        f"{kind}{axis}": f'{function}("{group}.{angle}" * {sign}{np.pi / 360.0!r})'
        for kind, function in (("c", "cos"), ("s", "sin"))
        for axis, angle, sign in (("r", "roll", ""), ("p", "pitch", "-"), ("y", "yaw", ""))
    }
    attitude_words = f"{group}.roll, .pitch and .yaw"
    texts = {
        "w": "{cr} * {cp} * {cy} + {sr} * {sp} * {sy}",
        "x": "{sr} * {cp} * {cy} - {cr} * {sp} * {sy}",
        "y": "{cr} * {sp} * {cy} + {sr} * {cp} * {sy}",
        "z": "{cr} * {cp} * {sy} - {sr} * {sp} * {cy}",
    }
    rules = (
        ChannelRule(
            f"attitude_{part}", replace(parse_expression(text.format(**half), group), text=attitude_words)
        )
        for part, text in texts.items()
    )
    return VariableSource("attitude", tuple(rules))


def _tilt(group: str) -> VariableSource:
    columns = (f"{group}.roll", f"{group}.pitch")
    expression = replace(tilt_of_angles(UNITS["deg"][1], *columns), text=f"{group}.roll and .pitch")
    rule = ChannelRule("cos_tilt", expression, angles=columns, angle_unit="deg")
    return VariableSource("attitude", (rule,))


_MAKERS: Mapping[str, Callable[[Any], VariableSource]] = {
    "quaternion": _quaternion,
    "angles": _angles,
    "tilt": _tilt,
}


def _sources() -> Iterator[VariableSource]:
    for row in source_tables("eivor.logs.crazyflie")["sources"]:
        kind = next((kind for kind in _MAKERS if kind in row), "")
        yield _MAKERS[kind](row[kind]) if kind else _source(row)


#: All sources; of one quantity the preferred first.
SOURCES = tuple(_sources())

#: What was looked for, by channel.
LOOKED_FOR = {
    name: tuple(rule.expression.text for source in SOURCES for rule in source.rules if rule.name == name)
    for name in dict.fromkeys(rule.name for source in SOURCES for rule in source.rules)
}


def delay_findings(channels: Iterable[Channel]) -> list[Finding]:
    """Say what was taken off the stamps of variables that are behind a low-pass."""
    selected = []
    for cutoff in (ACCELEROMETER_HZ, GYRO_HZ):
        late = [channel.source for channel in channels if channel.delay_s == low_pass_delay_s(cutoff)]
        if late:
            delay_ms = 1e3 * low_pass_delay_s(cutoff)
            selected.append(f"{', '.join(late)}: {delay_ms:.2g} ms (low-pass of {cutoff:g} Hz)")
    return noted("sensor_delay", "Taken off the stamps, as the firmware filters: {}.", "; ".join(selected))


def unpacked_quaternion(packed: Float[np.ndarray, " n"]) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the parts of quaternions in 32 bits, by the names of `UNPACKED`."""
    sound = (packed > 0.0) & (packed < 2.0**32)
    bits = np.where(sound, packed, 0.0).astype(np.uint32)
    largest = bits >> 30
    parts = np.zeros((4, bits.size))
    for item in (3, 2, 1, 0):
        stored = largest != item
        size = np.sqrt(0.5) * (bits & 511) / 511.0
        parts[item] = np.where(stored, np.where(bits & 512, -size, size), 0.0)
        bits = np.where(stored, bits >> 10, bits)
    rest = np.sqrt(np.maximum(1.0 - np.sum(parts**2, axis=0), 0.0))
    parts[largest, np.arange(bits.size)] = rest
    parts[:, ~sound] = np.nan
    return dict(zip(UNPACKED, parts, strict=True))
