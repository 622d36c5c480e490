"""Columns that are worked out of a message's own: turned velocities, setpoints in force, modes in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from eivor.shapes import Float
from eivor.signals.attitude import roll_pitch_yaw

Fields = Mapping[str, np.ndarray]

#: Modes in which a pilot flies; the thrust is the stick's; sticks set the attitude or rates.
PILOT_MODES = (
    *("MANUAL", "STABILIZED", "ALTCTL", "POSCTL", "ACRO", "RATTITUDE"),
    *("STABILIZE", "ALT_HOLD", "LOITER", "POSHOLD", "SPORT", "DRIFT", "CIRCLE"),
)
OPEN_LOOP_MODES = ("MANUAL", "STABILIZED", "RATTITUDE", "STABILIZE", "ACRO")
ATTITUDE_MODES = (*OPEN_LOOP_MODES, "ALTCTL", "ALT_HOLD", "SPORT", "DRIFT")
#: Bits of the masks of mavros that say what a setpoint leaves free.
POSITION_BITS = {"position": 1, "velocity": 8, "acceleration_or_force": 64}
RATE_BITS, NO_THRUST, NO_ATTITUDE = {"x": 1, "y": 2, "z": 4}, 64, 128
#: The frame of setpoints in the world.
LOCAL_FRAME = 1
ON_GROUND, UNKNOWN_STATE = 1, 0
#: Parts of a turn's quaternion in the order of `eivor.signals.attitude`.
_PARTS = "wxyz"


def with_derived(kind: str, fields: Fields) -> dict[str, np.ndarray]:
    """Return the columns of a topic with those that are worked out of them."""
    added = _MAKERS[kind](fields) if kind in _MAKERS else {}
    return {**fields, **added}


def _masked(values: np.ndarray, out_of_force: np.ndarray) -> Float[np.ndarray, " n"]:
    return np.where(out_of_force, np.nan, values.astype(np.float64))


def _mask(fields: Fields) -> np.ndarray | None:
    """What a setpoint leaves free, in bits; None where another definition has something else there."""
    mask = fields.get("type_mask")
    return mask if mask is not None and mask.dtype.kind in "iu" else None


def _odometry(fields: Fields) -> Fields:
    """The velocity of an odometry message, which is in the body's axes, in those of the world."""
    names = [f"pose.pose.orientation.{part}" for part in _PARTS]
    moved = [f"twist.twist.linear.{axis}" for axis in "xyz"]
    if not all(name in fields for name in (*names, *moved)):
        return {}
    w, *turn = (fields[name].astype(np.float64) for name in names)
    axis = np.stack(turn)
    body = np.stack([fields[name].astype(np.float64) for name in moved])
    norm = w**2 + np.sum(axis**2, axis=0)
    with np.errstate(all="ignore"):
        once = np.cross(axis, body, axis=0)
        world = body + 2.0 * (w * once + np.cross(axis, once, axis=0)) / norm
    return {f"twist.world.{letter}": values for letter, values in zip("xyz", world, strict=True)}


def _imu(fields: Fields) -> Fields:
    """Orientation, not a number where the driver says that it has none."""
    covariance = fields.get("orientation_covariance[0]")
    names = [f"orientation.{part}" for part in _PARTS]
    if covariance is None or not all(name in fields for name in names):
        return {}
    absent = (covariance == -1.0) | (sum(np.abs(fields[name]) for name in names) == 0.0)
    return {name: _masked(fields[name], absent) for name in names}


def _position_target(fields: Fields) -> Fields:
    mask, frame = _mask(fields), fields.get("coordinate_frame")
    if mask is None or frame is None:
        return {}
    return {
        f"{stem}.{axis}": _masked(
            fields[f"{stem}.{axis}"], ((mask & (bit << place)) != 0) | (frame != LOCAL_FRAME)
        )
        for stem, bit in POSITION_BITS.items()
        for place, axis in enumerate("xyz")
        if f"{stem}.{axis}" in fields
    }


def _attitude_target(fields: Fields) -> Fields:
    mask = _mask(fields)
    names = [f"orientation.{part}" for part in _PARTS]
    rates = [f"body_rate.{axis}" for axis in RATE_BITS]
    if mask is None or not all(name in fields for name in (*names, *rates, "thrust")):
        return {}
    free = (mask & NO_ATTITUDE) != 0
    turn = np.stack([_masked(fields[name], free) for name in names])
    with np.errstate(all="ignore"):
        length = np.linalg.norm(turn, axis=0)
        angles = roll_pitch_yaw(np.where(length > 0.5, turn / length, np.nan))
    made = {name: np.asarray(one) for name, one in zip(("roll", "pitch", "yaw"), angles, strict=True)}
    made["thrust"] = _masked(fields["thrust"], (mask & NO_THRUST) != 0)
    for axis, bit in RATE_BITS.items():
        made[f"body_rate.{axis}"] = _masked(fields[f"body_rate.{axis}"], (mask & bit) != 0)
    return made


def _state(fields: Fields) -> Fields:
    modes = fields.get("mode")
    if modes is None or modes.dtype.kind != "S":
        return {}
    known = {
        "pilot_in_control": PILOT_MODES,
        "input_open_loop": OPEN_LOOP_MODES,
        "pilot_sets_attitude": ATTITUDE_MODES,
    }
    return {
        name: np.isin(modes, [mode.encode() for mode in which]).astype(np.float64)
        for name, which in known.items()
    }


def _extended_state(fields: Fields) -> Fields:
    state = fields.get("landed_state")
    return {} if state is None else {"landed": _masked(state == ON_GROUND, state == UNKNOWN_STATE)}


_MAKERS: Mapping[str, Callable[[Fields], Fields]] = {
    "nav_msgs/Odometry": _odometry,
    "sensor_msgs/Imu": _imu,
    "mavros_msgs/PositionTarget": _position_target,
    "mavros_msgs/AttitudeTarget": _attitude_target,
    "mavros_msgs/State": _state,
    "mavros_msgs/ExtendedState": _extended_state,
}
