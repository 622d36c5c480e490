"""Where the messages of a DataFlash log begin, by type.

Messages follow each other without gaps. In blocks of the file all places are found at once where a head
stands before a known type; a message is one from which the next place follows. Where the chain breaks (bytes
were lost or changed) it goes on at the next place that is followed by another. Time is proportional to the
file's size; memory is that of a block and of the places that are wanted.
"""

from __future__ import annotations

import mmap
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.logs.dataflash.layouts import HEAD, HEAD_BYTES, Layout, read_layouts
from eivor.logs.dataflash.messages import Messages
from eivor.shapes import Bool
from eivor.signals.recording import Finding

#: Bytes that are looked at together.
BLOCK = 1 << 22
#: A file whose chain breaks more often is read up to there.
MAX_BREAKS = 1_000_000


@dataclass(slots=True)
class Places:
    """Where messages begin.

    Parameters
    ----------
    by_type : dict of int to list of ndarray
        Places of the wanted types, block by block.
    skipped, cut : int
        Bytes that belong to no message, and those of a message that the file's end cuts.
    """

    by_type: dict[int, list[np.ndarray]] = field(default_factory=dict)
    skipped: int = 0
    cut: int = 0
    _position: int = 0
    _breaks: int = 0

    def of(self, number: int) -> np.ndarray:
        """Return the places of a type, in order; they are handed out once."""
        parts = self.by_type.pop(number, None)
        return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)

    def findings(self) -> list[Finding]:
        """Say what was left out."""
        told = []
        if self.cut:
            told.append(
                Finding("truncated", f"The log ends within a message ({self.cut} bytes of it are there).")
            )
        if self.skipped:
            told.append(
                Finding(
                    "corrupt_parts",
                    f"Damaged parts were left out: {self.skipped} bytes that belong to no message.",
                )
            )
        return told


def read_messages(content: mmap.mmap, names: Collection[str]) -> tuple[list[Messages], list[Finding]]:
    """Return all messages of some types, and what is wrong with the file.

    Parameters
    ----------
    content : mmap
        A log in binary form.
    names : collection of str
        Of the types that are wanted.
    """
    layouts, findings = read_layouts(content)
    wanted = {number: layout for number, layout in layouts.items() if layout.name in names}
    data = np.frombuffer(content, dtype=np.uint8)
    places = find_places(data, layouts, wanted)
    messages = [Messages(layout, data, places.of(number)) for number, layout in wanted.items()]
    return messages, [*findings, *places.findings()]


def find_places(data: np.ndarray, layouts: Mapping[int, Layout], wanted: Collection[int]) -> Places:
    """Return the places of all messages of the wanted types.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)
        The file.
    layouts : mapping of int to Layout
        Of all types.
    wanted : collection of int
        Types.
    """
    lengths = np.zeros(256, dtype=np.int64)
    for number, layout in layouts.items():
        lengths[number] = layout.length
    is_wanted = np.zeros(256, dtype=np.bool_)
    is_wanted[list(wanted)] = True
    kept = np.uint32 if data.size < 1 << 32 else np.int64
    places = Places()
    for start in range(0, data.size, BLOCK):
        if places._breaks > MAX_BREAKS:
            break
        found = _heads(data, start, lengths)
        message = _chained(data, found, lengths, places)
        found = found[message]
        kinds = data[found + 2]
        found, kinds = found[is_wanted[kinds]], kinds[is_wanted[kinds]]
        for number in np.unique(kinds).tolist():
            places.by_type.setdefault(number, []).append(found[kinds == number].astype(kept))
    rest = data[places._position :]
    if rest[:2].tobytes() == HEAD[: rest.size] and not (rest.size > 2 and lengths[rest[2]] <= rest.size):
        places.cut = int(rest.size)
    else:
        places.skipped += int(rest.size)
    return places


def _heads(data: np.ndarray, start: int, lengths: np.ndarray) -> np.ndarray:
    """Places in a block at which a head stands before a known type."""
    part = data[start : start + BLOCK + 2]
    found = np.flatnonzero((part[:-2] == HEAD[0]) & (part[1:-1] == HEAD[1]))
    return np.asarray(found[lengths[part[found + 2]] > 0] + start)


def _followed(data: np.ndarray, ends: np.ndarray, lengths: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Whether another message, or the end of the file, stands where each ends."""
    within = ends + HEAD_BYTES <= data.size
    at = np.where(within, ends, 0)
    if data.size < HEAD_BYTES:
        return ends == data.size
    head = (data[at] == HEAD[0]) & (data[at + 1] == HEAD[1]) & (lengths[data[at + 2]] > 0)
    return np.asarray((within & head) | (~within & (ends <= data.size)))


def _chained(
    data: np.ndarray, found: np.ndarray, lengths: np.ndarray, places: Places
) -> Bool[np.ndarray, " n"]:
    """Which places of a block are messages; moves `places` on to where the next one should begin."""
    taken = np.zeros(found.size, dtype=np.bool_)
    if not found.size:
        return taken
    ends = found + lengths[data[found + 2]]
    followed = _followed(data, ends, lengths)
    able = np.flatnonzero(followed)
    last = np.append(np.flatnonzero(~followed[:-1] | (ends[:-1] != found[1:])), found.size - 1)
    at = int(np.searchsorted(found, places._position))
    while at < found.size and places._breaks <= MAX_BREAKS:
        if found[at] != places._position or not followed[at]:
            following = int(np.searchsorted(able, at))
            if following == able.size:
                break
            at = int(able[following])
            places.skipped += int(found[at]) - places._position
        final = int(last[np.searchsorted(last, at)])
        taken[at : final + 1] = followed[at : final + 1]
        places._position = int(ends[final] if followed[final] else found[final])
        at = max(int(np.searchsorted(found, places._position)), final + 1 if not followed[final] else 0)
        places._breaks += 1
    return taken
