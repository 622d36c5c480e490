"""Message definitions: the fields of each type, as a text of `.msg` says them.

A definition that comes with a bag is text of whoever wrote the bag. It is read as data, into a table of names
and types, and never turned into code.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

#: Bytes of the types that messages are made of; strings have a length of their own.
SIZES: Mapping[str, str] = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
STRING = "string"
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
    """One field of a message.

    Parameters
    ----------
    name : str
        Its name.
    kind : str
        A key of `SIZES`, "string", or the name of another type.
    count : int or None
        Number of values of an array; -1 where each message says it; None for one value.
    """

    name: str
    kind: str
    count: int | None = None


#: Fields of each type, by "package/Type".
Types = Mapping[str, tuple[MessageField, ...]]


def type_name(name: str) -> str:
    """Return the name of a type without its folder: "nav_msgs/msg/Odometry" is "nav_msgs/Odometry"."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}" if rest else name


def parsed_definition(text: str, name: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition, with those that follow it in the same text.

    Parameters
    ----------
    text : str
        As bags keep it: lines of ``type name``, then blocks under a line of equals signs and ``MSG: name``.
    name : str
        Of the first type.

    Notes
    -----
    Lines that say no field are constants, comments, or damage; a type with damage in it does not fit the
    length of its messages.
    """
    parts = _NEXT.split(text[:MAX_TEXT])
    names = [name, *parts[1::2]]
    return {
        type_name(one): tuple(_fields(block, type_name(one)))
        for one, block in zip(names, parts[0::2], strict=True)
    }


def fields_of(text: str, owner: str) -> tuple[MessageField, ...]:
    """Return the fields of one type, each on a line or separated by semicolons."""
    return tuple(_fields(text.replace(";", "\n"), owner))


def _fields(block: str, owner: str) -> list[MessageField]:
    found = []
    for line in block.splitlines():
        match = _LINE.match(line.partition("#")[0].strip())
        if match is None or match[4]:
            continue
        kind, brackets, name = match[1], match[2], match[3]
        count = None if brackets is None else int(brackets[1:-1]) if brackets[1:-1].isdigit() else -1
        found.append(MessageField(name, _kind(kind, owner), count))
    return found


def _kind(kind: str, owner: str) -> str:
    if kind in SIZES or kind in {STRING, "wstring", "time", "duration"}:
        return kind
    if "/" in kind:
        return type_name(kind)
    return _SHORT.get(kind, f"{owner.partition('/')[0]}/{kind}")
