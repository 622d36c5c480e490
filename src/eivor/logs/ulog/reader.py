"""Reader of ULog files and of folders of their CSV files."""

from __future__ import annotations

import contextlib
import io
import mmap
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from mmap import mmap as memory_map
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError, InputError, UnknownFormatError
from eivor.logs import common
from eivor.logs.table.delimited import open_csv
from eivor.logs.ulog import topics as px4
from eivor.logs.ulog.channels import read_topics, unknown_filters
from eivor.signals.recording import Finding, Frame, Recording

# -- CSV names --

#: A table of a topic that is needed: its log, its topic and the number of the instance.
TOPIC_TABLE = rf"(.*)_({'|'.join(sorted(px4.NEEDED_TOPICS, key=len, reverse=True))})_(\d+)\.csv"
_NAME = re.compile(TOPIC_TABLE)
ULOG_ENDINGS = (".ulg", ".ulog")
#: Any table of a topic, needed or not.
_TABLE = re.compile(r".*_\d+\.csv")


@dataclass(frozen=True, slots=True)
class TopicTable:
    """A table of one topic."""

    file: Path
    log: str
    topic: str
    instance: int  # Number of the topic's instance


def tables_of(folder: Path) -> list[TopicTable]:
    """Return the tables of topics that are needed, by their names; none of what is no folder."""
    if not folder.is_dir():
        return []
    matches = filter(None, map(_NAME.fullmatch, common.file_names(folder)))
    tables = (TopicTable(folder / match[0], match[1], match[2], int(match[3])) for match in matches)
    return sorted(tables, key=lambda table: table.file)


def csv_parts(folder: Path) -> common.FolderParts:
    """Return the tables that `ulog2csv` made, with those of topics that are not needed."""
    logs = {table.log for table in tables_of(folder)}
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
    logs = sorted({table.log for table in tables})
    if len(logs) > 1:
        expected = "a folder with the tables of one log"
        received = f"'{folder.name}' with those of {len(logs)}: {', '.join(logs[:4])}"
        raise InputError(expected, received, "Put them into folders of their own.")
    findings: list[Finding] = []
    instances: dict[str, list[px4.Topic]] = {}
    for table in tables:
        topic = _topic(table.file, table.topic, table.instance, findings)
        if topic is not None:
            instances.setdefault(table.topic, []).append(topic)
    topics = {name: px4.choose_instance(candidates, findings) for name, candidates in instances.items()}
    start = min((int(topic.fields["timestamp"].min()) for topic in topics.values()), default=0)
    channels = read_topics(topics, np.uint64(start), {}, findings)
    if not channels:
        remedy = "Convert the ULog again."
        raise EmptyLogError("tables with flight data", f"'{folder.name}' without a value", remedy)
    findings += unknown_filters(channels.values(), "These tables hold")
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
        findings.append(Finding("corrupt_parts", f"A table was left out: {error.received}."))
        return None
    stamps = values.get("timestamp", np.empty(0))
    sound = np.isfinite(stamps) & (stamps >= 0.0) & (stamps < _LAST_US)
    if not sound.any():
        findings.append(Finding("time_stamps", f"A table without stamps was left out: '{file.name}'."))
        return None
    fields = {key: column[sound] for key, column in values.items() if not key.startswith("timestamp")}
    clocks = {
        key: np.nan_to_num(values[key][sound]).clip(0.0, _LAST_US).astype(np.uint64)
        for key in ("timestamp", "timestamp_sample")
        if key in values
    }
    return px4.Topic(name, instance, {**fields, **clocks})


# -- Advice --

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"


def _advice(channel: str) -> tuple[str, ...]:
    """At which rate PX4's logger logs the topics of a channel."""
    topics = list(dict.fromkeys(source.topic for source in px4.CHANNEL_SOURCES.get(channel, ())))
    known = {entry.topic: entry for entry in px4.TOPIC_LOGGING}
    return tuple(_topic_sentence(known[topic]) for topic in topics if topic in known)


def _topic_sentence(entry: px4.TopicLogging) -> str:
    rate = "at every message" if entry.default_rate_hz == float("inf") else f"at {entry.default_rate_hz:g} Hz"
    sentence = f"PX4's default profile (SDLOG_PROFILE bit 0) logs {entry.topic} {rate}"
    raising = [bit for bit in entry.full_rate_bits if bit != 0]
    if raising and entry.default_rate_hz != float("inf"):
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
_FIELD_BYTES = {
    **{f"{sign}int{8 * size}_t": size for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float": 4,
    "double": 8,
    "bool": 1,
    "char": 1,
}

#: What is kept of what a log says of itself, and the type of each: a text, or a number of four bytes.
ABOUT = {"sys_name": "char", "sys_uuid": "char", "ver_sw_release": "uint32_t"}
#: Bounds that no real log comes near; they keep the decoder's memory in hand.
MAX_FIELDS = 2048
MAX_SUBSCRIPTIONS = 256
MAX_NESTING = 8
#: How far the walk looks, byte by byte, for a plausible message where the log has no sync marks [bytes].
MAX_SEARCH_BYTES = 1 << 20


@dataclass(slots=True)
class CleanLog:
    """What the walk found."""

    definitions: bytearray
    data: bytearray = field(default_factory=bytearray)
    rows: dict[int, list[bytes]] = field(default_factory=dict)
    skipped_bytes: int = 0  # Bytes that belong to no plausible message
    rejected_messages: int = 0  # Messages with an impossible content
    rejected: Counter[int] = field(default_factory=Counter)  # Those of topics, by their number
    names: dict[int, str] = field(default_factory=dict)  # Topics that are kept, by their number
    cut_bytes: int = 0  # Bytes of an incomplete last message
    lost_topics: list[str] = field(default_factory=list)
    about: dict[str, bytes] = field(default_factory=dict)
    _formats: dict[str, bytes] = field(default_factory=dict)
    _kept_formats: set[str] = field(default_factory=set)
    _unsound: set[str] = field(default_factory=set)
    _sizes: dict[int, tuple[int, int]] = field(default_factory=dict)
    _subscribed: set[int] = field(default_factory=set)
    _others: dict[int, int] = field(default_factory=dict)  # Messages of numbers that are not kept
    _searched_bytes: int = 0
    _markless_end: int = -1

    @property
    def nameless_messages(self) -> int:
        """Messages of topics whose subscription is not there."""
        return sum(count for number, count in self._others.items() if number not in self._subscribed)

    @property
    def content(self) -> bytes:
        """The clean file, with the first message of each topic."""
        first = [
            _message(_DATA, struct.pack("<H", number) + rows[0]) for number, rows in self.rows.items() if rows
        ]
        return b"".join((self.definitions, self.data, *first))


def clean_log(data: memory_map | bytes, topics: Collection[str], name: str) -> CleanLog:
    """Walk the messages of `data` and keep those that the `topics` need."""
    if len(data) < _HEADER_BYTES:
        expected = f"a ULog header of {_HEADER_BYTES} bytes"
        received = f"'{name}' with {len(data)} bytes"
        raise CorruptLogError(expected, received, "The file is cut right at its start; copy it again.")
    # The version byte is set to the newest known one: the layout has been the same since.
    log = CleanLog(bytearray(data[:7]) + b"\x01" + bytes(data[8:_HEADER_BYTES]))
    bounds = [*_appended_offsets(data, name), len(data)]
    start, in_definitions = _HEADER_BYTES, True
    for end in bounds:
        for kind, payload in _messages(data, start, end, log):
            if in_definitions and kind in b"ALC":
                in_definitions = False
            take = _take_definition if in_definitions else partial(_take_other, topics=topics)
            log.rejected_messages += not take(log, kind, payload)
        start = end
    return log


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
    lowest = begin + size
    return sorted({offset for offset in offsets if lowest < offset < len(data)})


def _messages(data: memory_map | bytes, start: int, end: int, log: CleanLog) -> Iterator[tuple[int, bytes]]:
    """Complete messages between two offsets; a broken chain is resumed at the next sync mark."""
    head, subscription = struct.Struct("<HB").unpack_from, struct.Struct("<H").unpack_from
    sizes, rows, others = log._sizes, log.rows, log._others
    position = start
    while position + 3 <= end:
        size, kind = head(data, position)
        after = position + 3 + size
        if kind == _DATA and size > 1 and after <= end:
            number = subscription(data, position + 3)[0]
            if number in sizes:
                least, most = sizes[number]
                if least <= size - 2 <= most:
                    rows[number].append(data[position + 5 : position + 5 + least])
                else:
                    log.rejected[number] += 1
            else:
                others[number] = others.get(number, 0) + 1
            position = after
            continue
        plausible = kind in _KNOWN_TYPES and size > 0
        if plausible and after <= end:
            yield kind, data[position + 3 : after]
            position = after
        elif not plausible and 0 < size <= 10_000 and _starts_message(data, after, end):
            position = after  # a type that this release does not know, in an unbroken chain
        else:
            resumed = _resume(data, position + 1, end, log)
            if plausible and resumed >= end:
                log.cut_bytes += end - position
                return
            log.skipped_bytes += resumed - position
            position = resumed
    log.cut_bytes += max(end - position, 0)


def _starts_message(data: memory_map | bytes, position: int, end: int) -> bool:
    """Say whether a complete message of a known type, or the end, stands at `position`."""
    if position == end:
        return True
    if position + 3 > end:
        return False
    size, kind = struct.unpack_from("<HB", data, position)
    return kind in _KNOWN_TYPES and size > 0 and position + 3 + size <= end


def _resume(data: memory_map | bytes, position: int, end: int, log: CleanLog) -> int:
    """Offset at which the chain of messages goes on after a break; `end` when it does not."""
    if log._markless_end != end:
        mark = data.find(SYNC_MARK, position, end)
        if mark >= 0:
            return mark + len(SYNC_MARK)
        log._markless_end = end  # asked once only, or a log full of breaks costs quadratic time
    while log._searched_bytes < MAX_SEARCH_BYTES:
        candidate = _CANDIDATE.search(data, position, end)
        if candidate is None:
            break
        start = candidate.start()
        log._searched_bytes += start + 1 - position
        position = start + 1
        size = struct.unpack_from("<H", data, start)[0]
        if _starts_message(data, start, end) and _starts_message(data, start + 3 + size, end):
            return start
    return end


def _text(payload: bytes) -> str | None:
    """Text of a message; None when it is none, as then a byte of it is damaged and any other may be."""
    try:
        return payload.decode("utf-8")
    except UnicodeDecodeError:
        return None


def _message(kind: int, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), kind) + payload


def _take_definition(log: CleanLog, kind: int, payload: bytes) -> bool:
    """Remember a format, keep a parameter; the decoder needs no other definitions. False for unsound ones."""
    if kind == ord("F"):
        name, colon, _ = (_text(payload) or "").partition(":")
        sound = bool(colon) and name not in log._formats
        if sound:
            log._formats[name] = payload
        return sound
    if kind == ord("P"):
        size = payload[0]
        words = (_text(payload[1 : 1 + size]) or "").split(" ")
        known = len(words) == 2 and words[0] in ("int32_t", "float") and words[1] != ""
        sound = known and len(payload) == 5 + size
        if sound:
            log.definitions += _message(kind, payload)
        return sound
    if kind == ord("I"):
        size = payload[0]
        words = (_text(payload[1 : 1 + size]) or "").split(" ")
        if len(words) == 2 and words[1] in ABOUT and words[0].partition("[")[0] == ABOUT[words[1]]:
            log.about.setdefault(words[1], payload[1 + size :])
    return True


def _take_other(log: CleanLog, kind: int, payload: bytes, topics: Collection[str]) -> bool:
    """Keep subscriptions of needed topics, and dropouts. False for unsound ones."""
    if kind == ord("A"):
        return _take_subscription(log, payload, topics)
    sound = kind != ord("O") or len(payload) == 2
    if kind == ord("O") and sound:
        log.data += _message(kind, payload)
    return sound


def _take_subscription(log: CleanLog, payload: bytes, topics: Collection[str]) -> bool:
    """Keep a subscription whose format is sound; a number is never given to a second topic."""
    name = _text(payload[3:])
    if name is None or name not in log._formats:  # damaged, or its format is
        if name is not None and name in topics:
            log.lost_topics.append(name)
        return False
    number = int.from_bytes(payload[1:3], "little")
    log._subscribed.add(number)
    if name not in topics:
        return True
    if name in log._unsound or number in log._sizes or len(log._sizes) >= MAX_SUBSCRIPTIONS:
        return False
    used: set[str] = set()
    flat = _flatten(log, name, "", MAX_NESTING, used) or []
    if ("timestamp", "uint64_t") not in flat or len({label for label, _ in flat}) != len(flat):
        log._unsound.add(name)
        log.lost_topics.append(name)
        return False
    for needed in sorted(used - log._kept_formats):
        log.definitions += _message(ord("F"), log._formats[needed])
    log._kept_formats |= used
    full = sum(_FIELD_BYTES[kind] for _, kind in flat)
    while flat[-1][0].startswith("_padding"):
        flat.pop()
    log._sizes[number] = (sum(_FIELD_BYTES[kind] for _, kind in flat), full)
    log.rows[number], log.names[number] = [], name
    log.data += _message(ord("A"), payload)
    return True


def _flatten(
    log: CleanLog, name: str, prefix: str, depth: int, used: set[str]
) -> list[tuple[str, str]] | None:
    """Flat fields (name, type) of a format; None when it is unknown, malformed, too deep or too long."""
    fields = _fields(log._formats.get(name, b"")) if depth else None
    if fields is None:
        return None
    used.add(name)
    flat: list[tuple[str, str]] = []
    for kind, count, field_name in fields:
        labels = [f"{prefix}{field_name}[{i}]" for i in range(min(count, MAX_FIELDS + 1))]
        for label in labels or [f"{prefix}{field_name}"]:
            if kind in _FIELD_BYTES:
                flat.append((label, kind))
            else:
                nested = _flatten(log, kind, f"{label}.", depth - 1, used)
                if nested is None:
                    return None
                flat += nested
            if len(flat) > MAX_FIELDS:
                return None
    return flat


def _fields(payload: bytes) -> list[tuple[str, int, str]] | None:
    """Fields (type, number, name) of a format; None when one is malformed. A plain field has number 0."""
    texts = [text for text in (_text(payload) or "").partition(":")[2].split(";") if text]
    fields: list[tuple[str, int, str]] = []
    for text in texts[: MAX_FIELDS + 1]:
        words = text.split(" ")
        kind = _FIELD_TYPE.fullmatch(words[0])
        if len(words) != 2 or not words[1] or kind is None:
            return None
        fields.append((kind[1], int(kind[2] or 0), words[1]))
    return fields or None


# -- Reader --

PARSED = (*px4.NEEDED_TOPICS, *(topic for topic in px4.ORIGIN_TOPICS if topic not in px4.NEEDED_TOPICS))


def read_ulog(file: Path, _options: common.ReadOptions) -> Recording:
    """Read a ULog file."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        clean = clean_log(data, PARSED, file.name)
    ulog, printed = _decode(clean, file)
    findings = _file_findings(clean, ulog, printed)
    parameters = _parameters(ulog)
    topics = _topics(ulog, clean.rows, findings)
    neighbours = {name: topics.pop(name) for name in px4.ORIGIN_TOPICS if name in topics}
    start = np.uint64(ulog.start_timestamp)
    channels = read_topics(topics, start, parameters, findings)
    if not channels:
        expected = f"a ULog with flight data (one of the topics {', '.join(px4.NEEDED_TOPICS)})"
        remedy = "Check that logging was on during the flight, and the logging profile (SDLOG_PROFILE)."
        raise EmptyLogError(expected, f"'{file.name}' without a value of any of them", remedy)
    channels |= px4.air_channels(neighbours, start)
    return Recording(
        name=file.name,
        format="ulog",
        channels=channels,
        frame=Frame.NED,
        parameters=parameters,
        looked_for=px4.LOOKED_FOR,
        findings=(*findings, *common.channel_findings(channels)),
        vehicle=px4.vehicle_of(topics, parameters),
        origin=px4.ulog_origin(clean.about, neighbours, start, parameters),
    )


def _decode(clean: CleanLog, file: Path) -> tuple[Any, bool]:
    """Decode the clean messages; what still goes wrong is a damaged file, as is what the decoder prints."""
    from pyulog.core import ULog, ULogException

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            ulog = ULog(io.BytesIO(clean.content), list(PARSED), disable_str_exceptions=True)
    except (ULogException, *common.DECODER_ERRORS) as error:
        received = f"'{file.name}', which cannot be decoded ({type(error).__name__}: {error})"
        remedy = "The file is damaged; copy it from the vehicle again."
        raise CorruptLogError("a readable ULog", received, remedy) from error
    return ulog, bool(printed.getvalue())


def _parameters(ulog: Any) -> dict[str, float]:
    values = {str(key): float(value) for key, value in ulog.initial_parameters.items()}
    return {key: value for key, value in sorted(values.items()) if np.isfinite(value)}


def _file_findings(clean: CleanLog, ulog: Any, printed: bool) -> list[Finding]:
    sentence = "The log ends within a message ({} bytes of it are there)."
    findings = common.noted("truncated", sentence, clean.cut_bytes)
    messages = clean.rejected_messages + clean.rejected.total()
    if clean.skipped_bytes or messages or ulog.file_corruption or printed:
        lost = (
            f", with them all of {', '.join(dict.fromkeys(clean.lost_topics))}" if clean.lost_topics else ""
        )
        damage = f"{clean.skipped_bytes} bytes and {messages} messages{lost}"
        findings.append(Finding("corrupt_parts", f"Damaged parts were left out: {damage}."))
    rejected = (
        (clean.names[number], lost, len(clean.rows[number])) for number, lost in clean.rejected.items()
    )
    texts = [f"{name} {lost} of {lost + kept}" for name, lost, kept in rejected]
    nameless = clean.nameless_messages
    texts += [f"{nameless} of topics whose names are damaged"] if nameless else []
    sentence = "Messages that are there and cannot be read: {}."
    findings += common.noted("lost_messages", sentence, texts)
    total = sum(dropout.duration for dropout in ulog.dropouts) * 1e-3
    sentence = f"The logger lost data {{}} times, {total:.3g} s in total."
    return findings + common.noted("dropouts", sentence, len(ulog.dropouts))


def _topics(ulog: Any, rows: Mapping[int, list[bytes]], findings: list[Finding]) -> dict[str, px4.Topic]:
    instances: dict[str, list[px4.Topic]] = {}
    for data in ulog.data_list:
        fields = _table(data.data, rows[data.msg_id])
        instances.setdefault(data.name, []).append(px4.Topic(data.name, int(data.multi_id), fields))
    return {
        name: px4.choose_instance(candidates, findings if name in px4.NEEDED_TOPICS else [])
        for name, candidates in instances.items()
    }


def _table(first: Mapping[str, np.ndarray], rows: list[bytes]) -> dict[str, np.ndarray]:
    """Fields of all messages of a topic, of the decoder's fields of the first."""
    layout = np.dtype([(name, values.dtype) for name, values in first.items()])
    table = np.frombuffer(b"".join(rows), dtype=layout)
    return {name: table[name] for name in first}


# -- Formats --

ADVICE = common.advised(px4.TABLES["advice"]["all"], _advice)
FORMATS = (
    common.LogFormat(
        "ulog",
        "ULog",
        common.begins_with(MAGIC),
        read_ulog,
        advice=ADVICE,
        setpoints=px4.TABLES["advice"]["setpoints"],
        endings=ULOG_ENDINGS,
    ),
    # a folder of the tables that `ulog2csv` makes of one
    common.LogFormat(
        "ulog2csv",
        "ulog2csv folder",
        lambda _head, folder: bool(tables_of(folder)),
        read_csv_folder,
        advice=ADVICE,
        setpoints=px4.TABLES["advice"]["setpoints"],
        parts=csv_parts,
    ),
)
