"""Message definitions and layouts of bags."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from eivor.logs.common import DECODER_ERRORS
from eivor.strict_toml import package_tables

#: Bytes of the types that messages are made of; strings have a length of their own.
SIZES: Mapping[str, str] = {
    **dict.fromkeys(("bool", "byte", "char"), "u1"),
    **{f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)},
    "float32": "f4",
    "float64": "f8",
}
STRING = "string"
PACKAGE = "px4_msgs"
#: Longest text of a definition that is read [characters].
MAX_TEXT = 1 << 18
#: A line that is a constant, whose names are written in more ways than the parser takes.
_CONSTANT = re.compile(r"^[ \t]*\S+[ \t]+\w+[ \t]*=.*$", re.MULTILINE)
_SEPARATOR = "=" * 80 + "\n"

#: Fields of each type, by "package/Type": a name, a kind (a key of `SIZES`, "string", or the name of another
#: type), and of an array the number of its values, -1 of a sequence.
Types = Mapping[str, tuple[tuple[str, str, int | None], ...]]


def type_name(name: str) -> str:
    """Return the name of a type without its folder: "nav_msgs/msg/Odometry" is "nav_msgs/Odometry"."""
    package, _, path = name.partition("/")
    return f"{package}/{path.rpartition('/')[2]}" if path else name


def parsed_types(text: str, name: str, *, is_idl: bool = False) -> Types:
    """Return the types of a definition, with those that follow it in the same text, as far as it is sound."""
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    text, types = text[:MAX_TEXT], {}
    if is_idl:
        parts = (part.partition("\n") for part in text.split(_SEPARATOR))
        trees = [partial(get_types_from_idl, part) for head, _, part in parts if head.startswith("IDL:")]
        trees = trees or [partial(get_types_from_idl, text)]
    else:
        trees = [partial(get_types_from_msg, _CONSTANT.sub("", text), name)]
    for parsed in trees:
        with suppress(TypesysError, *DECODER_ERRORS):
            for owner, (_, fields) in parsed().items():
                types[type_name(owner)] = tuple((item, *_kind(described)) for item, described in fields)
    return types


def _kind(described: Any) -> tuple[str, int | None]:
    """Kind and number of values of a node of the parser: its number, and what it is of."""
    from rosbags.interfaces import Nodetype

    node, content = described
    if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        inner, count = content
        return _kind(inner)[0], count if node == Nodetype.ARRAY else -1
    return str(content[0]) if node == Nodetype.BASE else type_name(str(content)), None


#: Texts of types for bags without definitions: common ones, and those of each release of PX4.
_definitions = cache(partial(package_tables, "eivor.logs.rosbag", "definitions.toml"))


@cache
def common_types() -> Types:
    """Return the fields of each type."""
    return _each_type(_definitions()["types"])


@cache
def px4_releases() -> dict[str, Types]:
    """Return the fields of each type in each release, by its number and then by "px4_msgs/Type"."""
    releases: dict[str, Types] = {}
    so_far: Types = {}
    for number, changed in _definitions()["px4"].items():
        so_far = {**so_far, **_each_type({f"{PACKAGE}/{name}": text for name, text in changed.items()})}
        releases[number] = so_far
    return releases


def _each_type(texts: Mapping[str, str]) -> Types:
    """Types whose fields stand in lines or between semicolons, each in a text of its own."""
    parsed = (parsed_types(text.strip().replace(";", "\n"), name) for name, text in texts.items())
    return {name: fields for types in parsed for name, fields in types.items()}


#: Bounds that no message comes near whose fields are of use here.
MAX_FIELDS = 4096
MAX_NESTING = 12
#: Arrays of more values than this are passed over: they are images, clouds, covariances.
MAX_ARRAY = 64
#: Bytes before a message of ROS 2 that say how it is written.
ENCAPSULATION = 4
#: A message may be filled up to a multiple of this [bytes].
FILLED_TO = 4


class UnsoundMessageError(ValueError):
    """A message whose bytes are not those of its type."""


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """Where the fields of a message are."""

    fields: Mapping[str, tuple[int, str]]  # [bytes]
    lengths: tuple[int, ...]
    size: int  # Length of the message [bytes]

    def table(self, rows: np.ndarray) -> np.ndarray:
        """Return messages of this layout, a row of bytes each, as a structured array."""
        offsets, formats = zip(*self.fields.values(), strict=True) if self.fields else ((), ())
        names = list(self.fields)
        kind: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size}
        return np.asarray(rows.view(np.dtype(kind))[:, 0])


#: What gives the layout of a message.
LayoutOf = Callable[[bytes], MessageLayout]


def message_layout(message: bytes, kind: str, types: Types, *, ros1: bool) -> MessageLayout:
    """Return the layout of a message, and of all whose texts and sequences are as long."""
    if ros1:
        walk = _MessageWalk(message, types, 0, "<", aligned=False)
    else:
        if message[:1] != b"\x00" or message[1:2] not in (b"\x00", b"\x01"):
            raise UnsoundMessageError("it is not written in plain CDR")
        walk = _MessageWalk(message, types, ENCAPSULATION, "<" if message[1] else ">", aligned=True)
        walk.lengths.append(0)  # how it is written, which messages of one layout share too
    walk.take(kind, "", MAX_NESTING)
    spare = len(message) - walk.position
    filled = not ros1 and 0 <= spare < FILLED_TO and len(message) % FILLED_TO == 0
    if spare and not filled:
        raise UnsoundMessageError(f"{len(message)} bytes, where its type takes {walk.position}")
    return MessageLayout(walk.fields, tuple(walk.lengths), len(message))


@dataclass(slots=True)
class _MessageWalk:
    message: bytes
    types: Types
    position: int
    order: str
    aligned: bool
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)
    steps: int = 0

    def take(self, kind: str, prefix: str, depth: int) -> None:
        known = self.types.get(kind)
        if known is None or not depth:
            raise UnsoundMessageError(f"the type {kind} is not known" if depth else "it is nested too deep")
        for name, of, count in known:
            self._field(f"{prefix}{name}", of, count, depth)

    def _field(self, name: str, kind: str, count: int | None, depth: int) -> None:
        self.steps += 1
        if count is None:
            self._value(kind, name, depth)
            return
        count = self._length() if count < 0 else count
        if kind in SIZES:
            self._numbers(kind, name, count)
            return
        for index in range(count):
            self._value(kind, f"{name}[{index}]", depth)

    def _value(self, kind: str, name: str, depth: int) -> None:
        self.steps += 1
        if self.steps + len(self.fields) > MAX_FIELDS:
            raise UnsoundMessageError(f"it has more than {MAX_FIELDS} fields")
        if kind in SIZES:
            self._numbers(kind, name, None)
        elif kind == STRING:
            length = self._length()
            if length:
                self.fields[name] = (self.position, f"S{length}")
            self._skip(length)
        else:
            self.take(kind, f"{name}.", depth - 1)

    def _numbers(self, kind: str, name: str, count: int | None) -> None:
        """Numbers of one type; those of long arrays get no name."""
        size = int(SIZES[kind][1])
        if count == 0:
            return
        if self.aligned:
            start = self.position - ENCAPSULATION
            self.position = ENCAPSULATION + -(-start // size) * size
        position = self.position
        self._skip(size * (1 if count is None else count))
        kind = f"{self.order}{SIZES[kind]}"
        if count is None:
            self.fields[name] = (position, kind)
        elif count <= MAX_ARRAY:
            self.fields |= {f"{name}[{index}]": (position + index * size, kind) for index in range(count)}

    def _length(self) -> int:
        if self.aligned:
            self.position += -(self.position - ENCAPSULATION) % 4
        position = self.position
        self._skip(4)
        self.lengths.append(position)
        return int(struct.unpack_from(f"{self.order}I", self.message, position)[0])

    def _skip(self, size: int) -> None:
        self.position += size
        if self.position > len(self.message):
            raise UnsoundMessageError(f"{len(self.message)} bytes, and its type goes on after them")


#: Layouts that the messages of one topic may have, those that are none included; more are left out.
MAX_LAYOUTS = 256

#: Messages of a topic: their fields of shape (n,), their indices of shape (n,), and why others are none.
Decoded = tuple[Mapping[str, np.ndarray], np.ndarray, str]


def decode(payloads: Sequence[bytes], layout_of: LayoutOf) -> Decoded:
    """Read the messages of a topic."""
    tables: list[tuple[np.ndarray, np.ndarray]] = []
    reason, tried = "", 0
    by_length: dict[int, list[int]] = {}
    for index, payload in enumerate(payloads):
        by_length.setdefault(len(payload), []).append(index)
    for waiting in by_length.values():
        pending = np.array(waiting, dtype=np.int64)
        while pending.size and tried < MAX_LAYOUTS:
            tried += 1
            try:
                layout = layout_of(payloads[pending[0]])
            except UnsoundMessageError as error:
                reason, pending = reason or str(error), pending[1:]
                continue
            block = b"".join([payloads[item] for item in pending.tolist()])
            rows = np.frombuffer(block, np.uint8).reshape(pending.size, layout.size)
            # written as the first is, with texts and sequences of the same lengths
            same = np.ones(pending.size, dtype=np.bool_)
            for length in layout.lengths:
                same &= np.all(rows[:, length : length + 4] == rows[0, length : length + 4], axis=1)
            tables.append((pending[same], layout.table(rows if same.all() else rows[same])))
            pending = pending[~same]
        if pending.size:
            reason = reason or f"they have more than {MAX_LAYOUTS} layouts"
    if not tables:
        return {}, np.empty(0, dtype=np.int64), reason
    positions = np.concatenate([item for item, _ in tables])
    order = np.argsort(positions, kind="stable")
    names = tables[0][1].dtype.names or ()
    common = [name for name in names if all(name in (table.dtype.names or ()) for _, table in tables)]
    fields = {name: np.concatenate([table[name] for _, table in tables])[order] for name in common}
    return fields, positions[order], reason
