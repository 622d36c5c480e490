"""Setpoints of attitude and of rates in a PX4 log, told apart by who makes them.

Where the sticks set the attitude (manual, altitude and stabilized mode) its setpoint moves the vehicle and
does not answer it. In all other modes a loop computes it of the vehicle's own position or velocity. The
rate setpoint is that of the attitude loop, but in acro mode, where it is the sticks'.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from eivor.logs.ulog.instances import Topic
from eivor.logs.ulog.topics import (
    ATTITUDE_SETPOINT,
    ATTITUDE_STATES,
    NAVIGATION_STATE,
    RATE_STATES,
    RATES_SETPOINT,
)
from eivor.shapes import Bool, Float
from eivor.signals.attitude import roll_pitch_yaw

NAMES = ("roll", "pitch", "yaw")
#: A quaternion further from one in length is none.
UNIT_WITHIN = 0.05


@dataclass(frozen=True)
class SetpointSeries:
    """A channel to be made.

    Parameters
    ----------
    name : str
        Canonical.
    topic : str
        Whose stamps it has.
    values : ndarray, shape (n,)
        NaN where it is not in force.
    label : str
        The source in the log's own words.
    """

    name: str
    topic: str
    values: Float[np.ndarray, " n"]
    label: str


def attitude_setpoints(
    topics: Mapping[str, Topic], clocks: Mapping[str, Float[np.ndarray, " _"]]
) -> Iterator[SetpointSeries]:
    """Setpoints of roll, pitch and yaw, and of their rates, each where it is what its name says.

    Parameters
    ----------
    topics : mapping of str to Topic
        Of the log.
    clocks : mapping of str to ndarray
        Seconds of each topic's messages.

    Notes
    -----
    Without the navigation state every attitude is taken as computed by a loop, and no rate as the sticks'.
    """
    attitude = topics.get(ATTITUDE_SETPOINT)
    if attitude is not None:
        by_sticks = _in_states(topics, clocks, ATTITUDE_SETPOINT, ATTITUDE_STATES)
        for name, (values, field) in zip(NAMES, _angles(attitude), strict=False):
            label = f"{ATTITUDE_SETPOINT}.{field}"
            for kind, where in (("", by_sticks), ("feedback_", ~by_sticks)):
                series = np.where(where, values, np.nan)
                yield SetpointSeries(f"{kind}reference_{name}", ATTITUDE_SETPOINT, series, label)
    rates = topics.get(RATES_SETPOINT)
    if rates is not None:
        by_sticks = _in_states(topics, clocks, RATES_SETPOINT, RATE_STATES)
        for axis, name in zip("xyz", NAMES, strict=True):
            if name in rates.fields:
                series = np.where(by_sticks, rates.fields[name].astype(np.float64), np.nan)
                label = f"{RATES_SETPOINT}.{name}"
                yield SetpointSeries(f"reference_angular_rate_{axis}", RATES_SETPOINT, series, label)


def _in_states(
    topics: Mapping[str, Topic],
    clocks: Mapping[str, Float[np.ndarray, " _"]],
    topic: str,
    states: tuple[int, ...],
) -> Bool[np.ndarray, " n"]:
    """Whether the vehicle was in one of some states at each message of a topic."""
    times = clocks[topic]
    status = topics.get(NAVIGATION_STATE.topic)
    known = clocks.get(NAVIGATION_STATE.topic, np.empty(0))
    if status is None or NAVIGATION_STATE.field not in status.fields:
        return np.zeros(times.size, dtype=np.bool_)
    order = np.argsort(known, kind="stable")
    order = order[np.isfinite(known[order])]
    if not order.size:
        return np.zeros(times.size, dtype=np.bool_)
    within = np.isin(status.fields[NAVIGATION_STATE.field], states)[order]
    place = np.searchsorted(known[order], times, side="right") - 1
    return np.asarray((place >= 0) & within[np.maximum(place, 0)])


def _angles(topic: Topic) -> list[tuple[Float[np.ndarray, " n"], str]]:
    """Roll, pitch and yaw of the setpoint [rad], of its quaternion or, where it has none, of its angles."""
    fields = topic.fields
    angles = [fields.get(f"{name}_body") for name in NAMES]
    parts = [fields.get(f"q_d[{index}]") for index in range(4)]
    if not any(part is None for part in parts):
        quaternion = np.stack([part.astype(np.float64) for part in parts if part is not None])
        length = np.linalg.norm(quaternion, axis=0)
        whole = np.abs(length - 1.0) <= UNIT_WITHIN
        if whole.any():
            found = roll_pitch_yaw(np.where(whole, quaternion / np.where(whole, length, 1.0), np.nan))
            return [(angle, "q_d") for angle in found]
    if any(angle is None for angle in angles):
        return []
    return [
        (angle.astype(np.float64), f"{name}_body")
        for name, angle in zip(NAMES, angles, strict=True)
        if angle is not None
    ]
