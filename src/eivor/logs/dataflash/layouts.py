"""How the messages of a DataFlash log are laid out: what its FMT messages say, unbelieved.

A message is two bytes of head, its type, and fields without gaps. The FMT message of a type (whose own type
is 128) holds its length, its name, a code of each field and the names of the fields.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.signals.recording import Finding

HEAD = b"\xa3\x95"
HEAD_BYTES = 3
FMT_TYPE, FMT_LENGTH = 128, 89
#: Codes of fields: how each is stored, and how many of the unit one is.
CODES: Mapping[str, tuple[str, float]] = {
    **{code: (code, 1.0) for code in "bBhHfd"},
    **{code: (kind, 1.0) for code, kind in {"i": "i4", "I": "u4", "q": "i8", "Q": "u8"}.items()},
    **{code: (kind, 0.01) for code, kind in {"c": "i2", "C": "u2", "e": "i4", "E": "u4"}.items()},
    **{code: (kind, 1.0) for code, kind in {"n": "S4", "N": "S16", "Z": "S64"}.items()},
    "g": ("f2", 1.0),
    "M": ("u1", 1.0),
    "L": ("i4", 1e-7),
    "a": ("(32,)i2", 1.0),
}
#: Columns of texts, in the messages that are looked at; all others hold one number each.
TEXTS = frozenset({"Message", "Name", "Label", "UnitIds", "MultIds", "FWS"})
_NAME = re.compile(rb"[A-Za-z0-9_]{1,4}\0*")
#: FMT messages that are looked at: a sound log has some hundreds.
MAX_FORMATS = 10_000


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message.

    Parameters
    ----------
    kind : dtype
        As stored.
    offset : int
        From the message's first byte.
    factor : float
        What one of it is in the field's unit.
    """

    kind: np.dtype[np.generic]
    offset: int
    factor: float

    @property
    def is_whole(self) -> bool:
        """Whether it is a whole number that stands for itself."""
        return self.kind.kind in "iu" and self.factor == 1.0


@dataclass(frozen=True, slots=True)
class Layout:
    """What a FMT message says of a type.

    Parameters
    ----------
    number : int
        The type.
    name : str
        "ATT".
    length : int
        Of the whole message, head and type included [bytes].
    fields : mapping of str to Field
        By name; empty when codes, names and length do not agree.
    """

    number: int
    name: str
    length: int
    fields: Mapping[str, Field]

    def misfits(self) -> list[str]:
        """Names of texts and lists where one number belongs, and of numbers where a text does."""
        return [
            name
            for name, one in self.fields.items()
            if (one.kind.kind == "S") != (name in TEXTS) or one.kind.subdtype is not None
        ]

    def without(self, names: Collection[str]) -> Layout:
        """Return a layout without some of the fields."""
        return replace(self, fields={name: one for name, one in self.fields.items() if name not in names})


@dataclass(slots=True)
class Described:
    """Layouts of types as FMT messages give them, one after the other.

    Where a type is described again and differently, the first description counts.

    Parameters
    ----------
    layouts : dict of int to Layout
        By number.
    unsound : int
        Descriptions that cannot be.
    changed : set of str
        Names of types that were described again and differently.
    """

    layouts: dict[int, Layout] = field(default_factory=dict)
    unsound: int = 0
    changed: set[str] = field(default_factory=set)

    def add(self, payload: bytes, *, is_message: bool = True) -> bool:
        """Take in the content of a FMT message; say whether it can be one, and count it where it cannot."""
        layout = _layout(payload)
        if layout is None:
            self.unsound += is_message
            return False
        if self.layouts.setdefault(layout.number, layout) != layout:
            self.changed.add(self.layouts[layout.number].name)
        return True

    def findings(self) -> list[Finding]:
        """Say what is wrong with descriptions."""
        told = []
        if self.unsound:
            sentence = f"Descriptions of messages (FMT) that cannot be, left out: {self.unsound}."
            told.append(Finding("message_formats", sentence))
        if self.changed:
            names = ", ".join(sorted(self.changed))
            sentence = f"Described again and differently, so that the first counts: {names}."
            told.append(Finding("message_formats", sentence))
        return told


def begins_within(head: bytes) -> bool:
    """Say whether a log in binary form, whose beginning is lost, goes on in some bytes.

    Parameters
    ----------
    head : bytes
        The first ones of a file.

    Notes
    -----
    It does where two descriptions of messages stand one behind the other, which no other content has.
    """
    mark = HEAD + bytes([FMT_TYPE])
    place = head.find(mark)
    while place >= 0:
        following = place + FMT_LENGTH
        if head.startswith(mark, following) and _layout(head[place + HEAD_BYTES : following]) is not None:
            return True
        place = head.find(mark, place + HEAD_BYTES)
    return False


def read_layouts(data: mmap.mmap) -> tuple[dict[int, Layout], list[Finding]]:
    """Return the layouts of all types by number, and what is wrong with FMT messages.

    Parameters
    ----------
    data : mmap
        The file.
    """
    described = Described()
    mark = HEAD + bytes([FMT_TYPE])
    place = data.find(mark)
    for _ in range(MAX_FORMATS):
        if place < 0 or place + FMT_LENGTH > len(data):
            break
        # in a long log other messages hold these three bytes by chance: no head stands where they end
        followed = data[place + FMT_LENGTH : place + FMT_LENGTH + len(HEAD)] in (HEAD, b"")
        sound = described.add(data[place + HEAD_BYTES : place + FMT_LENGTH], is_message=followed)
        place = data.find(mark, place + (FMT_LENGTH if sound else HEAD_BYTES))
    described.layouts[FMT_TYPE] = Layout(FMT_TYPE, "FMT", FMT_LENGTH, {})
    return described.layouts, described.findings()


def _layout(payload: bytes) -> Layout | None:
    """Layout of the content of an FMT message; None when it is none."""
    number, length, name = payload[0], payload[1], payload[2:6]
    if length <= HEAD_BYTES or not _NAME.fullmatch(name):
        return None
    codes = payload[6:22].rstrip(b"\0").decode("latin-1")
    names = payload[22:86].rstrip(b"\0").decode("latin-1").split(",")
    return Layout(number, name.rstrip(b"\0").decode(), length, _fields(codes, names, length))


def _fields(codes: str, names: list[str], length: int) -> dict[str, Field]:
    """Fields of a message; none where codes, names and length do not agree."""
    if len(codes) != len(names) or len(set(names)) != len(names) or not set(codes) <= set(CODES):
        return {}
    fields, offset = {}, HEAD_BYTES
    for code, name in zip(codes, names, strict=True):
        stored, factor = CODES[code]
        kind = np.dtype(stored).newbyteorder("<")
        fields[name] = Field(kind, offset, factor)
        offset += kind.itemsize
    return fields if offset == length else {}
