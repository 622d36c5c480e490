"""Selection of channels and runs for the rigid body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from eivor.errors import InputError
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import InputFamily, Selection
from eivor.flights.timestamps import with_corrected_stamps
from eivor.motions.rates.motion import AXES, multirotor_input, refuse_degrees
from eivor.motions.rigid_body.regression import NEEDED as FOR_BODY_VELOCITY
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.vertical.select import REFERENCES as HEIGHT_REFERENCES
from eivor.signals.recording import Channel, Finding, Recording
from eivor.tools import Float

# -- Attitude order --

#: Over which turning is looked at [s]: longer than a sensor's noise, shorter than a turn.
OVER_S = 0.04
#: What is left of the rates, as a share of them: by a wrong order more than the one, by the right one less
#: than the other.
WRONG, RIGHT = 0.8, 0.5
#: Orders that attitudes are written in, by the signed place of w, x, y, z among the logged four.
ORDERS = {
    "x, y, z, w": ((3, 1), (0, 1), (1, 1), (2, 1)),
    "w, x, y, z from world to body": ((0, 1), (1, -1), (2, -1), (3, -1)),
    "x, y, z, w from world to body": ((3, 1), (0, -1), (1, -1), (2, -1)),
}
AS_NAMED = ((0, 1), (1, 1), (2, 1), (3, 1))


def refuse_other_turns(attitude: Sequence[Channel], rates: Sequence[Channel], log_name: str) -> None:
    """Refuse an attitude that turns otherwise than the gyroscope says, where another order or unit does."""
    time = attitude[0].time_s
    if len({item.values.size for item in attitude}) != 1:
        return
    logged = continuous(np.stack([item.values for item in attitude]))
    known = np.isfinite(logged).all(axis=0)
    time, logged = time[known], logged[:, known]
    if time.size < 2:
        return
    separated = max(1, round(OVER_S / float(np.median(np.diff(time)))))
    if time.size <= 2 * separated:
        return
    turned = np.stack([_turned(rate, time) for rate in rates])
    width = np.maximum(time[separated:] - time[:-separated], 1e-9)
    measured = (turned[:, separated:] - turned[:, :-separated]) / width
    size = float(np.sqrt(np.mean(measured**2)))
    if not size > 0.0:
        return

    def left(order: Sequence[tuple[int, int]]) -> float:
        parts = np.stack([sign * logged[item] for item, sign in order])
        return float(np.sqrt(np.mean((_rates_of(parts, separated) / width - measured) ** 2))) / size

    if left(AS_NAMED) <= WRONG:
        return
    by_attitude = _rates_of(logged, separated) / width
    degrees = float(np.sqrt(np.mean((by_attitude - np.deg2rad(measured)) ** 2)))
    if degrees < RIGHT * np.deg2rad(size):
        raise InputError(
            f"body rates in rad/s in {log_name}",
            f"{rates[0].name} and others that turn 57 times as fast as the attitude, which look like degrees",
            'State the unit in a channel map (unit = "deg/s").',
        )
    results = {name: left(order) for name, order in ORDERS.items()}
    best = min(results, key=lambda name: results[name])
    if results[best] < RIGHT:
        raise InputError(
            f"an attitude w, x, y, z from body to world in {log_name}",
            f"one that turns as the gyroscope says only when it is read as {best}",
            "Map its four parts in this order, with the signs that turn it from body to world.",
        )


def continuous(parts: Float[np.ndarray, "4 n"]) -> Float[np.ndarray, "4 n"]:
    """The same attitudes without jumps to the opposite quaternion, which is the same attitude."""
    known = np.flatnonzero(np.isfinite(parts).all(axis=0))
    result = parts.copy()
    if known.size > 1:
        along = (parts[:, known[1:]] * parts[:, known[:-1]]).sum(axis=0)
        result[:, known[1:]] *= np.cumprod(np.where(along < 0.0, -1.0, 1.0))
    return result


def _turned(rate: Channel, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angle by which a rate has turned at times, from some time on [rad]."""
    known = np.isfinite(rate.values)
    t, values = rate.time_s[known], rate.values[known]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.interp(time_s, t, angle)


def _rates_of(parts: Float[np.ndarray, "4 n"], separated: int) -> Float[np.ndarray, "3 m"]:
    """Small turns on the body's axes between attitudes so many samples apart [rad]."""
    (a, b, c, d), (w, x, y, z) = parts[:, :-separated], parts[:, separated:]
    return 2.0 * np.stack(
        [a * x - b * w - c * z + d * y, a * y + b * z - c * w - d * x, a * z - b * y + c * x - d * w]
    )


# -- Select --

INPUTS = (
    InputFamily("rotor_command", input_map="square", numbered=True),
    InputFamily("rotor_speed", measured=True, input_map="square", numbered=True),
)
#: What was asked of height, without the thrust command itself, and of attitude.
REFERENCES = (
    *(reference for axis in AXES for reference in axis.references),
    *(item for item in HEIGHT_REFERENCES if item.channel.startswith("reference_")),
)
#: The grid's step is that of the gyroscope, within these [s].
SHORTEST_STEP_S, LONGEST_STEP_S = 0.002, 0.010
#: All that any of the equations uses [Hz].
BAND_HZ = (0.05, 20.0)
ATTITUDE = tuple(f"attitude_{part}" for part in "wxyz")
#: Rotors that never differ by more than this share of their largest command turn nothing.
NO_DIFFERENCE = 1e-9
#: Quaternions that are further from one in length are none.
UNIT_WITHIN = 0.05


def selected(log: Recording, options: FlightOptions, vehicle: KnownVehicle) -> Selection:
    """Channels of a log by role."""
    log, erring = with_corrected_stamps(log)
    family, commands = multirotor_input(
        log,
        INPUTS,
        options.input,
        remedy="Log the rotor commands or speeds at 100 Hz or more",
        other="Name another motion with --model if you have one.",
    )
    family = replace(family, input_map=vehicle.thrust_map)
    if len(commands) != vehicle.count:
        raise InputError(
            f"{vehicle.count} rotors, as the vehicle has",
            f"{len(commands)} channels {family.name} in {log.name}",
            "Give the vehicle file of this vehicle, or map the channels of all its rotors.",
        )
    _refuse_no_differences(commands, vehicle, log)
    rates = {axis.name: log.channel(axis.rate) for axis in AXES}
    for rate in rates.values():
        refuse_degrees(rate, log)
    _refuse_no_quaternion(log)
    forces = {f"force_{axis}": log.channels.get(f"specific_force_body_{axis}") for axis in "xyz"}
    moving = all(name in log.channels for name in FOR_BODY_VELOCITY)
    tilted = all(name in log.channels for name in ATTITUDE)
    known = FOR_BODY_VELOCITY if moving else ATTITUDE if tilted else ()
    conditions = _without_flips(tuple(log.channel(name) for name in known))
    if tilted:
        refuse_other_turns([log.channel(name) for name in ATTITUDE], tuple(rates.values()), log.name)
    step_s = float(np.median(np.diff(rates["roll"].time_s)))
    return Selection(
        family,
        commands,
        states=rates,
        responses=forces,
        conditions=conditions,
        band_hz=BAND_HZ,
        findings=(*erring, *_findings(forces, moving)),
        issued_within_s=step_s,
        step_s=float(np.clip(step_s, SHORTEST_STEP_S, LONGEST_STEP_S)),
        matched_interpolation_filter=True,
    )


def _refuse_no_differences(commands: tuple[Channel, ...], vehicle: KnownVehicle, log: Recording) -> None:
    if len({command.time_s.size for command in commands}) != 1:
        return
    values = np.stack([command.values for command in commands])
    values = values[:, np.isfinite(values).all(axis=0)]
    if not values.shape[1] or not (values.max() > values.min()):
        return  # nothing varies at all, which is reported about every motion
    arms = zip(AXES, (vehicle.roll, vehicle.pitch, vehicle.yaw), strict=True)
    differences = {axis.name: np.ptp(arm / np.abs(arm).sum() @ values) for axis, arm in arms}
    least = NO_DIFFERENCE * np.abs(values).max()
    still = [name for name, difference in differences.items() if difference <= least]
    if still:
        raise InputError(
            f"rotor commands that differ about roll, pitch and yaw in {log.name}",
            f"commands that never turn it about {', '.join(still)}",
            "Log every rotor's own command, not the collective one, and fly steps of each angle.",
        )


def _without_flips(conditions: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Attitudes that can be interpolated: a quaternion and its opposite are one attitude."""
    parts = [condition for condition in conditions if condition.name in ATTITUDE]
    if len({part.time_s.tobytes() for part in parts}) != 1:
        return conditions
    rows = continuous(np.stack([part.values for part in parts]))
    smooth = {part.name: replace(part, values=row) for part, row in zip(parts, rows, strict=True)}
    return tuple(smooth.get(condition.name, condition) for condition in conditions)


def _refuse_no_quaternion(log: Recording) -> None:
    parts = [log.channels.get(f"attitude_{part}") for part in "wxyz"]
    known = [part.values for part in parts if part is not None]
    if len(known) != 4 or len({part.size for part in known}) != 1:
        return
    length = np.sqrt(sum(part * part for part in known))
    usual = float(np.nanmedian(np.abs(length - 1.0))) if length.size else 0.0
    if usual > UNIT_WITHIN:
        raise InputError(
            f"an attitude quaternion of length 1 in {log.name}",
            f"a length of {float(np.nanmedian(length)):.3g}",
            "Map its four parts w, x, y, z in this order, from body to world.",
        )


def _findings(forces: dict[str, Channel | None], moving: bool) -> Iterator[Finding]:
    if not moving:
        yield Finding(
            "no_body_velocity",
            "Velocity or attitude is not logged: no result for drag along x and y and of "
            "translational lift. Drag along z rests on the accelerometer's integral over less than 5 s.",
        )
    absent = [name.removeprefix("force_") for name, channel in forces.items() if channel is None]
    if absent:
        yield Finding("no_body_force", f"No specific force along {', '.join(absent)}: no result for it.")
