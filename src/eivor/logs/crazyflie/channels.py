"""Channels of a Crazyflie log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eivor.logs.channel_map import ChannelRule, Expression, parse_expression, tilt_of_angles
from eivor.logs.common import UNITS, low_pass_delay_s
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


def _rule(
    name: str, column: str, factor: float, *, estimated: bool = False, low_pass_hz: float = 0.0
) -> ChannelRule:
    return ChannelRule(
        name,
        Expression.of_column(column),
        factor,
        held=held_by_default(name),
        estimated=estimated,
        delay_s=low_pass_delay_s(low_pass_hz) if low_pass_hz else 0.0,
    )


def _estimates(name: str, *variables: tuple[str, float]) -> Iterator[VariableSource]:
    """Sources of a channel that the estimator makes."""
    for column, factor in variables:
        yield VariableSource(name, (_rule(name, column, factor, estimated=True),))


def _turned(name: str, column: str, factor: float) -> VariableSource:
    """Acceleration along z: the accelerometer's, turned by the estimator and as late as it was."""
    rule = _rule(name, column, factor, estimated=True, low_pass_hz=ACCELEROMETER_HZ)
    return VariableSource("acceleration", (rule,))


def _measured(name: str, column: str, factor: float, low_pass_hz: float = 0.0) -> VariableSource:
    return VariableSource(name, (_rule(name, column, factor, low_pass_hz=low_pass_hz),))


def _set(name: str, *variables: tuple[str, float]) -> Iterator[VariableSource]:
    """Sources of a command or a setpoint, whose zeros are values."""
    for column, factor in variables:
        yield VariableSource(name, (_rule(name, column, factor),), zero_is_absent=False)


def _quaternion(*columns: str) -> VariableSource:
    """Attitude of four columns w, x, y, z."""
    rules = (_rule(f"attitude_{part}", name, 1.0) for part, name in zip("wxyz", columns, strict=True))
    return VariableSource("attitude", tuple(rules))


def _packed() -> VariableSource:
    """Attitude of the quaternion in 32 bits."""
    x, y, z, w = UNPACKED
    rules = _quaternion(w, x, y, z).rules
    selected = (replace(rule.expression, text=PACKED_QUATERNION) for rule in rules)
    return VariableSource(
        "attitude", tuple(replace(rule, expression=item) for rule, item in zip(rules, selected, strict=True))
    )


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
    return VariableSource(
        "attitude",
        tuple(
            ChannelRule(
                f"attitude_{part}", replace(parse_expression(text.format(**half), group), text=reported)
            )
            for part, text in texts.items()
        ),
    )


def _tilt(group: str) -> VariableSource:
    columns = (f"{group}.roll", f"{group}.pitch")
    expression = replace(tilt_of_angles(UNITS["deg"][1], *columns), text=f"{group}.roll and .pitch")
    rule = ChannelRule("cos_tilt", expression, angles=columns, angle_unit="deg")
    return VariableSource("attitude", (rule,))


def _parsed(name: str, *variables: tuple[str, float]) -> Iterator[VariableSource]:
    """Sources of what is asked of turning: zeros throughout are those of a loop that is not in use."""
    for column, factor in variables:
        yield _measured(name, column, factor)


_G, _DEG, _MILLI = UNITS["g"][1], UNITS["deg"][1], 1e-3
#: Of each axis the letter, the firmware's name, and the signs of its angles and of its torques.
_TURNING = (("x", "roll", 1.0, 1.0), ("y", "pitch", -1.0, -1.0), ("z", "yaw", 1.0, -1.0))

#: All sources; of one quantity the preferred first.
SOURCES: tuple[VariableSource, ...] = (
    *(
        _estimate
        for axis in "xy"
        for _estimate in _estimates(
            f"position_{axis}", (f"stateEstimate.{axis}", 1.0), (f"stateEstimateZ.{axis}", _MILLI)
        )
    ),
    *_estimates("position_z", ("stateEstimate.z", 1.0), ("stateEstimateZ.z", _MILLI), ("kalman.stateZ", 1.0)),
    _measured("position_z", "locSrv.z", 1.0),
    *(
        source
        for axis in "xyz"
        for source in _estimates(
            f"velocity_{axis}", (f"stateEstimate.v{axis}", 1.0), (f"stateEstimateZ.v{axis}", _MILLI)
        )
    ),
    _turned("acceleration_z", "stateEstimate.az", _G),
    _turned("specific_force_z", "stateEstimateZ.az", _MILLI),
    *(_measured(f"specific_force_body_{axis}", f"acc.{axis}", _G, ACCELEROMETER_HZ) for axis in "xyz"),
    _quaternion(*(f"stateEstimate.q{part}" for part in "wxyz")),
    _packed(),
    _quaternion(*(f"kalman.q{number}" for number in range(4))),
    _angles("stateEstimate"),
    _angles("stabilizer"),
    _tilt("stateEstimate"),
    _tilt("stabilizer"),
    *(_measured(f"angular_rate_{axis}", f"gyro.{axis}", _DEG, GYRO_HZ) for axis in "xyz"),
    *(
        _measured(f"angular_rate_{axis}", f"stateEstimateZ.rate{angle}", sign * _MILLI, GYRO_HZ)
        for axis, angle, sign in (("x", "Roll", 1.0), ("y", "Pitch", -1.0), ("z", "Yaw", 1.0))
    ),
    *(
        source
        for rotor in range(1, 5)
        for source in _set(f"rotor_command_{rotor}", (f"motor.m{rotor}", 1.0 / FULL_POWER))
    ),
    *(_measured(f"rotor_speed_{rotor}", f"rpm.m{rotor}", UNITS["rpm"][1]) for rotor in range(1, 5)),
    *_set("input", ("controller.cmd_thrust", 1.0 / FULL_POWER), ("stabilizer.thrust", 1.0 / FULL_POWER)),
    _measured("battery_voltage", "pm.vbat", 1.0),
    _measured("battery_voltage", "pm.vbatMV", _MILLI),
    *_set("reference_position_z", ("ctrltarget.z", 1.0), ("ctrltargetZ.z", _MILLI), ("posCtl.targetZ", 1.0)),
    *_set("reference_velocity_z", ("ctrltarget.vz", 1.0), ("ctrltargetZ.vz", _MILLI)),
    *_set("reference_acceleration_z", ("ctrltarget.az", 1.0), ("ctrltargetZ.az", _MILLI)),
    *_set("feedback_reference_velocity_z", ("posCtl.targetVZ", 1.0)),
    *(
        source
        for letter, angle, _, sign in _TURNING
        for source in _parsed(
            f"torque_setpoint_{letter}",
            *((f"{group}.cmd_{angle}", sign / FULL_POWER) for group in ("controller", "ctrlMel")),
        )
    ),
    *(
        source
        for _, angle, sign, _ in _TURNING[:2]
        for source in (
            *_parsed(f"reference_{angle}", (f"ctrltarget.{angle}", sign * _DEG)),
            *_parsed(f"feedback_reference_{angle}", (f"controller.{angle}", sign * _DEG)),
        )
    ),
    *_parsed("reference_angular_rate_z", ("ctrltarget.yaw", _DEG)),
    *(
        source
        for letter, angle, sign, _ in _TURNING
        for source in _parsed(
            f"feedback_reference_angular_rate_{letter}", (f"controller.{angle}Rate", sign * _DEG)
        )
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
    if not selected:
        return []
    return [Finding("sensor_delay", f"Taken off the stamps, as the firmware filters: {'; '.join(selected)}.")]


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
