"""Message definitions and layouts of bags."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

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
_LINE = re.compile(
    r"([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(\[(?:<=)?\d{0,18}\])?\s+([A-Za-z][A-Za-z0-9_]*)\s*(=?)"
)
_NEXT = re.compile(r"^={40,}[ \t]*\nMSG:[ \t]*(\S+)[^\n]*\n", re.MULTILINE)
#: Types that have another name in the text than elsewhere, by ROS 1's way of writing.
_SHORT = {"Header": "std_msgs/Header"}


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field of a message."""

    name: str
    kind: str  # A key of `SIZES`, "string", or the name of another type
    count: int | None = None  # Number of values of an array


#: Fields of each type, by "package/Type".
Types = Mapping[str, tuple[MessageField, ...]]


def type_name(name: str) -> str:
    """Return the name of a type without its folder: "nav_msgs/msg/Odometry" is "nav_msgs/Odometry"."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}" if rest else name


def parsed_definition(text: str, name: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition, with those that follow it in the same text."""
    parts = _NEXT.split(text[:MAX_TEXT])
    names = [name, *parts[1::2]]
    return {
        type_name(item): tuple(_fields(block, type_name(item)))
        for item, block in zip(names, parts[0::2], strict=True)
    }


def fields_of(text: str, owner: str) -> tuple[MessageField, ...]:
    """Return the fields of one type, each on a line or separated by semicolons."""
    return tuple(_fields(text.replace(";", "\n"), owner))


def _fields(block: str, owner: str) -> list[MessageField]:
    results = []
    for line in block.splitlines():
        match = _LINE.match(line.partition("#")[0].strip())
        if match is None or match[4]:
            continue
        kind, brackets, name = match[1], match[2], match[3]
        count = None if brackets is None else int(brackets[1:-1]) if brackets[1:-1].isdigit() else -1
        results.append(MessageField(name, _type_name(kind, owner), count))
    return results


def _type_name(kind: str, owner: str) -> str:
    if kind in SIZES or kind in {STRING, "wstring", "time", "duration"}:
        return kind
    if "/" in kind:
        return type_name(kind)
    return _SHORT.get(kind, f"{owner.partition('/')[0]}/{kind}")


#: Texts of types for bags without definitions: common ones, and those of each release of PX4.
_definitions = cache(partial(package_tables, "eivor.logs.rosbag", "definitions.toml"))


@cache
def common_types() -> Types:
    """Return the fields of each type."""
    return {name: fields_of(text, name) for name, text in _definitions()["types"].items()}


@cache
def px4_releases() -> dict[str, Types]:
    """Return the fields of each type in each release, by its number and then by "px4_msgs/Type"."""
    releases: dict[str, Types] = {}
    so_far: Types = {}
    for number, changed in _definitions()["px4"].items():
        full = {f"{PACKAGE}/{name}": text for name, text in changed.items()}
        so_far = {**so_far, **{name: fields_of(text, name) for name, text in full.items()}}
        releases[number] = so_far
    return releases


_SEPARATOR = "=" * 80 + "\n"


def idl_types(text: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition; none where it cannot be parsed."""
    from rosbags.typesys import TypesysError, get_types_from_idl

    parts = [part.partition("\n")[2] for part in text[:MAX_TEXT].split(_SEPARATOR) if part.startswith("IDL:")]
    types: dict[str, tuple[MessageField, ...]] = {}
    for part in parts or [text[:MAX_TEXT]]:
        try:
            parsed = get_types_from_idl(part)
        except (TypesysError, ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            continue
        for name, (_, fields) in parsed.items():
            types[type_name(name)] = tuple(_field(item, described) for item, described in fields)
    return types


def _field(name: str, described: Any) -> MessageField:
    """A field of rosbags' parse tree: a node's number (base, name, array, sequence), and what it is of."""
    from rosbags.interfaces import Nodetype

    node, content = described
    if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        inner, count = content
        return MessageField(name, _idl_type(*inner), count if node == Nodetype.ARRAY else -1)
    return MessageField(name, _idl_type(node, content))


def _idl_type(node: Any, content: Any) -> str:
    from rosbags.interfaces import Nodetype

    return str(content[0]) if node == Nodetype.BASE else type_name(str(content))


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
        for item in known:
            self._field(item, f"{prefix}{item.name}", depth)

    def _field(self, message_field: MessageField, name: str, depth: int) -> None:
        self.steps += 1
        if message_field.count is None:
            self._value(message_field.kind, name, depth)
            return
        count = self._length() if message_field.count < 0 else message_field.count
        if message_field.kind in SIZES:
            self._numbers(message_field.kind, name, count)
            return
        for index in range(count):
            self._value(message_field.kind, f"{name}[{index}]", depth)

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
        elif kind in {"time", "duration"}:
            self._numbers("uint32", f"{name}.sec", None)
            self._numbers("uint32", f"{name}.nanosec", None)
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


def decoded(payloads: Sequence[bytes], layout_of: Callable[[bytes], MessageLayout]) -> Decoded:
    """Read the messages of a topic."""
    tables: list[tuple[np.ndarray, np.ndarray]] = []
    reason, tried = "", 0
    by_length: dict[int, list[int]] = {}
    for index, payload in enumerate(payloads):
        by_length.setdefault(len(payload), []).append(index)
    for waiting in by_length.values():
        rest = np.array(waiting, dtype=np.int64)
        while rest.size and tried < MAX_LAYOUTS:
            tried += 1
            try:
                layout = layout_of(payloads[rest[0]])
            except UnsoundMessageError as error:
                reason, rest = reason or str(error), rest[1:]
                continue
            joined = b"".join([payloads[item] for item in rest.tolist()])
            rows = np.frombuffer(joined, np.uint8).reshape(rest.size, layout.size)
            # written as the first is, with texts and sequences of the same lengths
            same = np.ones(rest.size, dtype=np.bool_)
            for length in layout.lengths:
                same &= np.all(rows[:, length : length + 4] == rows[0, length : length + 4], axis=1)
            tables.append((rest[same], layout.table(rows if same.all() else rows[same])))
            rest = rest[~same]
        if rest.size:
            reason = reason or f"they have more than {MAX_LAYOUTS} layouts"
    if not tables:
        return {}, np.empty(0, dtype=np.int64), reason
    positions = np.concatenate([item for item, _ in tables])
    order = np.argsort(positions, kind="stable")
    names = tables[0][1].dtype.names or ()
    shared = [name for name in names if all(name in (table.dtype.names or ()) for _, table in tables)]
    fields = {name: np.concatenate([table[name] for _, table in tables])[order] for name in shared}
    return fields, positions[order], reason
