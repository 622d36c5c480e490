"""Channels of a Crazyflie log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eivor.logs.channel_map import ChannelRule, Expression, parse_expression, tilt_of_angles
from eivor.logs.common import UNITS, low_pass_delay_s, noted
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


def _source(
    name: str,
    column: str,
    factor: float = 1.0,
    *,
    quantity: str = "",
    estimated: bool = False,
    low_pass_hz: float = 0.0,
    zero_is_absent: bool = True,
) -> VariableSource:
    """Source of a channel in one variable."""
    rule = ChannelRule(
        name,
        Expression.of_column(column),
        factor,
        held=held_by_default(name),
        estimated=estimated,
        delay_s=low_pass_delay_s(low_pass_hz) if low_pass_hz else 0.0,
    )
    return VariableSource(quantity or name, (rule,), zero_is_absent)


def _set(name: str, *variables: tuple[str, float]) -> Iterator[VariableSource]:
    """Sources of a command or a setpoint, whose zeros are values."""
    for column, factor in variables:
        yield _source(name, column, factor, zero_is_absent=False)


def _quaternion(*columns: str, text: str = "") -> VariableSource:
    """Attitude of four columns w, x, y, z."""
    expressions = (Expression(text or column, (column,), (column,)) for column in columns)
    rules = (ChannelRule(f"attitude_{part}", item) for part, item in zip("wxyz", expressions, strict=True))
    return VariableSource("attitude", tuple(rules))


def _angles(group: str) -> VariableSource:
    """Attitude of yaw, negated pitch and roll [deg], in this order."""
    half = {
        f"{kind}{axis}": f'{function}("{group}.{angle}" * {sign}{np.pi / 360.0!r})'
        for kind, function in (("c", "cos"), ("s", "sin"))
        for axis, angle, sign in (("r", "roll", ""), ("p", "pitch", "-"), ("y", "yaw", ""))
    }
    reported = f"{group}.roll, .pitch and .yaw"
    texts = {
        "w": "{cr} * {cp} * {cy} + {sr} * {sp} * {sy}",
        "x": "{sr} * {cp} * {cy} - {cr} * {sp} * {sy}",
        "y": "{cr} * {sp} * {cy} + {sr} * {cp} * {sy}",
        "z": "{cr} * {cp} * {sy} - {sr} * {sp} * {cy}",
    }
    rules = (
        ChannelRule(f"attitude_{part}", replace(parse_expression(text.format(**half), group), text=reported))
        for part, text in texts.items()
    )
    return VariableSource("attitude", tuple(rules))


def _tilt(group: str) -> VariableSource:
    columns = (f"{group}.roll", f"{group}.pitch")
    expression = replace(tilt_of_angles(UNITS["deg"][1], *columns), text=f"{group}.roll and .pitch")
    rule = ChannelRule("cos_tilt", expression, angles=columns, angle_unit="deg")
    return VariableSource("attitude", (rule,))


_G, _DEG, _MILLI = UNITS["g"][1], UNITS["deg"][1], 1e-3
#: Of each axis the letter, the firmware's name, and the signs of its angles and of its torques.
_TURNING = (("x", "roll", 1.0, 1.0), ("y", "pitch", -1.0, -1.0), ("z", "yaw", 1.0, -1.0))

#: Groups of the estimator's variables, and what one of them is in SI units.
_STATES = (("stateEstimate", 1.0), ("stateEstimateZ", _MILLI))

#: All sources; of one quantity the preferred first.
SOURCES: tuple[VariableSource, ...] = (
    *(
        _source(f"position_{axis}", f"{group}.{axis}", factor, estimated=True)
        for axis in "xyz"
        for group, factor in _STATES
    ),
    _source("position_z", "kalman.stateZ", estimated=True),
    _source("position_z", "locSrv.z"),
    *(
        _source(f"velocity_{axis}", f"{group}.v{axis}", factor, estimated=True)
        for axis in "xyz"
        for group, factor in _STATES
    ),
    # the accelerometer's along z, turned by the estimator and as late as it was
    *(
        _source(name, column, factor, quantity="acceleration", estimated=True, low_pass_hz=ACCELEROMETER_HZ)
        for name, column, factor in (
            ("acceleration_z", "stateEstimate.az", _G),
            ("specific_force_z", "stateEstimateZ.az", _MILLI),
        )
    ),
    *(
        _source(f"specific_force_body_{axis}", f"acc.{axis}", _G, low_pass_hz=ACCELEROMETER_HZ)
        for axis in "xyz"
    ),
    _quaternion(*(f"stateEstimate.q{part}" for part in "wxyz")),
    _quaternion(UNPACKED[3], *UNPACKED[:3], text=PACKED_QUATERNION),
    _quaternion(*(f"kalman.q{number}" for number in range(4))),
    _angles("stateEstimate"),
    _angles("stabilizer"),
    _tilt("stateEstimate"),
    _tilt("stabilizer"),
    *(_source(f"angular_rate_{axis}", f"gyro.{axis}", _DEG, low_pass_hz=GYRO_HZ) for axis in "xyz"),
    *(
        _source(f"angular_rate_{axis}", f"stateEstimateZ.rate{name}", sign * _MILLI, low_pass_hz=GYRO_HZ)
        for axis, name, sign in (("x", "Roll", 1.0), ("y", "Pitch", -1.0), ("z", "Yaw", 1.0))
    ),
    *(
        _source(f"rotor_command_{rotor}", f"motor.m{rotor}", 1.0 / FULL_POWER, zero_is_absent=False)
        for rotor in range(1, 5)
    ),
    *(_source(f"rotor_speed_{rotor}", f"rpm.m{rotor}", UNITS["rpm"][1]) for rotor in range(1, 5)),
    *_set("input", ("controller.cmd_thrust", 1.0 / FULL_POWER), ("stabilizer.thrust", 1.0 / FULL_POWER)),
    _source("battery_voltage", "pm.vbat"),
    _source("battery_voltage", "pm.vbatMV", _MILLI),
    *_set("reference_position_z", ("ctrltarget.z", 1.0), ("ctrltargetZ.z", _MILLI), ("posCtl.targetZ", 1.0)),
    *_set("reference_velocity_z", ("ctrltarget.vz", 1.0), ("ctrltargetZ.vz", _MILLI)),
    *_set("reference_acceleration_z", ("ctrltarget.az", 1.0), ("ctrltargetZ.az", _MILLI)),
    *_set("feedback_reference_velocity_z", ("posCtl.targetVZ", 1.0)),
    # of turning, zeros throughout are those of a loop that is not in use
    *(
        _source(f"torque_setpoint_{letter}", f"{group}.cmd_{angle}", sign / FULL_POWER)
        for letter, angle, _, sign in _TURNING
        for group in ("controller", "ctrlMel")
    ),
    *(
        _source(f"{kind}reference_{angle}", f"{group}.{angle}", sign * _DEG)
        for _, angle, sign, _ in _TURNING[:2]
        for kind, group in (("", "ctrltarget"), ("feedback_", "controller"))
    ),
    _source("reference_angular_rate_z", "ctrltarget.yaw", _DEG),
    *(
        _source(f"feedback_reference_angular_rate_{letter}", f"controller.{angle}Rate", sign * _DEG)
        for letter, angle, sign, _ in _TURNING
    ),
)

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
