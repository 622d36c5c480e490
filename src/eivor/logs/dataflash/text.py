"""DataFlash logs in text (.log): the messages of a .bin as lines, which are turned into these messages again.

A line has the name of its type and its fields, with commas between; FMT lines say what the fields are, as FMT
messages do. Numbers stand in units (1.25 for a code c that holds 125), modes as a number or by their name.
"""

from __future__ import annotations

import contextlib
import mmap
import re
import struct
from collections.abc import Collection, Iterator, Mapping

import numpy as np

from eivor.logs.dataflash.layouts import FMT_TYPE, MAX_FORMATS, Described, Field, Layout
from eivor.logs.dataflash.messages import Messages
from eivor.shapes import Bool, Float
from eivor.signals.recording import Finding

#: How a log in text is told: by the line that describes its descriptions.
_BEGIN, _COMMA = rb"^(?:\xef\xbb\xbf)?[ \t]*FMT", rb"[ \t]*,[ \t]*"
_FIRST = re.compile(
    _COMMA.join((_BEGIN, b"128", b"89", b"FMT", rb"BBnNZ[ \t]*(,|\r?$)")),
    re.MULTILINE,
)
_FMT_LINE = re.compile(_BEGIN + rb"[ \t]*,([^\n]*)\n", re.MULTILINE)
#: What may stand before the name of a line's type, and behind it: spaces, and the mark of UTF-8.
_AROUND = b"\xef\xbb\xbf \t"
#: Lines that are looked at together [bytes].
BLOCK = 1 << 23
#: Cells that are longer are not looked at together [bytes].
LONGEST_NUMBER = 32
#: Numbers of modes by the names that ground stations write, in small letters without signs.
MODES = {
    "stabilize": 0,
    "acro": 1,
    "althold": 2,
    "auto": 3,
    "guided": 4,
    "loiter": 5,
    "rtl": 6,
    "circle": 7,
    "land": 9,
    "drift": 11,
    "sport": 13,
    "flip": 14,
    "autotune": 15,
    "poshold": 16,
    "brake": 17,
    "throw": 18,
    "guidednogps": 20,
    "smartrtl": 21,
    "flowhold": 22,
    "follow": 23,
    "zigzag": 24,
    "systemid": 25,
}
UNKNOWN_MODE = 255


def is_text(head: bytes) -> bool:
    """Say whether a file begins like a log in text."""
    return _FIRST.search(head) is not None


def read_lines(content: mmap.mmap, names: Collection[str]) -> tuple[list[Messages], list[Finding]]:
    """Return all messages of some types, and what is wrong with the file.

    Parameters
    ----------
    content : mmap
        A log in text.
    names : collection of str
        Of the types that are wanted.
    """
    described = _described(content)
    layouts = {one.name: one for one in reversed(described.layouts.values())}
    wanted = {name: layout for name, layout in layouts.items() if name in names}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
    damaged = 0
    for block in _blocks(content):
        for name, lines in _by_type(block).items():
            if name not in layouts and name != "FMT":
                damaged += len(lines)
            elif name in wanted and wanted[name].fields:
                rows = _rows(lines, wanted[name])
                damaged += len(lines) - len(rows)
                parts[name].append(rows)
    findings = described.findings()
    rest = len(content) - 1 - content.rfind(b"\n")
    if rest:
        findings.append(Finding("truncated", f"The log ends within a line ({rest} bytes of it are there)."))
    if damaged:
        sentence = f"Damaged parts were left out: {damaged} lines that are no message."
        findings.append(Finding("corrupt_parts", sentence))
    return [_messages(layout, parts[name]) for name, layout in wanted.items()], findings


def _described(content: mmap.mmap) -> Described:
    """Layouts by the FMT lines, wherever they are."""
    described = Described()
    for _, line in zip(range(MAX_FORMATS), _FMT_LINE.finditer(content), strict=False):
        cells = [cell.strip() for cell in line[1].split(b",", 4)]
        numbers = [int(cell) if cell.isdigit() and len(cell) < 4 else 256 for cell in cells[:2]]
        if numbers[0] == FMT_TYPE:
            continue
        if len(cells) == 4 and not cells[3]:
            cells.append(b"")
        if len(cells) < 5 or max(numbers) > 255 or any(map(_too_long, cells[2:], (4, 16, 64))):
            described.unsound += 1
        else:
            described.add(struct.pack("<BB4s16s64s", *numbers, *cells[2:]))
    return described


def _too_long(cell: bytes, length: int) -> bool:
    return len(cell) > length


def _blocks(content: mmap.mmap) -> Iterator[bytes]:
    """Whole lines, some megabytes at a time; a last line that nothing ends may be cut, and is left out."""
    start, end = 0, content.rfind(b"\n") + 1
    while start < end:
        stop = content.rfind(b"\n", start, min(start + BLOCK, end)) + 1
        stop = stop or content.find(b"\n", start) + 1
        yield content[start:stop]
        start = stop


def _by_type(block: bytes) -> dict[str, list[bytes]]:
    """Lines by the name of their type, without it; what has no comma is no message."""
    lines: dict[bytes, list[bytes]] = {}
    for line in block.split(b"\n"):
        name, comma, rest = line.partition(b",")
        if comma:
            lines.setdefault(name, []).append(rest)
    found: dict[str, list[bytes]] = {}
    for name, of_name in lines.items():
        found.setdefault(name.strip(_AROUND).decode("latin-1"), []).extend(of_name)
    return found


def _rows(lines: list[bytes], layout: Layout) -> np.ndarray:
    """Bytes of the messages as they would be stored, a row each, of the lines that can be one."""
    count = len(layout.fields)
    cells = [row for line in lines if len(row := line.split(b",", count - 1)) == count]
    rows = np.zeros((len(cells), layout.length), dtype=np.uint8)
    sound = np.ones(len(cells), dtype=np.bool_)
    for place, (name, field) in enumerate(layout.fields.items()):
        told = [row[place].strip() for row in cells]
        if field.kind.kind == "S":
            column = np.array([cell[: field.kind.itemsize] for cell in told], dtype=field.kind)
        elif field.kind.subdtype is None:
            names = MODES if (layout.name, name) == ("MODE", "Mode") else {}
            column, can_be = _stored(field, _numbers(told, names))
            sound &= can_be
        else:
            continue
        stored = rows[:, field.offset : field.offset + field.kind.itemsize]
        stored[:] = column.view(np.uint8).reshape(stored.shape)
    return rows[sound]


def _numbers(cells: list[bytes], names: Mapping[str, int]) -> Float[np.ndarray, " n"]:
    """Cells as numbers; NaN where one is none."""
    if max(map(len, cells), default=0) <= LONGEST_NUMBER:
        with contextlib.suppress(ValueError):
            return np.array(cells, dtype=np.bytes_).astype(np.float64)
    return np.array([_number(cell, names) for cell in cells])


def _number(cell: bytes, names: Mapping[str, int]) -> float:
    try:
        return float(cell)
    except ValueError:
        name = re.sub(r"[^a-z]", "", cell.decode("latin-1").lower())
        return float(names.get(name, UNKNOWN_MODE)) if names else np.nan


def _stored(field: Field, values: Float[np.ndarray, " n"]) -> tuple[np.ndarray, Bool[np.ndarray, " n"]]:
    """Column as its code stores it, and where it could be."""
    with np.errstate(invalid="ignore", over="ignore"):
        if field.kind.kind == "f":
            return values.astype(field.kind), np.ones(values.size, dtype=np.bool_)
        whole, size = np.round(values / field.factor), 2.0 ** (8 * field.kind.itemsize)
        least = -0.5 * size if field.kind.kind == "i" else 0.0
        can_be = (whole >= least) & (whole < least + size)
        return np.where(can_be, whole, 0.0).astype(field.kind), can_be


def _messages(layout: Layout, parts: list[np.ndarray]) -> Messages:
    """Messages one after the other, as if a file held them alone."""
    data = np.concatenate([np.empty(0, np.uint8), *(part.ravel() for part in parts)])
    return Messages(layout, data, np.arange(0, data.size, layout.length))
