"""The records of a Crazyflie microSD log: one after the other, of types that may alternate.

A record has no length of its own, so the next one begins where its type says. Where none of a known type
begins (bytes were lost on the way to the card) the walk goes on at the next place from which several follow
each other, with a stamp that can be of this log. Time and memory are proportional to the file's size.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.logs.crazyflie.header import EventType, Header
from eivor.logs.stamps import believable
from eivor.shapes import Float
from eivor.signals.recording import LARGEST_VALUE, Finding

CHECKSUM_BYTES = 4
#: So many records of one type in a row, and whole blocks of them are looked at.
RUN = 32
BLOCK = 4096
#: How many records must follow each other where the walk goes on, how long after the log's start they may be
#: [s], and how far it looks, at how much a time [bytes].
CHAIN = 4
LONGEST_LOG_S = 86400.0
MAX_SEARCH_BYTES = 1 << 22
SEARCH_BLOCK = 512


@dataclass(frozen=True, slots=True)
class Event:
    """The records of one type.

    Parameters
    ----------
    name : str
        Of the type.
    variables : tuple of str
        Its variables; of two of one name the first counts.
    records : ndarray, shape (n,)
        Structured, as `EventType.record` says.
    time_s : ndarray, shape (n,)
        Stamps from the log's start on [s].
    """

    name: str
    variables: tuple[str, ...]
    records: np.ndarray
    time_s: Float[np.ndarray, " n"]

    def values(self, variable: str) -> Float[np.ndarray, " n"]:
        """Return the values of a variable as logged; NaN for what nothing measures."""
        with np.errstate(invalid="ignore"):
            values = self.records[str(self.variables.index(variable))].astype(np.float64)
        values[~(np.abs(values) <= LARGEST_VALUE)] = np.nan
        return np.asarray(values)


@dataclass(slots=True)
class _Walk:
    """Where records begin, by id, and the bytes that belong to none."""

    places: dict[int, array[int]]
    skipped: int = 0
    left: int = 0
    searched: int = 0


def read_events(data: bytes, header: Header) -> tuple[list[Event], list[Finding]]:
    """Return the events of a log that have a record, on one clock, and what is wrong with the file.

    Parameters
    ----------
    data : bytes
        The whole file.
    header : Header
        Its head.
    """
    body = memoryview(data)[:-CHECKSUM_BYTES]
    sound = len(data) >= header.length + CHECKSUM_BYTES and (
        zlib.crc32(body) == struct.unpack_from("<I", data, len(data) - CHECKSUM_BYTES)[0]
    )
    walk = _walk(data, header, len(body) if sound else len(data))
    findings = _damage(walk, sound)
    found = {
        one.number: _records(data, one, np.asarray(walk.places[one.number], dtype=np.int64))
        for one in header.types
        if walk.places[one.number]
    }
    if not found:
        return [], findings
    start = min(_middle(records["stamp"]) for records in found.values())
    times = {key: _seconds(records["stamp"], start, header.tick_s) for key, records in found.items()}
    usable = {key: believable(time_s) for key, time_s in times.items()}
    begins = min(float(times[key][which][0]) for key, which in usable.items() if which.any())
    lost = sum(int((~which).sum()) for which in usable.values())
    if lost:
        findings.append(Finding("time_stamps", f"Records left out, because their stamp cannot be: {lost}."))
    events = [
        Event(one.name, one.variables, found[key][usable[key]], times[key][usable[key]] - begins)
        for one in header.types
        if (key := one.number) in found and usable[key].any()
    ]
    return events, findings


def _walk(data: bytes, header: Header, end: int) -> _Walk:
    sizes = {one.number: one.record.itemsize for one in header.types}
    walk = _Walk({number: array("q") for number in sizes})
    unpack = struct.Struct("<H").unpack_from
    position, run, last = header.length, 0, -1
    while position + 2 <= end:
        number = unpack(data, position)[0]
        size = sizes.get(number)
        if size is None:
            resumed = _resumed(data, position + 1, end, header, walk)
            if resumed is None:
                break
            walk.skipped += resumed - position
            position, run = resumed, 0
            continue
        if position + size > end:
            break
        walk.places[number].append(position)
        position += size
        run = run + 1 if number == last else 0
        last = number
        if run >= RUN:
            more = _run_length(data, position, end, number, size)
            walk.places[number].extend(range(position, position + more * size, size))
            position, run = position + more * size, 0
    walk.left = max(end - position, 0)
    return walk


def _run_length(data: bytes, position: int, end: int, number: int, size: int) -> int:
    """How many whole records of one type stand at a place in a row, at most `BLOCK`."""
    count = min((end - position) // size, BLOCK)
    if count == 0:
        return 0
    ids = np.ndarray((count,), dtype="<u2", buffer=data, offset=position, strides=(size,))
    other = np.flatnonzero(ids != number)
    return int(other[0]) if other.size else count


def _resumed(data: bytes, position: int, end: int, header: Header, walk: _Walk) -> int | None:
    """Where the next records begin that follow each other; None when they are not found."""
    sizes = {one.number: one.record.itemsize for one in header.types}
    if not sizes:
        return None
    while walk.searched < MAX_SEARCH_BYTES and position < end:
        walk.searched += SEARCH_BLOCK
        for place in _candidates(data, position, end, header, walk):
            if _follow(data, place, end, sizes):
                return place
        position += SEARCH_BLOCK
    return None


def _candidates(data: bytes, position: int, end: int, header: Header, walk: _Walk) -> list[int]:
    """Places in a block at which an id stands that is known, before a stamp that can be of this log."""
    stamp = header.types[0].record["stamp"]
    count = min(SEARCH_BLOCK, end - position - 1 - stamp.itemsize)
    if count <= 0:
        return []
    ids = np.ndarray((count,), dtype="<u2", buffer=data, offset=position, strides=(1,))
    plausible = np.isin(ids, [one.number for one in header.types])
    begun = [places[0] for places in walk.places.values() if places]
    if begun:
        stamps = np.ndarray((count,), dtype=stamp, buffer=data, offset=position + 2, strides=(1,))
        first = int(np.ndarray((1,), dtype=stamp, buffer=data, offset=min(begun) + 2)[0])
        time_s = _seconds(stamps, first, header.tick_s)
        plausible &= (time_s >= 0.0) & (time_s <= LONGEST_LOG_S)
    return [position + int(offset) for offset in np.flatnonzero(plausible)]


def _follow(data: bytes, position: int, end: int, sizes: Mapping[int, int]) -> bool:
    """Say whether several records follow each other from a place on, or up to the end."""
    for _ in range(CHAIN):
        if position + 2 > end:
            return position == end
        size = sizes.get(struct.unpack_from("<H", data, position)[0])
        if size is None or position + size > end:
            return False
        position += size
    return True


def _damage(walk: _Walk, sound: bool) -> list[Finding]:
    """Say what the checksum and the walk show."""
    findings = []
    complete = sound or walk.left == CHECKSUM_BYTES
    left = 0 if walk.left == CHECKSUM_BYTES and not sound else walk.left
    if not complete:
        rest = (
            f"{left} bytes at its end, of no whole record, were left out" if left else "no record is broken"
        )
        findings.append(
            Finding(
                "truncated",
                f"The log has no checksum at its end: it was cut ({rest}). End the logging before the power "
                "goes (usd.logging = 0).",
            )
        )
    elif not sound:
        findings.append(
            Finding(
                "checksum",
                "The checksum does not fit: bytes of the log were changed or lost, and values may be wrong.",
            )
        )
    skipped = walk.skipped + (left if sound else 0)
    if skipped:
        findings.append(
            Finding(
                "corrupt_parts", f"Damaged parts were left out: {skipped} bytes that belong to no record."
            )
        )
    return findings


def _records(data: bytes, kind: EventType, places: np.ndarray) -> np.ndarray:
    """Records of one type, copied together."""
    size = kind.record.itemsize
    anywhere = np.ndarray((len(data) - size + 1,), dtype=kind.record, buffer=data, strides=(1,))
    return anywhere[places]


def _seconds(stamps: np.ndarray, start: int, tick_s: float) -> Float[np.ndarray, " n"]:
    """Seconds since a stamp, by the shorter way round where the counter has wrapped."""
    signed = np.dtype(f"<i{stamps.dtype.itemsize}")
    with np.errstate(over="ignore"):
        ticks = (stamps - stamps.dtype.type(start)).view(signed)
    return np.asarray(ticks.astype(np.float64) * tick_s)


def _middle(stamps: np.ndarray) -> int:
    """Median of the stamps, which one that is damaged does not move far."""
    return int(np.partition(stamps, stamps.size // 2)[stamps.size // 2])
