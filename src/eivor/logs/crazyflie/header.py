"""The head of a Crazyflie microSD log: which types of events it has, and which variables each record holds.

Little-endian and packed: the byte 0xBC, the version (u16), the number of event types (u16); for each type its
id (u16), its name, the number of its variables (u16) and these as "name(T)", T a letter of `TYPES`. Names end
with a zero byte. A record is the id of its type, a stamp (version 1: u32 in ms, 2: u64 in us) and the
variables. The last four bytes are the CRC-32 of all before.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.errors import CorruptLogError

MAGIC = b"\xbc"
#: Type of a stamp and its unit [s], by version.
STAMPS: Mapping[int, tuple[str, float]] = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}
#: Types of variables, by their letter.
TYPES: Mapping[str, str] = {
    "b": "<i1",
    "B": "<u1",
    "?": "<u1",
    "h": "<i2",
    "H": "<u2",
    "e": "<f2",
    "i": "<i4",
    "I": "<u4",
    "l": "<i4",
    "L": "<u4",
    "f": "<f4",
    "q": "<i8",
    "Q": "<u8",
    "d": "<f8",
}

#: Bounds that no real log comes near.
MAX_EVENT_TYPES = 256
MAX_VARIABLES = 4096
MAX_NAME_BYTES = 255


@dataclass(frozen=True, slots=True)
class EventType:
    """A type of events.

    Parameters
    ----------
    number : int
        Its id.
    name : str
        Its name, printable.
    variables : tuple of str
        Names of its variables, printable.
    record : dtype
        Of its records: "id", "stamp", and the variables under their numbers "0", "1", ...
    """

    number: int
    name: str
    variables: tuple[str, ...]
    record: np.dtype[np.void]


@dataclass(frozen=True, slots=True)
class Header:
    """The head of a log.

    Parameters
    ----------
    types : tuple of EventType
        With ids of their own.
    tick_s : float
        Unit of the stamps [s].
    length : int
        Where the records begin [bytes].
    """

    types: tuple[EventType, ...]
    tick_s: float
    length: int


def parse_header(data: bytes, name: str) -> Header:
    """Read the head of a log.

    Parameters
    ----------
    data : bytes
        The file, or enough of its start.
    name : str
        What to call the file in messages.

    Raises
    ------
    CorruptLogError
        When it is cut, of a version that is not known, or not sound.
    """
    cursor = _Cursor(data, name, len(MAGIC))
    version, count = cursor.number(), cursor.number()
    if version not in STAMPS:
        raise CorruptLogError(
            "a Crazyflie microSD log of version 1 or 2",
            f"'{name}' of version {version}",
            "The file is damaged, or newer than this release; try a newer Eivor.",
        )
    if count > MAX_EVENT_TYPES:
        raise cursor.corrupt(f"announces {count} types of events (at most {MAX_EVENT_TYPES} are read)")
    stamp, tick_s = STAMPS[version]
    types = []
    for _ in range(count):
        types.append(_event_type(cursor, stamp))
        if sum(len(one.variables) for one in types) > MAX_VARIABLES:
            raise cursor.corrupt(f"announces more than {MAX_VARIABLES} variables")
    numbers = [one.number for one in types]
    if len(set(numbers)) < len(numbers):
        raise cursor.corrupt("gives the same id to two types of events")
    return Header(tuple(types), tick_s, cursor.place)


def _event_type(cursor: _Cursor, stamp: str) -> EventType:
    number, name, count = cursor.number(), cursor.text(), cursor.number()
    if count > MAX_VARIABLES:
        raise cursor.corrupt(f"announces {count} variables of one event (at most {MAX_VARIABLES} are read)")
    variables, fields = [], [("id", "<u2"), ("stamp", stamp)]
    for place in range(count):
        variable, _, letter = cursor.text().rpartition("(")
        if not variable or letter[:-1] not in TYPES or letter[-1:] != ")":
            raise cursor.corrupt(f"names a variable {variable + '(' + letter!r}, whose type is not known")
        variables.append(variable)
        fields.append((str(place), TYPES[letter[:-1]]))
    return EventType(number, name, tuple(variables), np.dtype(fields))


@dataclass(slots=True)
class _Cursor:
    """A place in the head, which moves as things are read."""

    data: bytes
    name: str
    place: int

    def number(self) -> int:
        """Read a number of two bytes."""
        if self.place + 2 > len(self.data):
            raise self.corrupt("ends in its head")
        value: int = struct.unpack_from("<H", self.data, self.place)[0]
        self.place += 2
        return value

    def text(self) -> str:
        """Read a name, in which only printable letters of ASCII stay as they are."""
        end = self.data.find(b"\x00", self.place, self.place + MAX_NAME_BYTES + 1)
        if end < 0:
            cut = self.place + MAX_NAME_BYTES >= len(self.data)
            raise self.corrupt(
                "ends in its head" if cut else f"has a name of more than {MAX_NAME_BYTES} bytes"
            )
        raw = self.data[self.place : end]
        self.place = end + 1
        return "".join(chr(byte) if 32 <= byte < 127 else f"\\x{byte:02x}" for byte in raw)

    def corrupt(self, reason: str) -> CorruptLogError:
        """Return the error for a head that is not sound."""
        return CorruptLogError(
            "a Crazyflie microSD log with a sound head",
            f"'{self.name}', which {reason}",
            "The file is cut or damaged; copy it from the card again.",
        )
