"""Reader of ROS bags: channels of PX4, of mavros and of other topics."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eivor.errors import EmptyLogError, InputError
from eivor.logs import common
from eivor.logs.channel_map import columns_of, load_channel_map
from eivor.logs.mapping import looked_for
from eivor.logs.rosbag import containers, messages
from eivor.logs.rosbag import topics as ros
from eivor.logs.ulog import channels as px4
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Channel, Finding, Frame, Recording

#: Place of the vehicle, direction, name, number of the instance, version of the message.
_NAME = re.compile(
    r"(?P<vehicle>.*?)(?:/fmu/(?P<way>in|out))?/(?P<topic>[a-z_]\w*?)(?P<instance>\d*)(?:_v\d+)?"
)


def is_px4(name: str, kind: str) -> bool:
    """Say whether a topic is one of PX4's that channels are made of."""
    match = _NAME.fullmatch(name)
    return (
        kind.startswith(f"{messages.PACKAGE}/") and match is not None and match["topic"] in px4.NEEDED_TOPICS
    )


def px4_channels(raws: Sequence[ros.RawTopic], findings: list[Finding]) -> tuple[dict[str, Channel], str]:
    """Return the channels of PX4's topics, z down, and the kind of vehicle."""
    matches = {raw.name: match for raw in raws if (match := _NAME.fullmatch(raw.name)) is not None}
    _check_one_vehicle("topics", {match["vehicle"] for match in matches.values()})
    layouts = _layouts(raws, findings)
    columns = [ros.as_columns(raw, layouts[raw.name], findings) for raw in raws if raw.name in layouts]
    sound = ros.of_one_clock([column for column in columns if column is not None], findings)
    if not sound:
        return {}, ""
    topics = _chosen(sound, matches, findings)
    channels = px4.read_topics(topics, np.uint64(ros.start_ns(sound) // 1000), {}, findings)
    findings += px4.unknown_filters(channels.values(), "A bag holds")
    return channels, px4.vehicle_of(topics, {})


def _check_one_vehicle(source: str, places: set[str]) -> None:
    if len(places) > 1:
        raise InputError(
            "a bag of one vehicle",
            f"one with {source} of {len(places)}: {', '.join(sorted(name or '/' for name in places)[:6])}",
            "Take one of them out with `ros2 bag convert`, or name its topics in a channel map (--map).",
        )


def _chosen(
    sound: Sequence[ros.BagTopic], matches: Mapping[str, re.Match[str]], findings: list[Finding]
) -> dict[str, px4.Topic]:
    """The topics by PX4's names: what the vehicle sends before what it is sent, then the useful instance."""
    ways: dict[str, list[px4.Topic]] = {"out": [], "in": []}
    for raw in sound:
        match = matches[raw.name]
        topic = px4.Topic(match["topic"], int(match["instance"] or 0), raw.fields)
        ways[match["way"] or "out"].append(topic)
    sent = {topic.name for topic in ways["out"]}
    received = (topic for topic in ways["in"] if topic.name not in sent)
    return px4.chosen_topics([*ways["out"], *received], findings)


def _layouts(raws: Sequence[ros.RawTopic], findings: list[Finding]) -> dict[str, messages.LayoutOf]:
    """Layout of each topic's messages: by its definition, or by the PX4 releases that fit."""
    layouts = {raw.name: raw.defined() for raw in raws if raw.text}
    unsaid = [raw for raw in raws if not raw.text]
    if not unsaid:
        return layouts
    releases = messages.px4_releases()
    fits = {raw.name: _fitting(raw, list(releases)) for raw in unsaid}
    agreed = set(releases).intersection(*(fit for fit in fits.values() if fit))
    misfits = [f"{raw.name} ({len(raw.payloads[0])} bytes)" for raw in unsaid if not fits[raw.name]]
    findings += common.noted("no_px4_release", misfits, known=", ".join(releases))
    for raw in unsaid:
        if fits[raw.name]:
            layouts[raw.name] = _common_layout(raw, sorted(fits[raw.name] & agreed or fits[raw.name]))
    findings += common.noted("px4_release", sorted(agreed) or "several")
    return layouts


def _fitting(raw: ros.RawTopic, numbers: Sequence[str]) -> set[str]:
    """The releases whose type is as long as the first message."""
    result = set()
    for number in numbers:
        try:
            _common_layout(raw, [number])(raw.payloads[0])
        except messages.UnsoundMessageError:
            continue
        result.add(number)
    return result


def _common_layout(raw: ros.RawTopic, numbers: Sequence[str]) -> messages.LayoutOf:
    """Function that returns the layout of a message as far as some releases agree on it."""
    releases = messages.px4_releases()
    kinds = dict.fromkeys(releases[number].get(raw.kind) for number in numbers)

    def layout_of(message: bytes) -> messages.MessageLayout:
        layouts = [
            messages.message_layout(message, raw.kind, releases[number], ros1=raw.ros1)
            for number in numbers[: 1 if len(kinds) == 1 else None]
        ]
        first = layouts[0]
        fields = {
            name: field
            for name, field in first.fields.items()
            if all(layout.fields.get(name) == field for layout in layouts)
        }
        return messages.MessageLayout(fields, first.lengths, first.size)

    return layout_of


MAVROS = "mavros/"
#: Words in the name of a topic that is requested, not measured.
ASKED = re.compile(
    r"set_?point|target|goal|reference|desired|command|cmd|(?:^|[/_])ref(?:[/_]|$)", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class RosSource:
    """One place where a channel may be."""

    kind: str
    field: str  # Full name of the field
    topic: str = ""  # Of mavros; empty for any topic
    sign: float = 1.0  # -1 where the channel is the negative of the field
    estimated: bool = False  # True when an estimator makes the values
    is_setpoint: bool = False  # True when the topic falls silent where the setpoint is not in force
    is_asked: bool = False

    @property
    def label(self) -> str:
        return f"{MAVROS}{self.topic}.{self.field}" if self.topic else f"{self.kind} {self.field}"

    def serves(self, name: str, kind: str) -> bool:
        if kind != self.kind:
            return False
        if self.topic:
            return f"/{name.lstrip('/')}".endswith(f"/{MAVROS}{self.topic}")
        return f"/{MAVROS}" not in f"/{name.lstrip('/')}" and bool(ASKED.search(name)) == self.is_asked


CHANNEL_SOURCES = common.channel_sources(ros.TABLES, RosSource)
ROS_SOURCES = common.looked_for(ros.TABLES, CHANNEL_SOURCES)

#: The velocity as it stands is taken, not turned, where its way [s] fits the place's so many times better.
MUCH_BETTER, WAY_S = 2.0, 1.0
#: Rotor outputs in microseconds: none can be distinguished from a share without its range.
PULSES = "rc/out"
#: Sides of the autopilot's thrust curve, by channel or topic: setpoints of thrust, and what motors are sent.
CURVE_SIDES = {"input": CurveSide.BEFORE, PULSES: CurveSide.BEHIND}


def is_known(name: str, kind: str) -> bool:
    """Say whether channels are made of a topic, one of PX4 or another."""
    every = (source for sources in CHANNEL_SOURCES.values() for source in sources)
    return is_px4(name, kind) or any(source.serves(name, kind) for source in every)


def ros_channels(raws: Sequence[ros.RawTopic], findings: list[Finding]) -> dict[str, Channel]:
    """Return the channels of topics, z up."""
    names = [raw.name for raw in raws if f"/{MAVROS}" in f"/{raw.name.lstrip('/')}"]
    _check_one_vehicle("mavros", {name.partition(MAVROS)[0] for name in names})
    columns = [ros.as_columns(raw, raw.defined(), findings) for raw in raws]
    topics = ros.of_one_clock(
        [_complete(column, findings) for column in columns if column is not None], findings
    )
    if not topics:
        return {}
    start = ros.start_ns(topics)
    end_s = max(float(topic.seconds(start).max()) for topic in topics)
    channels: dict[str, Channel] = {}
    unclear: dict[str, list[str]] = {}
    inactive: list[str] = []
    for name, sources in CHANNEL_SOURCES.items():
        for source in sources:
            of_kind = [topic for topic in topics if source.serves(topic.name, topic.kind)]
            serving = [topic for topic in of_kind if source.field in topic.fields]
            if len(serving) > 1:
                unclear[source.kind] = sorted(item.name for item in serving)
            if name in channels or len(serving) != 1:
                continue
            channel = _channel(name, serving[0], source, start)
            if channel is not None:
                channels[name] = common.silenced(channel, end_s, inactive) if source.is_setpoint else channel
    findings += common.noted("silent_topic", inactive)
    for kind, names in unclear.items():
        findings += common.noted("several_topics", names, kind=kind)
    findings += common.noted("pulse_range_of_bag", "actuator_output_1" in channels)
    return channels


def _complete(topic: ros.BagTopic, findings: list[Finding]) -> ros.BagTopic:
    """A topic with its derived columns."""
    fields = ros.with_derived(topic.kind, topic.fields)
    if topic.kind == "nav_msgs/Odometry" and "twist.world.z" in fields and _is_in_the_world(topic, fields):
        fields |= {f"twist.world.{axis}": fields[f"twist.twist.linear.{axis}"] for axis in "xyz"}
        findings += common.noted("odometry_frame", topic.name)
    return ros.BagTopic(topic.name, topic.kind, fields, topic.stamp_ns, topic.record_ns)


def _is_in_the_world(topic: ros.BagTopic, fields: Mapping[str, np.ndarray]) -> bool:
    """Whether the velocity of odometry, unrotated, fits the change of its position over a second."""
    time_s = topic.seconds(int(topic.stamp_ns.min()))
    later = np.searchsorted(time_s, time_s + WAY_S)
    indices = np.flatnonzero(later < time_s.size)
    if indices.size < 20:
        return False

    def misfit(stem: str) -> float:
        total = 0.0
        for axis in "xyz":
            position = fields[f"pose.pose.position.{axis}"].astype(np.float64)
            velocity = fields[f"{stem}.{axis}"].astype(np.float64)
            travelled = np.append(0.0, np.cumsum(np.diff(time_s) * 0.5 * (velocity[1:] + velocity[:-1])))
            drift = (position - travelled)[later[indices]] - (position - travelled)[indices]
            total += float(np.nanmedian(np.abs(drift)))
        return total

    rotated, unrotated = misfit("twist.world"), misfit("twist.twist.linear")
    return bool(unrotated * MUCH_BETTER < rotated)


def _channel(name: str, topic: ros.BagTopic, source: RosSource, start: int) -> Channel | None:
    values = source.sign * topic.fields[source.field].astype(np.float64)
    finite = values[np.isfinite(values)]
    if not finite.size or (source.topic == PULSES and finite.min() == finite.max()):
        return None
    return common.logged_channel(
        name,
        topic.seconds(start),
        values,
        f"{'-' if source.sign < 0.0 else ''}{topic.name}.{source.field}",
        estimated=source.estimated,
        curve_side=CURVE_SIDES.get(source.topic if source.topic == PULSES else name, CurveSide.UNKNOWN),
    )


def _advice(channel: str) -> tuple[str, ...]:
    sources = ros.TABLES["to_record"].get(channel)
    return (f"Record {sources}.",) if sources else ()


def _bag(name: str, label: str, kind: str, ending: str, *, folders: bool = False) -> common.LogFormat:
    magic = next(start for start, known in containers.MAGICS.items() if known == kind)
    return common.LogFormat(
        name,
        label,
        lambda head, file: head.startswith(magic) or (folders and bool(containers.bag_candidates(file))),
        lambda path, options: read_bag(path, options, name),
        takes_map=True,
        endings=(ending,),
        parts=lambda folder: containers.bag_parts(folder) if folders else common.FolderParts(),
        **common.advised(ros.TABLES["advice"], _advice),
    )


FORMATS = (
    _bag("ros1", "ROS 1 bag", containers.ROS1, ".bag"),
    _bag("ros2", "ROS 2 bag", containers.SQLITE, ".db3", folders=True),
    _bag("mcap", "MCAP", containers.MCAP, ".mcap"),
)

_MOST_LISTED = 12


def read_bag(path: Path, options: common.ReadOptions, log_format: str) -> Recording:
    """Read a bag."""
    containers.check_installed()
    files = containers.bag_files(path)
    findings: list[Finding] = []
    input_map = vehicle = ""
    sources: Mapping[str, tuple[str, ...]]
    if options.channel_map is not None:
        chosen = load_channel_map(options.channel_map)
        topics = set(map(ros.topic_of, columns_of(chosen.rules)))
        contents = ros.read_contents(files, lambda topic, _kind: topic in topics, findings, options.max_bytes)
        channels = ros.map_channels(chosen, contents, path.name, findings)
        frame, input_map, sources = chosen.frame, chosen.input_map, looked_for(chosen)
    else:
        contents = ros.read_contents(files, is_known, findings, options.max_bytes)
        of_px4 = [raw for raw in contents.topics.values() if is_px4(raw.name, raw.kind)]
        channels, vehicle = px4_channels(of_px4, findings) if of_px4 else ({}, "")
        frame, sources = Frame.NED, px4.LOOKED_FOR
        if not channels:
            others = [raw for raw in contents.topics.values() if not is_px4(raw.name, raw.kind)]
            channels, vehicle = ros_channels(others, findings), ""
            frame, sources = Frame.Z_UP, ROS_SOURCES
        if not channels:
            raise _empty_error(path, contents, findings)
    return Recording(
        name=path.name,
        format=log_format,
        channels=channels,
        frame=frame,
        input_map=input_map,
        looked_for=sources,
        findings=(*findings, *common.channel_findings(channels)),
        vehicle=vehicle,
    )


def _empty_error(path: Path, contents: ros.Contents, findings: list[Finding]) -> EmptyLogError:
    topics = [f"{name} ({kind})" for name, kind in sorted(contents.kinds.items())]
    rest = f" and {len(topics) - _MOST_LISTED} more" if len(topics) > _MOST_LISTED else ""
    text = ", ".join(topics[:_MOST_LISTED]) + rest
    sentence = " ".join(finding.message for finding in findings)
    return EmptyLogError(
        "a bag with topics of PX4 (px4_msgs) or mavros, or with odometry, poses and inertial sensors",
        f"'{path.name}' with {text or 'no messages'}" + (f". {sentence.rstrip('.')}" if sentence else ""),
        'Write a channel map whose columns are TOPIC.FIELD, and whose clock is "stamp" (--map).'
        if topics
        else "Nothing was recorded: check the topics that `rosbag record` or `ros2 bag record` was given.",
    )
