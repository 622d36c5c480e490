"""Reader of ULog files and of folders of their CSV files."""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from mmap import mmap as memory_map
from pathlib import Path

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError, InputError, UnknownFormatError
from eivor.logs import common
from eivor.logs.table.delimited import open_csv
from eivor.logs.ulog import channels as px4
from eivor.signals.recording import Finding, Frame, Recording

# -- CSV names --

#: A table of a topic that is needed: its log, its topic and the number of the instance.
TOPIC_TABLE = rf"(.*)_({'|'.join(sorted(px4.NEEDED_TOPICS, key=len, reverse=True))})_(\d+)\.csv"
_NAME = re.compile(TOPIC_TABLE)
ULOG_ENDINGS = (".ulg", ".ulog")
#: Any table of a topic, needed or not.
_TABLE = re.compile(r".*_\d+\.csv")


def tables_of(folder: Path) -> list[re.Match[str]]:
    """Return the names of the tables of needed topics, with log, topic and instance; none of no folder."""
    names = sorted(common.file_names(folder)) if folder.is_dir() else []
    return [match for name in names if (match := _NAME.fullmatch(name)) is not None]


def csv_parts(folder: Path) -> common.FolderParts:
    """Return the tables that `ulog2csv` made, with those of topics that are not needed."""
    logs = {table[1] for table in tables_of(folder)}
    path = {log for log in logs if any((folder / f"{log}{end}").is_file() for end in ULOG_ENDINGS)}
    names = [name for name in common.file_names(folder) if _TABLE.fullmatch(name)] if logs else []

    def of(some: set[str]) -> frozenset[str]:
        begins = tuple(f"{log}_" for log in some)
        return frozenset(name for name in names if name.startswith(begins))

    return common.FolderParts(of(logs - path) - of(path), of(path))


# -- CSV folder --

#: A field of a topic, which no other column of these tables looks like.
_FIELD = re.compile(r"[A-Za-z_][\w.\[\]]*")
#: Stamps beyond these are damaged [us].
_LAST_US = float(1 << 62)


def read_csv_folder(folder: Path, _options: common.ReadOptions) -> Recording:
    """Read a folder of `ulog2csv`."""
    tables = tables_of(folder)
    logs = sorted({table[1] for table in tables})
    if len(logs) > 1:
        expected = "a folder with the tables of one log"
        received = f"'{folder.name}' with those of {len(logs)}: {', '.join(logs[:4])}"
        raise InputError(expected, received, "Put them into folders of their own.")
    findings: list[Finding] = []
    every = (_topic(folder / table[0], table[2], int(table[3]), findings) for table in tables)
    topics = px4.chosen_topics(filter(None, every), findings)
    start = min((int(topic.fields["timestamp"].min()) for topic in topics.values()), default=0)
    channels = px4.read_topics(topics, np.uint64(start), {}, findings)
    if not channels:
        remedy = "Convert the ULog again."
        raise EmptyLogError("tables with flight data", f"'{folder.name}' without a value", remedy)
    findings += px4.unknown_filters(channels.values(), "These tables hold")
    return Recording(
        name=folder.name,
        format="ulog2csv",
        channels=channels,
        frame=Frame.NED,
        looked_for=px4.LOOKED_FOR,
        findings=(*findings, *common.channel_findings(channels)),
        vehicle=px4.vehicle_of(topics, {}),
    )


def _topic(file: Path, name: str, instance: int, findings: list[Finding]) -> px4.Topic | None:
    """One table as a topic; None when it is damaged, or holds no stamps."""
    try:
        source = open_csv(file)
        names = [column for column in source.names if _FIELD.fullmatch(column)]
        values = source.read(names).values if "timestamp" in names else {}
    except (CorruptLogError, EmptyLogError, UnknownFormatError) as error:
        findings += common.noted("lost_table", error.received)
        return None
    stamps = values.get("timestamp", np.empty(0))
    sound = np.isfinite(stamps) & (stamps >= 0.0) & (stamps < _LAST_US)
    if not sound.any():
        findings += common.noted("stampless_table", file.name)
        return None
    fields = {key: column[sound] for key, column in values.items() if not key.startswith("timestamp")}
    clocks = {
        key: np.nan_to_num(values[key][sound]).clip(0.0, _LAST_US).astype(np.uint64)
        for key in ("timestamp", "timestamp_sample")
        if key in values
    }
    return px4.Topic(name, instance, {**fields, **clocks})


MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"


def _advice(channel: str) -> tuple[str, ...]:
    """At which rate PX4's logger logs the topics of a channel."""
    topics = list(dict.fromkeys(source.topic for source in px4.CHANNEL_SOURCES.get(channel, ())))
    return tuple(map(_topic_sentence, filter(px4.LOGGING.__contains__, topics)))


def _topic_sentence(topic: str) -> str:
    rate_hz = px4.LOGGING[topic]["default_rate_hz"]
    rate = "at every message" if np.isinf(rate_hz) else f"at {rate_hz:g} Hz"
    sentence = f"PX4's default profile (SDLOG_PROFILE bit 0) logs {topic} {rate}"
    raising = [bit for bit in px4.LOGGING[topic].get("full_rate_bits", ()) if bit != 0]
    if raising and np.isfinite(rate_hz):
        bits = " or ".join(f"bit {bit} ({px4.PROFILE_BITS[bit]})" for bit in raising)
        return f"{sentence}; {bits} logs it at its full rate."
    return f"{sentence}."


# -- Frames --

SYNC_MARK = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_HEADER_BYTES = 16
_DATA = ord("D")
_KNOWN_TYPES = frozenset(b"FDIMPQARSOLCB")
#: Three bytes that may head a message: a size that is not zero, and a known type.
_CANDIDATE = re.compile(rb"(?s)(?:[^\x00].|.[^\x00])[FDIMPQARSOLCB]")
#: The type of a field, with a number in brackets when there are several of it.
_FIELD_TYPE = re.compile(r"([^\[\]]+)(?:\[([0-9]{1,5})\])?")
_FIELD_CODES = {
    **{f"{u}int{8 * size}_t": f"<{u or 'i'}{size}" for u in ("", "u") for size in (1, 2, 4, 8)},
    "float": "<f4",
    "double": "<f8",
    "bool": "<i1",
    "char": "<i1",
}
_PARAMETER_CODES = {"int32_t": "<i", "float": "<f"}

#: What is kept of what a log says of itself, and the type of each: a text, or a number of four bytes.
ABOUT = {"sys_name": "char", "sys_uuid": "char", "ver_sw_release": "uint32_t"}
#: Bounds that no real log comes near; they keep the memory in hand.
MAX_FIELDS = 2048
MAX_SUBSCRIPTIONS = 256
MAX_NESTING = 8
#: How far the walk looks, byte by byte, for a plausible message where the log has no sync marks [bytes].
MAX_SEARCH_BYTES = 1 << 20


@dataclass(slots=True)
class Subscription:
    """Messages of one instance of a topic."""

    name: str
    instance: int
    layout: np.dtype[np.void]  # Of a message, without padding at its end
    least: int  # Length of that layout [bytes]
    most: int  # Length with the padding [bytes]
    rows: list[bytes] = field(default_factory=list)
    rejected: int = 0  # Messages of another length

    def topic(self) -> px4.Topic:
        table = np.frombuffer(b"".join(self.rows), dtype=self.layout)
        return px4.Topic(self.name, self.instance, {name: table[name] for name in self.layout.names or ()})


class UlogContent:
    """What a walk through the messages finds of those that some topics need."""

    def __init__(self, data: memory_map | bytes, topics: Collection[str], name: str) -> None:
        if len(data) < _HEADER_BYTES:
            expected = f"a ULog header of {_HEADER_BYTES} bytes"
            received = f"'{name}' with {len(data)} bytes"
            raise CorruptLogError(expected, received, "The file is cut right at its start; copy it again.")
        self.start_us = int.from_bytes(data[8:_HEADER_BYTES], "little")
        self.subscriptions: dict[int, Subscription] = {}  # Of needed topics, by their number
        self.parameters: dict[str, float] = {}
        self.about: dict[str, bytes] = {}
        self.dropouts_ms: list[int] = []
        self.skipped_bytes = 0  # Bytes that belong to no plausible message
        self.rejected_messages = 0  # Messages with an impossible content, besides those of topics
        self.cut_bytes = 0  # Bytes of an incomplete last message
        self.lost_topics: list[str] = []
        self._data, self._topics = data, topics
        self._formats: dict[str, bytes] = {}
        self._layouts: dict[str, tuple[np.dtype[np.void], int, int] | None] = {}
        self._subscribed: set[int] = set()
        self._others: dict[int, int] = {}  # Messages of numbers that are not kept
        self._searched_bytes, self._markless_end = 0, -1
        start, self._defining = _HEADER_BYTES, True
        for end in (*_appended_offsets(data, name), len(data)):
            for kind, payload in self._messages(start, end):
                self._defining &= kind not in b"ALC"
                self.rejected_messages += not self._take(kind, payload)
            start = end
        nameless = self._others.keys() - self._subscribed  # Of topics whose subscription is not there
        self.nameless_messages = sum(self._others[number] for number in nameless)

    def _messages(self, start: int, end: int) -> Iterator[tuple[int, bytes]]:
        """Complete messages between two offsets; a broken chain is resumed at the next sync mark."""
        head, subscription = struct.Struct("<HB").unpack_from, struct.Struct("<H").unpack_from
        data, subscriptions, others = self._data, self.subscriptions, self._others
        position = start
        while position + 3 <= end:
            size, kind = head(data, position)
            after = position + 3 + size
            if kind == _DATA and size > 1 and after <= end:
                number = subscription(data, position + 3)[0]
                known = subscriptions.get(number)
                if known is None:
                    others[number] = others.get(number, 0) + 1
                elif known.least <= size - 2 <= known.most:
                    known.rows.append(data[position + 5 : position + 5 + known.least])
                else:
                    known.rejected += 1
                position = after
                continue
            plausible = kind in _KNOWN_TYPES and size > 0
            if plausible and after <= end:
                yield kind, data[position + 3 : after]
                position = after
            elif not plausible and 0 < size <= 10_000 and self._starts_message(after, end):
                position = after  # a type that this release does not know, in an unbroken chain
            else:
                resumed = self._resumed(position + 1, end)
                if plausible and resumed >= end:
                    self.cut_bytes += end - position
                    return
                self.skipped_bytes += resumed - position
                position = resumed
        self.cut_bytes += max(end - position, 0)

    def _starts_message(self, position: int, end: int) -> bool:
        """Say whether a complete message of a known type, or the end, stands at a position."""
        if position + 3 > end:
            return position == end
        size, kind = struct.unpack_from("<HB", self._data, position)
        return kind in _KNOWN_TYPES and size > 0 and position + 3 + size <= end

    def _resumed(self, position: int, end: int) -> int:
        """Offset at which the chain of messages goes on after a break; `end` when it does not."""
        if self._markless_end != end:
            mark = self._data.find(SYNC_MARK, position, end)
            if mark >= 0:
                return mark + len(SYNC_MARK)
            self._markless_end = end  # asked once only, or a log full of breaks costs quadratic time
        while self._searched_bytes < MAX_SEARCH_BYTES:
            candidate = _CANDIDATE.search(self._data, position, end)
            if candidate is None:
                break
            start = candidate.start()
            self._searched_bytes += start + 1 - position
            position = start + 1
            size = struct.unpack_from("<H", self._data, start)[0]
            if self._starts_message(start, end) and self._starts_message(start + 3 + size, end):
                return start
        return end

    def _take(self, kind: int, payload: bytes) -> bool:
        """Keep definitions, and behind them dropouts; subscriptions anywhere. False for unsound ones."""
        if kind == ord("A"):
            return self._take_subscription(payload)
        if kind == ord("O") and not self._defining:
            if len(payload) == 2:
                self.dropouts_ms.append(int.from_bytes(payload, "little"))
            return len(payload) == 2
        if kind not in b"FIP" or not self._defining:
            return True
        if kind == ord("F"):
            name, colon, _ = _text(payload).partition(":")
            sound = bool(name and colon) and name not in self._formats
            if sound:
                self._formats[name] = payload
            return sound
        size = payload[0]
        type_name, _, key = _text(payload[1 : 1 + size]).partition(" ")
        value = payload[1 + size :]
        if kind == ord("I"):
            if key in ABOUT and type_name.partition("[")[0] == ABOUT[key]:
                self.about.setdefault(key, value)
            return True
        sound = type_name in _PARAMETER_CODES and key != "" and " " not in key and len(value) == 4
        if sound:
            self.parameters[key] = float(struct.unpack(_PARAMETER_CODES[type_name], value)[0])
        return sound

    def _take_subscription(self, payload: bytes) -> bool:
        """Keep a subscription whose format is sound; a number is never given to a second topic."""
        name, number = _text(payload[3:]), int.from_bytes(payload[1:3], "little")
        if name in self._formats:  # else it is damaged, or its format is
            self._subscribed.add(number)
            if name not in self._topics:
                return True
            if number in self.subscriptions or len(self.subscriptions) >= MAX_SUBSCRIPTIONS:
                return False
        if name not in self._layouts:
            self._layouts[name] = self._layout(name)
        layout = self._layouts[name]
        if layout is not None:
            self.subscriptions[number] = Subscription(name, payload[0], *layout)
        elif name in self._topics:
            self.lost_topics.append(name)
        return layout is not None

    def _layout(self, name: str) -> tuple[np.dtype[np.void], int, int] | None:
        """Layout of a topic, its length, and that with padding [bytes]; None of an unsound format."""
        flat = self._flat(name, "", MAX_NESTING) or []
        if ("timestamp", _FIELD_CODES["uint64_t"]) not in flat or len(dict(flat)) != len(flat):
            return None
        most = np.dtype(flat).itemsize
        while flat[-1][0].startswith("_padding"):
            flat.pop()
        layout = np.dtype(flat)
        return layout, layout.itemsize, most

    def _flat(self, name: str, prefix: str, depth: int) -> list[tuple[str, str]] | None:
        """Flat fields (name, code) of a format; None when it is unknown, malformed, too deep or too long."""
        fields = _fields(self._formats.get(name, b"")) if depth else None
        if fields is None:
            return None
        flat: list[tuple[str, str]] = []
        for kind, count, field_name in fields:
            labels = [f"{prefix}{field_name}[{i}]" for i in range(min(count, MAX_FIELDS + 1))]
            for label in labels or [f"{prefix}{field_name}"]:
                if kind in _FIELD_CODES:
                    flat.append((label, _FIELD_CODES[kind]))
                else:
                    nested = self._flat(kind, f"{label}.", depth - 1)
                    if nested is None:
                        return None
                    flat += nested
                if len(flat) > MAX_FIELDS:
                    return None
        return flat


def _text(payload: bytes) -> str:
    """Text of a message; none where it is damaged, as then any other byte of it may be."""
    try:
        return payload.decode("utf-8")
    except UnicodeDecodeError:
        return ""


def _appended_offsets(data: memory_map | bytes, name: str) -> list[int]:
    """Where data was appended after the log had ended (a crash dump); from the flag message."""
    if len(data) < _HEADER_BYTES + 3 + 40 or data[_HEADER_BYTES + 2] != ord("B"):
        return []
    size = struct.unpack_from("<H", data, _HEADER_BYTES)[0]
    if size < 40:
        return []
    begin = _HEADER_BYTES + 3
    flags = bytes(data[begin + 8 : begin + 16])
    if flags[0] & ~1 or any(flags[1:]):
        expected = "a ULog whose feature flags are known"
        remedy = "The file is damaged, or newer than this release; try a newer Eivor."
        raise CorruptLogError(expected, f"'{name}' with the incompatible flags {flags.hex()}", remedy)
    if not flags[0] & 1:
        return []
    offsets = struct.unpack_from("<3Q", data, begin + 16)
    return sorted({offset for offset in offsets if begin + size < offset < len(data)})


def _fields(payload: bytes) -> list[tuple[str, int, str]] | None:
    """Fields (type, number, name) of a format; None when one is malformed. A plain field has number 0."""
    texts = [text for text in _text(payload).partition(":")[2].split(";") if text]
    fields: list[tuple[str, int, str]] = []
    for text in texts[: MAX_FIELDS + 1]:
        words = text.split(" ")
        kind = _FIELD_TYPE.fullmatch(words[0])
        if len(words) != 2 or not words[1] or kind is None:
            return None
        fields.append((kind[1], int(kind[2] or 0), words[1]))
    return fields or None


def read_ulog(file: Path, _options: common.ReadOptions) -> Recording:
    """Read a ULog file."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        content = UlogContent(data, (*px4.NEEDED_TOPICS, *px4.CLOCKS), file.name)
    findings = _file_findings(content)
    parameters = {key: value for key, value in sorted(content.parameters.items()) if np.isfinite(value)}
    logged = (item.topic() for item in content.subscriptions.values() if item.rows)
    topics = px4.chosen_topics(logged, findings)
    clocks = {name: topics.pop(name) for name in px4.CLOCKS if name in topics}
    start = np.uint64(content.start_us)
    channels = px4.read_topics(topics, start, parameters, findings)
    if not channels:
        expected = "a ULog with flight data, such as vehicle_local_position and actuator_outputs"
        remedy = "Check that logging was on during the flight, and the logging profile (SDLOG_PROFILE)."
        raise EmptyLogError(expected, f"'{file.name}' without a value of a topic of flight", remedy)
    return Recording(
        name=file.name,
        format="ulog",
        channels=channels,
        frame=Frame.NED,
        parameters=parameters,
        looked_for=px4.LOOKED_FOR,
        findings=(*findings, *common.channel_findings(channels)),
        vehicle=px4.vehicle_of(topics, parameters),
        origin=px4.ulog_origin(content.about, clocks, start, parameters),
    )


def _file_findings(content: UlogContent) -> list[Finding]:
    findings = common.noted("cut_message", content.cut_bytes)
    rejecting = [item for item in content.subscriptions.values() if item.rejected]
    messages = content.rejected_messages + sum(item.rejected for item in rejecting)
    if content.skipped_bytes or messages:
        lost = ", ".join(dict.fromkeys(content.lost_topics))
        damage = f"{content.skipped_bytes} bytes and {messages} messages"
        damage += f", with them all of {lost}" if lost else ""
        findings += common.noted("lost_parts", damage)
    texts = [f"{item.name} {item.rejected} of {item.rejected + len(item.rows)}" for item in rejecting]
    nameless = content.nameless_messages
    texts += [f"{nameless} of topics whose names are damaged"] if nameless else []
    findings += common.noted("unreadable_messages", texts)
    lost_s = sum(content.dropouts_ms) * 1e-3
    return findings + common.noted("dropouts", len(content.dropouts_ms), lost_s=lost_s)


_ADVISED = common.advised(px4.TABLES["advice"], _advice)
#: ULog, and a folder of the tables that `ulog2csv` makes of one.
FORMATS = (
    common.LogFormat("ulog", "ULog", common.begins_with(MAGIC), read_ulog, endings=ULOG_ENDINGS, **_ADVISED),
    common.LogFormat(
        "ulog2csv",
        "ulog2csv folder",
        lambda _, folder: bool(tables_of(folder)),
        read_csv_folder,
        parts=csv_parts,
        **_ADVISED,
    ),
)
