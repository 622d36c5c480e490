"""Topics of mavros, and plain messages of ROS, as channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from eivor.errors import InputError
from eivor.logs.bags.derived import with_derived
from eivor.logs.bags.ros_sources import CHANNEL_SOURCES, MAVROS, RosSource
from eivor.logs.bags.topics import BagTopic, RawTopic, as_columns, of_one_clock, start_ns
from eivor.logs.silences import silenced
from eivor.signals.canonical import CurveSide, held_by_default, unit_of
from eivor.signals.recording import Channel, Finding, clean_channel

#: The velocity as it stands is taken, not turned, where its way [s] fits the place's so many times better.
MUCH_BETTER, WAY_S = 2.0, 1.0
#: Rotor outputs in microseconds: none can be told from a share without its range.
PULSES = "rc/out"
#: Sides of the autopilot's thrust curve, by channel or topic: setpoints of thrust, and what motors are sent.
CURVE_SIDES = {"input": CurveSide.BEFORE, PULSES: CurveSide.BEHIND}


def is_known(name: str, kind: str) -> bool:
    """Say whether channels are made of a topic."""
    return any(source.serves(name, kind) for sources in CHANNEL_SOURCES.values() for source in sources)


def ros_channels(raws: Sequence[RawTopic], findings: list[Finding]) -> dict[str, Channel]:
    """Return the channels of topics, z up.

    Parameters
    ----------
    raws : sequence of RawTopic
        For which `is_known` holds.
    findings : list of Finding
        Gets what is found.

    Raises
    ------
    InputError
        When they are of several vehicles.
    """
    _check_vehicles([raw.name for raw in raws])
    columns = [as_columns(raw, raw.defined(), findings) for raw in raws]
    topics = of_one_clock([_complete(one, findings) for one in columns if one is not None], findings)
    if not topics:
        return {}
    start = start_ns(topics)
    end_s = max(float(one.seconds(start).max()) for one in topics)
    channels: dict[str, Channel] = {}
    unclear: dict[str, list[str]] = {}
    silent = []
    for name, sources in CHANNEL_SOURCES.items():
        for source in sources:
            serving = [
                one for one in topics if source.serves(one.name, one.kind) and source.field in one.fields
            ]
            if len(serving) > 1:
                unclear[source.kind] = sorted(one.name for one in serving)
            if name in channels or len(serving) != 1:
                continue
            made = _channel(name, serving[0], source, start)
            if made is None:
                continue
            if source.is_setpoint:
                until = silenced(made, end_s)
                silent += [name] if until.time_s.size > made.time_s.size else []
                made = until
            channels[name] = made
    findings += _told(unclear, silent, channels)
    return channels


def _check_vehicles(names: Sequence[str]) -> None:
    places = {name.partition(MAVROS)[0] for name in names if f"/{MAVROS}" in f"/{name.lstrip('/')}"}
    if len(places) > 1:
        raise InputError(
            "a bag of one vehicle",
            f"one with mavros of {len(places)}: {', '.join(sorted(places)[:6])}",
            "Take one of them out with `ros2 bag convert`, or name its topics in a channel map (--map).",
        )


def _complete(topic: BagTopic, findings: list[Finding]) -> BagTopic:
    """A topic with the columns that are worked out of its own."""
    fields = with_derived(topic.kind, topic.fields)
    if topic.kind == "nav_msgs/Odometry" and "twist.world.z" in fields and _is_in_the_world(topic, fields):
        fields |= {f"twist.world.{axis}": fields[f"twist.twist.linear.{axis}"] for axis in "xyz"}
        sentence = (
            f"The velocity of {topic.name} is that of its place as it stands: it is taken as one in "
            "the world, although odometry's is in the body's axes."
        )
        findings.append(Finding("odometry_frame", sentence))
    return BagTopic(topic.name, topic.kind, fields, topic.stamp_ns, topic.record_ns)


def _is_in_the_world(topic: BagTopic, fields: Mapping[str, np.ndarray]) -> bool:
    """Whether the velocity of odometry as it stands is that of its place, over a second: places are noisy."""
    time_s = topic.seconds(int(topic.stamp_ns.min()))
    later = np.searchsorted(time_s, time_s + WAY_S)
    begun = np.flatnonzero(later < time_s.size)
    if begun.size < 20:
        return False

    def misfit(stem: str) -> float:
        total = 0.0
        for axis in "xyz":
            place = fields[f"pose.pose.position.{axis}"].astype(np.float64)
            moved = fields[f"{stem}.{axis}"].astype(np.float64)
            way = np.append(0.0, np.cumsum(np.diff(time_s) * 0.5 * (moved[1:] + moved[:-1])))
            gone = (place - way)[later[begun]] - (place - way)[begun]
            total += float(np.nanmedian(np.abs(gone)))
        return total

    turned, standing = misfit("twist.world"), misfit("twist.twist.linear")
    return bool(standing * MUCH_BETTER < turned)


def _channel(name: str, topic: BagTopic, source: RosSource, start: int) -> Channel | None:
    """A channel of a field; None when it has no value, or an output never moves."""
    values = source.sign * topic.fields[source.field].astype(np.float64)
    finite = values[np.isfinite(values)]
    if not finite.size or (source.topic == PULSES and finite.min() == finite.max()):
        return None
    return clean_channel(
        name,
        topic.seconds(start),
        values,
        unit_of(name),
        source=f"{'-' if source.sign < 0.0 else ''}{topic.name}.{source.field}",
        held=held_by_default(name),
        estimated=source.estimated,
        curve_side=CURVE_SIDES.get(source.topic if source.topic == PULSES else name, CurveSide.UNKNOWN),
    )


def _told(
    unclear: Mapping[str, Sequence[str]], silent: Sequence[str], channels: Mapping[str, Channel]
) -> list[Finding]:
    findings = []
    if silent:
        sentence = f"Not in force while its topic is silent: {', '.join(silent)}."
        findings.append(Finding("setpoint_silent", sentence))
    for kind, names in unclear.items():
        sentence = (
            f"Several topics of type {kind}, of which none says what it is of: {', '.join(names)}. None "
            "is used; name the right one in a channel map (--map)."
        )
        findings.append(Finding("several_topics", sentence))
    if "actuator_output_1" in channels:
        sentence = (
            "mavros/rc/out holds pulse widths in microseconds, and nothing in a bag tells their range: "
            "they stay as they are, and no input map fits an offset."
        )
        findings.append(Finding("pulse_range_unknown", sentence))
    return findings
