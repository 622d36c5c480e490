"""Messages of a DataFlash log: layouts, places and text form."""

from __future__ import annotations

import contextlib
import mmap
import re
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from eivor.linalg.system import COPIED_ROWS, row_blocks
from eivor.logs.common import noted
from eivor.signals.recording import Finding
from eivor.tools import Bool, Float

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
TEXTS = frozenset({"Message", "Name", "FWS"})
_NAME = re.compile(rb"[A-Za-z0-9_]{1,4}\0*")
#: FMT messages that are looked at: a sound log has some hundreds.
MAX_FORMATS = 10_000


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message."""

    kind: np.dtype[np.generic]
    offset: int
    factor: float


@dataclass(frozen=True, slots=True)
class MessageType:
    """Layout of a type by its FMT message."""

    number: int
    name: str
    length: int  # [bytes]
    fields: Mapping[str, Field]

    def misfits(self) -> list[str]:
        """Names of texts and lists where one number belongs, and of numbers where a text does."""
        return [
            name
            for name, item in self.fields.items()
            if (item.kind.kind == "S") != (name in TEXTS) or item.kind.subdtype is not None
        ]


@dataclass(slots=True)
class DeclaredLayouts:
    """Layouts of types as FMT messages give them, one after the other."""

    layouts: dict[int, MessageType] = field(default_factory=dict)
    unsound: int = 0  # Descriptions that cannot be
    changed: set[str] = field(default_factory=set)  # Names of types that were described again and differently

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
        return noted("unsound_layouts", self.unsound) + noted("changed_layouts", sorted(self.changed))


def begins_within(head: bytes) -> bool:
    """Say whether a log in binary form, whose beginning is lost, goes on in some bytes."""
    mark = HEAD + bytes([FMT_TYPE])
    position = head.find(mark)
    while position >= 0:
        following = position + FMT_LENGTH
        if head.startswith(mark, following) and _layout(head[position + HEAD_BYTES : following]) is not None:
            return True
        position = head.find(mark, position + HEAD_BYTES)
    return False


def read_layouts(data: mmap.mmap) -> tuple[dict[int, MessageType], list[Finding]]:
    """Return the layouts of all types by number, and what is wrong with FMT messages."""
    described = DeclaredLayouts()
    mark = HEAD + bytes([FMT_TYPE])
    position = data.find(mark)
    for _ in range(MAX_FORMATS):
        if position < 0 or position + FMT_LENGTH > len(data):
            break
        # in a long log other messages hold these three bytes by chance: no head stands where they end
        is_message_next = data[position + FMT_LENGTH : position + FMT_LENGTH + len(HEAD)] in (HEAD, b"")
        sound = described.add(data[position + HEAD_BYTES : position + FMT_LENGTH], is_message=is_message_next)
        position = data.find(mark, position + (FMT_LENGTH if sound else HEAD_BYTES))
    described.layouts[FMT_TYPE] = MessageType(FMT_TYPE, "FMT", FMT_LENGTH, {})
    return described.layouts, described.findings()


def _layout(payload: bytes) -> MessageType | None:
    number, length, name = payload[0], payload[1], payload[2:6]
    if length <= HEAD_BYTES or not _NAME.fullmatch(name):
        return None
    codes = payload[6:22].rstrip(b"\0").decode("latin-1")
    names = payload[22:86].rstrip(b"\0").decode("latin-1").split(",")
    return MessageType(number, name.rstrip(b"\0").decode(), length, _fields(codes, names, length))


def _fields(codes: str, names: list[str], length: int) -> dict[str, Field]:
    if len(codes) != len(names) or len(set(names)) != len(names) or not set(codes) <= set(CODES):
        return {}
    fields, offset = {}, HEAD_BYTES
    for code, name in zip(codes, names, strict=True):
        stored, factor = CODES[code]
        kind = np.dtype(stored).newbyteorder("<")
        fields[name] = Field(kind, offset, factor)
        offset += kind.itemsize
    return fields if offset == length else {}


#: Clocks, and the seconds in one tick of each; firmware up to 3.3 counts milliseconds.
CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
#: Messages that are together no larger are taken out of a file once, others column by column [bytes] ...
KEPT_BYTES = 1 << 24
#: ... and all of them column by column, where the file is larger than this [bytes].
LONG_FILE_BYTES = 1 << 27


@dataclass(frozen=True)
class Messages:
    """All messages of a type, or of one instance of it."""

    layout: MessageType
    data: np.ndarray
    offsets: np.ndarray  # shape (n,)

    @property
    def name(self) -> str:
        return self.layout.name

    @property
    def count(self) -> int:
        return int(self.offsets.size)

    @property
    def clock(self) -> str:
        """Column of the stamps; empty when there is none."""
        return self.first(*CLOCKS)

    def has(self, *columns: str) -> bool:
        return all(column in self.layout.fields for column in columns)

    def first(self, *columns: str) -> str:
        """Return the first of some columns that it has; empty without one."""
        return next(filter(self.has, columns), "")

    def stored(self, column: str) -> np.ndarray:
        field = self.layout.fields[column]
        if not self.count:
            return np.empty(0, field.kind)
        if self.count * self.layout.length > KEPT_BYTES or self.data.size > LONG_FILE_BYTES:
            return self._gather(field.kind, field.offset)
        view = np.ndarray((self.count,), field.kind, self._all_bytes, field.offset, (self.layout.length,))
        return np.array(view)

    @cached_property
    def _all_bytes(self) -> np.ndarray:
        """Bytes of all messages, contiguous: gathering them from the file takes most of the time."""
        return self._gather(np.dtype((np.void, self.layout.length)), 0)

    def _gather(self, kind: np.dtype[np.generic], offset: int) -> np.ndarray:
        """Value of `kind` at an offset of each message."""
        windows = np.ndarray((self.data.size - self.layout.length + 1,), kind, self.data, offset, (1,))
        gathered = np.empty((self.count, *kind.shape), kind.base)
        for start, stop in row_blocks(0, self.count, COPIED_ROWS):
            gathered[start:stop] = windows[self.offsets[start:stop]]
        return gathered

    def values(self, column: str) -> Float[np.ndarray, " n"]:
        """Return a column as numbers, in its unit."""
        factor = self.layout.fields[column].factor
        with np.errstate(invalid="ignore", over="ignore"):
            values = self.stored(column).astype(np.float64)
            values *= factor
        return np.asarray(values)

    def texts(self, column: str) -> list[str]:
        return [text.decode("latin-1").rstrip("\0") for text in self.stored(column).tolist()]

    def time_s(self) -> Float[np.ndarray, " n"]:
        """Return the stamps [s], from the autopilot's start on."""
        stamps = self.values(self.clock)
        stamps *= CLOCKS[self.clock]
        return stamps

    def where(self, chosen: Bool[np.ndarray, " n"]) -> Messages:
        return self if chosen.all() else replace(self, offsets=self.offsets[chosen])


def rows_of(tables: Mapping[str, Messages], name: str, *columns: str) -> list[tuple[Any, ...]]:
    """Return some columns of the messages of a type, numbers and texts, row by row; none without them."""
    table = tables.get(name)
    if table is None or not table.has(*columns):
        return []
    values = (table.texts(column) if column in TEXTS else table.values(column).tolist() for column in columns)
    return list(zip(*values, strict=True))


BLOCK_BYTES = 1 << 22
#: A file whose chain breaks more often is read up to there.
MAX_BREAKS = 1_000_000


@dataclass(slots=True)
class _Chain:
    position: int = 0  # Where the next message should begin
    breaks: int = 0
    skipped: int = 0  # [bytes]


def read_messages(content: mmap.mmap, names: Collection[str]) -> tuple[list[Messages], list[Finding]]:
    """Return all messages of some types, and what is wrong with the file."""
    layouts, findings = read_layouts(content)
    selected = {number: layout for number, layout in layouts.items() if layout.name in names}
    data = np.frombuffer(content, dtype=np.uint8)
    offsets, damage = find_offsets(data, layouts, selected)
    messages = [Messages(layout, data, offsets[number]) for number, layout in selected.items()]
    return messages, [*findings, *damage]


def find_offsets(
    data: np.ndarray, layouts: Mapping[int, MessageType], selected: Collection[int]
) -> tuple[dict[int, np.ndarray], list[Finding]]:
    """Return the places of all messages of the wanted types, in order, and what is damaged."""
    lengths = np.zeros(256, dtype=np.int64)
    for number, layout in layouts.items():
        lengths[number] = layout.length
    is_selected = np.zeros(256, dtype=np.bool_)
    is_selected[list(selected)] = True
    index_type = np.uint32 if data.size < 1 << 32 else np.int64
    parts, chain = {number: [np.empty(0, index_type)] for number in selected}, _Chain()
    for start in range(0, data.size, BLOCK_BYTES):
        if chain.breaks > MAX_BREAKS:
            break
        part = data[start : start + BLOCK_BYTES + 2]
        indices = np.flatnonzero((part[:-2] == HEAD[0]) & (part[1:-1] == HEAD[1]))
        heads = indices[lengths[part[indices + 2]] > 0] + start
        heads = heads[_chain_heads(data, heads, lengths, chain)]
        kinds = data[heads + 2]
        heads, kinds = heads[is_selected[kinds]], kinds[is_selected[kinds]]
        for number in np.unique(kinds).tolist():
            parts[number].append(heads[kinds == number].astype(index_type))
    tail = data[chain.position :]
    is_cut = tail[:2].tobytes() == HEAD[: tail.size] and not (tail.size > 2 and lengths[tail[2]] <= tail.size)
    skipped = chain.skipped + (0 if is_cut else tail.size)
    findings = noted("cut_message", tail.size if is_cut else 0) + noted("lost_bytes", skipped)
    return {number: np.concatenate(parts.pop(number)) for number in selected}, findings


def _is_followed(data: np.ndarray, ends: np.ndarray, lengths: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Whether another message or the end of the file follows each end."""
    has_head = ends + HEAD_BYTES <= data.size
    index = np.where(has_head, ends, 0)
    head = (data[index] == HEAD[0]) & (data[index + 1] == HEAD[1]) & (lengths[data[index + 2]] > 0)
    return np.asarray((has_head & head) | (~has_head & (ends <= data.size)))


def _chain_heads(
    data: np.ndarray, heads: np.ndarray, lengths: np.ndarray, chain: _Chain
) -> Bool[np.ndarray, " n"]:
    """Mask of heads that begin messages; advances the chain to where the next one should begin."""
    is_message = np.zeros(heads.size, dtype=np.bool_)
    if not heads.size:
        return is_message
    ends = heads + lengths[data[heads + 2]]
    continues = _is_followed(data, ends, lengths)
    candidates = np.flatnonzero(continues)
    last = np.append(np.flatnonzero(~continues[:-1] | (ends[:-1] != heads[1:])), heads.size - 1)
    index = int(np.searchsorted(heads, chain.position))
    while index < heads.size and chain.breaks <= MAX_BREAKS:
        if heads[index] != chain.position or not continues[index]:
            following = int(np.searchsorted(candidates, index))
            if following == candidates.size:
                break
            index = int(candidates[following])
            chain.skipped += int(heads[index]) - chain.position
        final = int(last[np.searchsorted(last, index)])
        is_message[index : final + 1] = continues[index : final + 1]
        chain.position = int(ends[final] if continues[final] else heads[final])
        index = max(int(np.searchsorted(heads, chain.position)), final + 1 if not continues[final] else 0)
        chain.breaks += 1
    return is_message


#: How a log in text is identified: by the line that describes its descriptions.
_BEGIN, _COMMA = rb"^(?:\xef\xbb\xbf)?[ \t]*FMT", rb"[ \t]*,[ \t]*"
_FIRST = re.compile(_COMMA.join((_BEGIN, b"128", b"89", b"FMT", rb"BBnNZ[ \t]*(,|\r?$)")), re.MULTILINE)
_FMT_LINE = re.compile(_BEGIN + rb"[ \t]*,([^\n]*)\n", re.MULTILINE)
#: What may stand before the name of a line's type, and behind it: spaces, and the mark of UTF-8.
_AROUND = b"\xef\xbb\xbf \t"
TEXT_BLOCK_BYTES = 1 << 23
#: Cells that are longer are not looked at together [bytes].
LONGEST_NUMBER = 32
#: Numbers of modes by the names that ground stations write, in small letters without signs.
_MODE_NAMES = (
    "stabilize acro althold auto guided loiter rtl circle - land - drift - sport flip autotune poshold brake "
    "throw - guidednogps smartrtl flowhold follow zigzag systemid"
)
MODES = {name: number for number, name in enumerate(_MODE_NAMES.split()) if name != "-"}
UNKNOWN_MODE = 255


def is_text(head: bytes) -> bool:
    """Say whether a file begins like a log in text."""
    return _FIRST.search(head) is not None


def read_lines(content: mmap.mmap, names: Collection[str]) -> tuple[list[Messages], list[Finding]]:
    """Return all messages of some types, and what is wrong with the file."""
    described = _described_layouts(content)
    layouts = {layout.name: layout for layout in reversed(described.layouts.values())}
    selected = {name: layout for name, layout in layouts.items() if name in names}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in selected}
    damaged = 0
    for block in _blocks(content):
        for name, lines in _by_type(block).items():
            if name not in layouts and name != "FMT":
                damaged += len(lines)
            elif name in selected and selected[name].fields:
                rows = _rows(lines, selected[name])
                damaged += len(lines) - len(rows)
                parts[name].append(rows)
    tail_bytes = len(content) - 1 - content.rfind(b"\n")
    findings = [
        *described.findings(),
        *noted("cut_line", tail_bytes),
        *noted("lost_lines", damaged),
    ]
    return [_messages(layout, parts[name]) for name, layout in selected.items()], findings


def _described_layouts(content: mmap.mmap) -> DeclaredLayouts:
    """Layouts by the FMT lines, wherever they are."""
    described = DeclaredLayouts()
    for _, line in zip(range(MAX_FORMATS), _FMT_LINE.finditer(content), strict=False):
        cells = [cell.strip() for cell in line[1].split(b",", 4)]
        numbers = [int(cell) if cell.isdigit() and len(cell) < 4 else 256 for cell in cells[:2]]
        if numbers[0] == FMT_TYPE:
            continue
        if len(cells) == 4 and not cells[3]:
            cells.append(b"")
        too_long = any(len(cell) > limit for cell, limit in zip(cells[2:], (4, 16, 64), strict=False))
        if len(cells) < 5 or max(numbers) > 255 or too_long:
            described.unsound += 1
        else:
            described.add(struct.pack("<BB4s16s64s", *numbers, *cells[2:]))
    return described


def _blocks(content: mmap.mmap) -> Iterator[bytes]:
    """Whole lines, some megabytes at a time; a last line that nothing ends may be cut, and is left out."""
    start, end = 0, content.rfind(b"\n") + 1
    while start < end:
        stop = content.rfind(b"\n", start, min(start + TEXT_BLOCK_BYTES, end)) + 1
        stop = stop or content.find(b"\n", start) + 1
        yield content[start:stop]
        start = stop


def _by_type(block: bytes) -> dict[str, list[bytes]]:
    """Lines by the name of their type, without it; what has no comma is no message."""
    lines: dict[bytes, list[bytes]] = {}
    for line in block.split(b"\n"):
        name, comma, cells = line.partition(b",")
        if comma:
            lines.setdefault(name, []).append(cells)
    results: dict[str, list[bytes]] = {}
    for name, of_name in lines.items():
        results.setdefault(name.strip(_AROUND).decode("latin-1"), []).extend(of_name)
    return results


def _rows(lines: list[bytes], layout: MessageType) -> np.ndarray:
    """Bytes of the messages as they would be stored, a row each, of the lines that can be one."""
    count = len(layout.fields)
    cells = [row for line in lines if len(row := line.split(b",", count - 1)) == count]
    rows = np.zeros((len(cells), layout.length), dtype=np.uint8)
    sound = np.ones(len(cells), dtype=np.bool_)
    for index, (name, own_field) in enumerate(layout.fields.items()):
        selected = [row[index].strip() for row in cells]
        if own_field.kind.kind == "S":
            column = np.array([cell[: own_field.kind.itemsize] for cell in selected], dtype=own_field.kind)
        elif own_field.kind.subdtype is None:
            names = MODES if (layout.name, name) == ("MODE", "Mode") else {}
            column, can_be = _encode(own_field, _numbers(selected, names))
            sound &= can_be
        else:
            continue
        target = rows[:, own_field.offset : own_field.offset + own_field.kind.itemsize]
        target[:] = column.view(np.uint8).reshape(target.shape)
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


def _encode(field: Field, values: Float[np.ndarray, " n"]) -> tuple[np.ndarray, Bool[np.ndarray, " n"]]:
    """Column as its code stores it, and a mask of the values that fit."""
    with np.errstate(invalid="ignore", over="ignore"):
        if field.kind.kind == "f":
            return values.astype(field.kind), np.ones(values.size, dtype=np.bool_)
        integers, size = np.round(values / field.factor), 2.0 ** (8 * field.kind.itemsize)
        lowest = -0.5 * size if field.kind.kind == "i" else 0.0
        can_be = (integers >= lowest) & (integers < lowest + size)
        return np.where(can_be, integers, 0.0).astype(field.kind), can_be


def _messages(layout: MessageType, parts: list[np.ndarray]) -> Messages:
    data = np.concatenate([np.empty(0, np.uint8), *(part.ravel() for part in parts)])
    return Messages(layout, data, np.arange(0, data.size, layout.length))
