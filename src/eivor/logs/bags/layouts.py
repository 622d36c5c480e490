"""Where each field of a message stands in its bytes: in CDR, as ROS 2 writes, and as ROS 1 writes.

A message is a chain of fields. Values of fixed size stand where those before them end, in CDR at the next
multiple of their size; texts and sequences begin with their length. Two messages of one type whose lengths
are the same, all of them, have the same layout: it is worked out for the first of them, and the others are
read as one table.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.logs.bags.definitions import SIZES, STRING, MessageField, Types

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
class Layout:
    """Where the fields of a message are.

    Parameters
    ----------
    fields : mapping of str to tuple
        Offset in the message [bytes] and NumPy's type of each field, by its full name: ``pose.position.z``,
        ``q[2]``.
    lengths : tuple of int
        Offsets of the words that say how long texts and sequences are, and how the message is written.
    size : int
        Length of the message [bytes].
    """

    fields: Mapping[str, tuple[int, str]]
    lengths: tuple[int, ...]
    size: int

    def table(self, joined: bytes) -> np.ndarray:
        """Return messages of this layout, one after the other, as a structured array."""
        names = list(self.fields)
        return np.frombuffer(
            joined,
            np.dtype(
                {
                    "names": names,
                    "formats": [self.fields[name][1] for name in names],
                    "offsets": [self.fields[name][0] for name in names],
                    "itemsize": self.size,
                }
            ),
        )


def message_layout(message: bytes, kind: str, types: Types, *, ros1: bool) -> Layout:
    """Return the layout of a message, and of all whose texts and sequences are as long.

    Parameters
    ----------
    message : bytes
        As the bag has it.
    kind : str
        Its type.
    types : mapping
        Fields of it and of the types in it.
    ros1 : bool
        Whether it is written as in ROS 1: without encapsulation, texts without a zero at their end, no
        alignment.

    Raises
    ------
    UnsoundMessageError
        When its length is not that of its type, or the type is not known.
    """
    if ros1:
        walk = _Walk(message, types, 0, "<", aligned=False)
    else:
        if message[:1] != b"\x00" or message[1:2] not in (b"\x00", b"\x01"):
            raise UnsoundMessageError("it is not written in plain CDR")
        walk = _Walk(message, types, ENCAPSULATION, "<" if message[1] else ">", aligned=True)
        walk.lengths.append(0)  # how it is written, which messages of one layout share too
    walk.take(kind, "", MAX_NESTING)
    spare = len(message) - walk.position
    filled = not ros1 and 0 <= spare < FILLED_TO and len(message) % FILLED_TO == 0
    if spare and not filled:
        raise UnsoundMessageError(f"{len(message)} bytes, where its type takes {walk.position}")
    return Layout(walk.fields, tuple(walk.lengths), len(message))


@dataclass(slots=True)
class _Walk:
    """The way through one message."""

    message: bytes
    types: Types
    position: int
    order: str
    aligned: bool
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)
    steps: int = 0

    def take(self, kind: str, prefix: str, depth: int) -> None:
        """Pass over the fields of a type."""
        known = self.types.get(kind)
        if known is None or not depth:
            raise UnsoundMessageError(f"the type {kind} is not known" if depth else "it is nested too deep")
        for one in known:
            self._field(one, f"{prefix}{one.name}", depth)

    def _field(self, one: MessageField, name: str, depth: int) -> None:
        self.steps += 1
        if one.count is None:
            self._value(one.kind, name, depth)
            return
        count = self._length() if one.count < 0 else one.count
        if one.kind in SIZES:
            self._numbers(one.kind, name, count)
            return
        for place in range(count):
            self._value(one.kind, f"{name}[{place}]", depth)

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
        begun = self.position
        self._skip(size * (1 if count is None else count))
        kind = f"{self.order}{SIZES[kind]}"
        if count is None:
            self.fields[name] = (begun, kind)
        elif count <= MAX_ARRAY:
            self.fields |= {f"{name}[{place}]": (begun + place * size, kind) for place in range(count)}

    def _length(self) -> int:
        """The length of a text or of a sequence."""
        if self.aligned:
            self.position += -(self.position - ENCAPSULATION) % 4
        begun = self.position
        self._skip(4)
        self.lengths.append(begun)
        return int(struct.unpack_from(f"{self.order}I", self.message, begun)[0])

    def _skip(self, size: int) -> None:
        self.position += size
        if self.position > len(self.message):
            raise UnsoundMessageError(f"{len(self.message)} bytes, and its type goes on after them")
