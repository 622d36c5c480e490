"""The messages of a ULog file, checked before they are decoded.

A ULog is a chain of messages (size, type, payload). The decoder behind this module, pyulog, trusts
the sizes and the field lists that it reads: a few wrong bytes can make it seek backward for ever,
expand nested arrays without bound, or print to the terminal. So this module walks the chain first and
hands on a *clean* log in memory: only complete messages of the needed topics whose definitions are
sound. Its cost is one pass over the file; its memory is that of the needed topics.

The decoder gets the definitions and one message of each topic. The others of a topic have the layout of
that one, so they are kept aside, and read as one table.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from mmap import mmap

from eivor.errors import CorruptLogError

SYNC_MARK = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_HEADER_BYTES = 16
_DATA = ord("D")
_KNOWN_TYPES = frozenset(b"FDIMPQARSOLCB")
#: Three bytes that may head a message: a size that is not zero, and a known type.
_CANDIDATE = re.compile(rb"(?s)(?:[^\x00].|.[^\x00])[FDIMPQARSOLCB]")
#: The type of a field, with a number in brackets when there are several of it.
_FIELD_TYPE = re.compile(r"([^\[\]]+)(?:\[([0-9]{1,5})\])?")
_FIELD_BYTES = {
    "int8_t": 1,
    "uint8_t": 1,
    "int16_t": 2,
    "uint16_t": 2,
    "int32_t": 4,
    "uint32_t": 4,
    "int64_t": 8,
    "uint64_t": 8,
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
    """What the walk found.

    Parameters
    ----------
    definitions, data : bytearray
        The two sections of a ULog file with the needed messages only, but those of the topics.
    rows : dict of int to list of bytes
        Messages of each topic, by the number of its subscription, all of one length.
    skipped_bytes : int
        Bytes that belong to no plausible message.
    rejected_messages : int
        Messages with an impossible content.
    cut_bytes : int
        Bytes of an incomplete last message.
    lost_topics : list of str
        Needed topics that were left out, as their definition is damaged.
    about : dict of str to bytes
        What the log says of itself, by key: `ABOUT`, the first of each.
    """

    definitions: bytearray
    data: bytearray = field(default_factory=bytearray)
    rows: dict[int, list[bytes]] = field(default_factory=dict)
    skipped_bytes: int = 0
    rejected_messages: int = 0
    cut_bytes: int = 0
    lost_topics: list[str] = field(default_factory=list)
    about: dict[str, bytes] = field(default_factory=dict)
    _formats: dict[str, bytes] = field(default_factory=dict)
    _kept_formats: set[str] = field(default_factory=set)
    _unsound: set[str] = field(default_factory=set)
    _sizes: dict[int, tuple[int, int]] = field(default_factory=dict)
    _searched_bytes: int = 0
    _markless_end: int = -1

    @property
    def content(self) -> bytes:
        """The clean file, with the first message of each topic."""
        first = [
            _message(_DATA, struct.pack("<H", number) + rows[0]) for number, rows in self.rows.items() if rows
        ]
        return b"".join((self.definitions, self.data, *first))


def clean_log(data: mmap | bytes, topics: Collection[str], name: str) -> CleanLog:
    """Walk the messages of `data` and keep those that the `topics` need.

    Parameters
    ----------
    data : mmap or bytes
        The whole file.
    topics : collection of str
        Topics to keep.
    name : str
        What to call the file in messages.

    Raises
    ------
    CorruptLogError
        When the file is shorter than a header, or was written with features that are not known.
    """
    if len(data) < _HEADER_BYTES:
        raise CorruptLogError(
            f"a ULog header of {_HEADER_BYTES} bytes",
            f"'{name}' with {len(data)} bytes",
            "The file is cut right at its start; copy it again.",
        )
    # The version byte is set to the newest known one: the layout has been the same since.
    log = CleanLog(bytearray(data[:7]) + b"\x01" + bytes(data[8:_HEADER_BYTES]))
    bounds = [*_appended_offsets(data, name), len(data)]
    start, in_definitions = _HEADER_BYTES, True
    for end in bounds:
        for kind, payload in _messages(data, start, end, log):
            if in_definitions and kind in b"ALC":
                in_definitions = False
            if in_definitions:
                _take_definition(log, kind, payload)
            else:
                _take_other(log, kind, payload, topics)
        start = end
    return log


def _appended_offsets(data: mmap | bytes, name: str) -> list[int]:
    """Where data was appended after the log had ended (a crash dump); from the flag message."""
    if len(data) < _HEADER_BYTES + 3 + 40 or data[_HEADER_BYTES + 2] != ord("B"):
        return []
    size = struct.unpack_from("<H", data, _HEADER_BYTES)[0]
    if size < 40:
        return []
    begin = _HEADER_BYTES + 3
    flags = bytes(data[begin + 8 : begin + 16])
    if flags[0] & ~1 or any(flags[1:]):
        raise CorruptLogError(
            "a ULog whose feature flags are known",
            f"'{name}' with the incompatible flags {flags.hex()}",
            "The file is damaged, or newer than this release; try a newer Eivor.",
        )
    if not flags[0] & 1:
        return []
    offsets = struct.unpack_from("<3Q", data, begin + 16)
    lowest = begin + size
    return sorted({offset for offset in offsets if lowest < offset < len(data)})


def _messages(data: mmap | bytes, start: int, end: int, log: CleanLog) -> Iterator[tuple[int, bytes]]:
    """Complete messages between two offsets; a broken chain is resumed at the next sync mark.

    Messages of topics, which are nearly all there are, are not handed on but kept here.
    """
    head, subscription = struct.Struct("<HB").unpack_from, struct.Struct("<H").unpack_from
    sizes, rows = log._sizes, log.rows
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
                    log.rejected_messages += 1
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


def _starts_message(data: mmap | bytes, position: int, end: int) -> bool:
    """Say whether a complete message of a known type, or the end, stands at `position`."""
    if position == end:
        return True
    if position + 3 > end:
        return False
    size, kind = struct.unpack_from("<HB", data, position)
    return kind in _KNOWN_TYPES and size > 0 and position + 3 + size <= end


def _resume(data: mmap | bytes, position: int, end: int, log: CleanLog) -> int:
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


def _take_definition(log: CleanLog, kind: int, payload: bytes) -> None:
    """Remember a format, keep a sound parameter; the decoder needs nothing else of the definitions."""
    if kind == ord("F"):
        name, colon, _ = (_text(payload) or "").partition(":")
        if colon and name not in log._formats:
            log._formats[name] = payload
        else:
            log.rejected_messages += 1
    elif kind == ord("P"):
        size = payload[0]
        words = (_text(payload[1 : 1 + size]) or "").split(" ")
        if len(words) == 2 and words[0] in ("int32_t", "float") and words[1] and len(payload) == 5 + size:
            log.definitions += _message(kind, payload)
        else:
            log.rejected_messages += 1
    elif kind == ord("I"):
        _take_about(log, payload)


def _take_about(log: CleanLog, payload: bytes) -> None:
    """Keep what the log says of itself, when it is of the type that it should be of."""
    size = payload[0]
    words = (_text(payload[1 : 1 + size]) or "").split(" ")
    if len(words) == 2 and words[1] in ABOUT and words[0].partition("[")[0] == ABOUT[words[1]]:
        log.about.setdefault(words[1], payload[1 + size :])


def _take_other(log: CleanLog, kind: int, payload: bytes, topics: Collection[str]) -> None:
    """Keep subscriptions of needed topics, and dropouts."""
    if kind == ord("A"):
        _take_subscription(log, payload, topics)
    elif kind == ord("O"):
        if len(payload) == 2:
            log.data += _message(kind, payload)
        else:
            log.rejected_messages += 1


def _take_subscription(log: CleanLog, payload: bytes, topics: Collection[str]) -> None:
    """Keep a subscription whose format is sound; a number is never given to a second topic."""
    name = _text(payload[3:])
    if name is None:
        log.rejected_messages += 1
    if name is None or name not in topics:
        return
    number = int.from_bytes(payload[1:3], "little")
    if name in log._unsound or number in log._sizes or len(log._sizes) >= MAX_SUBSCRIPTIONS:
        log.rejected_messages += 1
        return
    used: set[str] = set()
    flat = _flatten(log, name, "", MAX_NESTING, used) or []
    if ("timestamp", "uint64_t") not in flat or len({label for label, _ in flat}) != len(flat):
        log._unsound.add(name)
        log.lost_topics.append(name)
        log.rejected_messages += 1
        return
    for needed in sorted(used - log._kept_formats):
        log.definitions += _message(ord("F"), log._formats[needed])
    log._kept_formats |= used
    full = sum(_FIELD_BYTES[kind] for _, kind in flat)
    while flat[-1][0].startswith("_padding"):
        flat.pop()
    log._sizes[number] = (sum(_FIELD_BYTES[kind] for _, kind in flat), full)
    log.rows[number] = []
    log.data += _message(ord("A"), payload)


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
