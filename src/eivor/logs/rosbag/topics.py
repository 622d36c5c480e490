"""Topics of a bag: contents, derived signals and channel maps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from eivor.errors import ChannelMapError, CorruptLogError, EmptyLogError, did_you_mean
from eivor.logs.channel_map import ChannelMap, ChannelRule, columns_of
from eivor.logs.common import MAX_SPAN_S, Columns, noted
from eivor.logs.mapping import channels_by_clock, delay_findings, fitted_rules, listed
from eivor.logs.rosbag import messages
from eivor.logs.rosbag.containers import Budget, declared, declared_by_metadata, opened
from eivor.signals.channels import roll_pitch_yaw
from eivor.signals.recording import Channel, Finding
from eivor.strict_toml import package_tables
from eivor.tools import Float, Int

Fields = Mapping[str, np.ndarray]

TABLES = package_tables("eivor.logs.rosbag")
#: Bits of the masks of mavros that say what a setpoint leaves free.
POSITION_BITS = {"position": 1, "velocity": 8, "acceleration_or_force": 64}
RATE_BITS, NO_THRUST, NO_ATTITUDE = {"x": 1, "y": 2, "z": 4}, 64, 128
ON_GROUND, UNKNOWN_STATE = 1, 0
#: Fields of quaternions, in the order of `eivor.signals.channels`, and of the velocity in the body's axes.
_QUATERNION = tuple(f"orientation.{part}" for part in "wxyz")
_POSE = tuple(f"pose.pose.{name}" for name in _QUATERNION)
_VELOCITY = tuple(f"twist.twist.linear.{axis}" for axis in "xyz")
_RATES = tuple(f"body_rate.{axis}" for axis in RATE_BITS)


def with_derived(kind: str, fields: Fields) -> dict[str, np.ndarray]:
    """Return the columns of a topic with those derived from them."""
    needed, derive = _MAKERS.get(kind, ((), dict))
    return {**fields, **(derive(fields) if all(name in fields for name in needed) else {})}


def _masked(values: np.ndarray, out_of_force: np.ndarray) -> Float[np.ndarray, " n"]:
    return np.where(out_of_force, np.nan, values.astype(np.float64))


def _odometry(fields: Fields) -> Fields:
    """The velocity of an odometry message, which is in the body's axes, in those of the world."""
    w, *parts = (fields[name].astype(np.float64) for name in _POSE)
    axis = np.stack(parts)
    body = np.stack([fields[name].astype(np.float64) for name in _VELOCITY])
    norm = w**2 + np.sum(axis**2, axis=0)
    with np.errstate(all="ignore"):
        cross = np.cross(axis, body, axis=0)
        world = body + 2.0 * (w * cross + np.cross(axis, cross, axis=0)) / norm
    return {f"twist.world.{letter}": values for letter, values in zip("xyz", world, strict=True)}


def _imu(fields: Fields) -> Fields:
    """Orientation, not a number where the driver says that it has none."""
    absent = fields["orientation_covariance[0]"] == -1.0
    absent |= sum(np.abs(fields[name]) for name in _QUATERNION) == 0.0
    return {name: _masked(fields[name], absent) for name in _QUATERNION}


def _position_target(fields: Fields) -> Fields:
    mask = fields["type_mask"]
    if mask.dtype.kind not in "iu":  # another definition has something else there
        return {}
    elsewhere = fields["coordinate_frame"] != 1  # that of the world
    return {
        name: _masked(fields[name], ((mask & (bit << index)) != 0) | elsewhere)
        for stem, bit in POSITION_BITS.items()
        for index, axis in enumerate("xyz")
        if (name := f"{stem}.{axis}") in fields
    }


def _attitude_target(fields: Fields) -> Fields:
    mask = fields["type_mask"]
    if mask.dtype.kind not in "iu":
        return {}
    free = (mask & NO_ATTITUDE) != 0
    quaternion = np.stack([_masked(fields[name], free) for name in _QUATERNION])
    with np.errstate(all="ignore"):
        length = np.linalg.norm(quaternion, axis=0)
        angles = roll_pitch_yaw(np.where(length > 0.5, quaternion / length, np.nan))
    columns = {name: np.asarray(angle) for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True)}
    bits = dict(zip(_RATES, RATE_BITS.values(), strict=True)) | {"thrust": NO_THRUST}
    return columns | {name: _masked(fields[name], (mask & bit) != 0) for name, bit in bits.items()}


def _state(fields: Fields) -> Fields:
    modes = fields["mode"]
    if modes.dtype.kind != "S":
        return {}
    return {
        name: np.isin(modes, [mode.encode() for mode in which]).astype(np.float64)
        for name, which in TABLES["modes"].items()
    }


def _extended_state(fields: Fields) -> Fields:
    state = fields["landed_state"]
    return {"landed": _masked(state == ON_GROUND, state == UNKNOWN_STATE)}


#: By the type of a message: the fields that are needed, and the function that derives columns.
_MAKERS: Mapping[str, tuple[tuple[str, ...], Callable[[Fields], Fields]]] = {
    "nav_msgs/Odometry": ((*_POSE, *_VELOCITY), _odometry),
    "sensor_msgs/Imu": (("orientation_covariance[0]", *_QUATERNION), _imu),
    "mavros_msgs/PositionTarget": (("type_mask", "coordinate_frame"), _position_target),
    "mavros_msgs/AttitudeTarget": (("type_mask", *_QUATERNION, *_RATES, "thrust"), _attitude_target),
    "mavros_msgs/State": (("mode",), _state),
    "mavros_msgs/ExtendedState": (("landed_state",), _extended_state),
}

#: Messages are recorded as they arrive, which may be late by so much; more is a jump of the clock [ns].
OVERTAKEN_NS = 500_000_000
#: Largest difference between the clock offsets of topics on one clock [s].
SAME_CLOCK_S = 5.0
#: Stamps beyond these are none: half of what 64 bits hold [ns].
LAST_NS = 1 << 62
#: Fields that are texts, by the type of their message; texts in the place of other fields are none.
TEXTS = frozenset({("mavros_msgs/State", "mode")})


@dataclass(slots=True)
class RawTopic:
    """Messages of a topic as a bag has them."""

    name: str
    kind: str
    text: str  # Definition of that type
    is_idl: bool
    ros1: bool
    payloads: list[bytes] = field(default_factory=list)
    record_ns: list[int] = field(default_factory=list)  # When they were recorded [ns]

    def defined(self) -> messages.LayoutOf:
        """What gives the layout of a message, by the bag's own definition or else by a common one."""
        types = {**messages.common_types()}
        if self.text:
            types |= messages.parsed_types(self.text, self.kind, is_idl=self.is_idl)
        return lambda message: messages.message_layout(message, self.kind, types, ros1=self.ros1)


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic as columns."""

    name: str
    kind: str
    fields: Mapping[str, np.ndarray]  # Numbers and texts by the full name of the field, shape (n,)
    stamp_ns: Int[np.ndarray, " n"]  # [ns]
    record_ns: Int[np.ndarray, " n"]  # [ns]

    def seconds(self, start_ns: int) -> Float[np.ndarray, " n"]:
        """Stamps since some time [s]."""
        return (self.stamp_ns - start_ns).astype(np.float64) * 1e-9


@dataclass(slots=True)
class Contents:
    """Messages read from a bag."""

    topics: dict[str, RawTopic] = field(default_factory=dict)  # Those that were wanted, with their messages
    kinds: dict[str, str] = field(default_factory=dict)  # Type of each topic that has messages
    selected: set[str] = field(default_factory=set)  # Topics whose messages are read
    declared: Counter[str] = field(default_factory=Counter)  # Messages of all topics, by the files' indices
    received: Counter[str] = field(default_factory=Counter)  # Messages that the files gave

    @property
    def size(self) -> int:
        return sum(len(topic.payloads) for topic in self.topics.values())


def read_contents(
    files: Sequence[Path], selects: Callable[[str, str], bool], findings: list[Finding], max_bytes: int
) -> Contents:
    """Read the messages of some topics out of the files of a bag."""
    budget = Budget.of(sum(file.stat().st_size for file in files), max_bytes)
    contents = Contents()
    for file in files:
        previous = contents.size
        try:
            _add_file(file, selects, budget, contents)
        except CorruptLogError as error:
            got = contents.size - previous
            if not got and len(files) == 1:
                raise
            text = f"{got} messages of '{file.name}' were read" if got else "A part was left out"
            findings += noted("lost_file", text, reason=error.received)
    unread = contents.kinds.keys() - contents.selected
    lost = [
        f"{name} {count - contents.received[name]} of {count}"
        for name, count in (contents.declared | declared_by_metadata(files)).items()
        if count > contents.received[name] and name not in unread
    ]
    findings += noted("missing_messages", lost)
    return contents


def _add_file(file: Path, selects: Callable[[str, str], bool], budget: Budget, contents: Contents) -> None:
    from rosbags.interfaces import MessageDefinitionFormat

    with opened(file, budget) as (reader, ros1):
        connections = reader.connections
        types = {item.id: messages.type_name(item.msgtype) for item in connections}
        contents.kinds |= {item.topic: types[item.id] for item in connections if item.msgcount}
        chosen = [item for item in connections if selects(item.topic, types[item.id])]
        contents.declared += declared(reader, ros1=ros1)
        contents.selected |= {item.topic for item in chosen}
        for item, record_ns, payload in reader.messages(chosen) if chosen else ():
            contents.received[item.topic] += 1
            raw = contents.topics.get(item.topic)
            if raw is None:
                is_idl = item.msgdef.format is MessageDefinitionFormat.IDL
                raw = RawTopic(item.topic, types[item.id], item.msgdef.data or "", is_idl, ros1)
                contents.topics[item.topic] = raw
            if raw.kind == types[item.id]:
                raw.payloads.append(budget.message(payload))
                raw.record_ns.append(int(record_ns))


def as_columns(raw: RawTopic, layout_of: messages.LayoutOf, findings: list[Finding]) -> BagTopic | None:
    """Return a topic as columns; None when it has no sound message, or none with a time stamp."""
    columns, indices, reason = messages.decode(raw.payloads, layout_of)
    dropped = len(raw.payloads) - indices.size
    findings += noted("left_out_messages", dropped, topic=raw, reason=reason)
    if not indices.size:
        return None
    stamp_ns = _stamps(columns)
    if stamp_ns is None:
        findings += noted("stampless_topic", topic=raw)
        return None
    is_valid = (stamp_ns > 0) & (stamp_ns < LAST_NS)
    if is_valid.any():
        is_valid &= np.abs(stamp_ns - int(np.median(stamp_ns[is_valid]))) <= round(MAX_SPAN_S * 1e9)
    findings += noted("stampless_messages", int((~is_valid).sum()), topic=raw)
    if not is_valid.any():
        return None
    order = _in_order(stamp_ns, np.flatnonzero(is_valid))
    fields = {
        name: values[order]
        for name, values in columns.items()
        if values.dtype.kind != "S" or (raw.kind, name) in TEXTS
    }
    record_ns = np.array(raw.record_ns, dtype=np.int64)[indices][order]
    return BagTopic(raw.name, raw.kind, fields, stamp_ns[order], record_ns)


def _in_order(stamp_ns: Int[np.ndarray, " n"], indices: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Indices sorted by stamp where delays are small enough for transport, else in the recorded order."""
    stamps = stamp_ns[indices]
    delays = np.maximum.accumulate(stamps) - stamps
    return indices[np.argsort(stamps, kind="stable")] if delays.max() <= OVERTAKEN_NS else indices


def _stamps(fields: Mapping[str, np.ndarray]) -> Int[np.ndarray, " n"] | None:
    """Time stamps of messages [ns]: PX4's stamp in microseconds, or the header's."""
    microseconds = fields.get("timestamp")
    if microseconds is not None and microseconds.dtype.kind == "u" and microseconds.dtype.itemsize == 8:
        return np.where(microseconds < LAST_NS // 1000, microseconds, 0).astype(np.int64) * 1000
    seconds, nanoseconds = fields.get("header.stamp.sec"), fields.get("header.stamp.nanosec")
    if seconds is None or nanoseconds is None or {seconds.dtype.kind, nanoseconds.dtype.kind} - {"i", "u"}:
        return None
    return seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)


def of_one_clock(topics: Sequence[BagTopic], findings: list[Finding]) -> list[BagTopic]:
    """Return the topics whose stamps are of one clock: that of most messages."""
    if not topics:
        return []
    offsets = np.array([np.median(topic.stamp_ns - topic.record_ns) for topic in topics]) * 1e-9
    same_clock = np.abs(offsets[:, None] - offsets) <= SAME_CLOCK_S
    best = same_clock[np.argmax(same_clock @ np.array([topic.stamp_ns.size for topic in topics]))].tolist()
    others = [topic.name for topic, is_near in zip(topics, best, strict=True) if not is_near]
    findings += noted("clocks", others)
    return [topic for topic, is_near in zip(topics, best, strict=True) if is_near]


def start_ns(topics: Sequence[BagTopic]) -> int:
    """Earliest stamp [ns]."""
    return min(int(topic.stamp_ns.min()) for topic in topics)


CLOCKS = ("stamp", "header.stamp", "timestamp")


def topic_of(column: str) -> str:
    """Return the topic that a column is of."""
    return column.partition(".")[0]


def map_channels(
    chosen: ChannelMap, contents: Contents, name: str, findings: list[Finding]
) -> dict[str, Channel]:
    """Return the channels that a map makes of a bag."""
    _check(chosen, contents.kinds, name)
    columns = [as_columns(raw, raw.defined(), findings) for raw in contents.topics.values()]
    topics = of_one_clock([column for column in columns if column is not None], findings)
    tables = {topic.name: with_derived(topic.kind, topic.fields) for topic in topics}
    names = [
        f"{topic}.{field}"
        for topic, fields in tables.items()
        for field, values in fields.items()
        if values.dtype.kind != "S"
    ]
    rules = fitted_rules(chosen, [*CLOCKS, *names], name)
    start, clock = start_ns(topics) if topics else 0, frozenset({chosen.time_column})

    def served() -> Iterator[tuple[list[ChannelRule], Columns]]:
        for item in topics:
            of_topic = [rule for rule in rules if topic_of(rule.expression.columns[0]) == item.name]
            fields = (
                (column, tables[item.name][column.partition(".")[2]]) for column in columns_of(of_topic)
            )
            values = {column: field.astype(np.float64, copy=False) for column, field in fields}
            if of_topic:
                yield of_topic, Columns({**values, chosen.time_column: item.seconds(start)}, seconds=clock)

    channels = channels_by_clock(chosen, served(), name, findings)
    if not channels:
        expected = "a bag with values"
        raise EmptyLogError(expected, f"'{name}', in which every mapped field is empty", "Check the map.")
    findings += delay_findings(channels, chosen.origin)
    return channels


def _check(chosen: ChannelMap, available: Mapping[str, str], name: str) -> None:
    if chosen.time_column not in CLOCKS:
        expected = f"the clock of a bag, '{CLOCKS[0]}' ({chosen.origin}, key time.column)"
        remedy = "Each topic has a clock of its own: the stamps of its messages."
        raise ChannelMapError(expected, f"'{chosen.time_column}'", remedy)
    for rule in chosen.rules:
        topics = {topic_of(column) for column in rule.expression.columns}
        if len(topics) > 1:
            expected = f"columns of one topic for channels.{rule.name} ({chosen.origin})"
            received = f"{listed(sorted(topics))}, whose clocks differ"
            raise ChannelMapError(expected, received, "Take fields of one topic.")
        missing = [topic for topic in topics if topic not in available]
        if missing and not rule.optional:
            expected = f"a topic '{missing[0]}' ({chosen.origin}, key channels.{rule.name})"
            remedy = did_you_mean(missing[0], sorted(available), "Correct the map: TOPIC.FIELD.", most=3)
            raise ChannelMapError(expected, f"'{name}' with the topics {listed(sorted(available))}", remedy)
