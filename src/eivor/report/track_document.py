"""The document of a track: a parameter over a flight, as a line of marks and as a table, and its changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from eivor.flights.track import HELD, TOLD, Moment, Track
from eivor.report.document import Bullets, Cell, Document, Fact, Facts, Section, TableColumn, TableOf, Tone
from eivor.report.flight_document import section
from eivor.report.wording import NO_NUMBER, plain_numbers

#: Marks of a line, lowest first, and that of a time at which nothing is told.
MARKS, UNTOLD = "▁▂▃▄▅▆▇█", "·"
#: Marks of a line, and rows of a table, at most.
LINE, ROWS = 60, 16
#: Narrowest range that a line of marks spans, over the middle value: smaller ups and downs are no news.
FLAT = 0.1


def track_document(track: Track) -> Document:
    """Document of a track."""
    (flight,) = track.result.prepared
    told = (
        f"{len(track.told)} of {len(track.moments)} moments tell it"
        if track.moments
        else "no moment tells it"
    )
    return Document(
        flight.recording.name, None, f"{_called(track)} over the flight: {told}", tuple(_sections(track))
    )


def _called(track: Track) -> str:
    if not track.name:
        return "Nothing"
    wording = track.result.motion.wording[track.name]
    return f"{wording.words} {wording.symbol}"


def _sections(track: Track) -> Iterator[Section]:
    if track.moments:
        yield Section("", (_line(track), _table(track)))
    yield from section("Changes", Bullets, changes_told(track))
    yield from section("Not told", Bullets, untold(track))
    yield from section("Taken as known", Bullets, (*_at(track), *track.known))


def changes_told(track: Track) -> Iterator[str]:
    """Return a sentence about each change; one where there is none."""
    for one in track.changes:
        before, after = _beside(track, one)
        share = (
            f" by {abs(100.0 * (after / before - 1.0)):.0f} %"
            if before is not None and after is not None
            else ""
        )
        yield (
            f"Told at {one.time_s:.1f} s, and up to {track.memory_s:g} s older than that: "
            f"the {_called(track)} {'rose' if one.change > 0 else 'fell'}{share}."
        )
    if track.told and not track.changes:
        yield "None: what moved, moved slowly or within its band."


def _beside(track: Track, change: Moment) -> tuple[float | None, float | None]:
    """Values told a memory before a change, since it may be as old, and after it, within a memory."""
    before = [one.value for one in track.told if one.time_s < change.time_s - track.memory_s]
    after = [
        one.value
        for one in track.told
        if change.time_s + 0.25 * track.memory_s < one.time_s < change.time_s + track.memory_s
    ]
    return (before[-1] if before else None, after[-1] if after else None)


def untold(track: Track) -> Iterator[str]:
    """Why the parameter is not told, where it is not."""
    if not track.moments:
        yield from (f"{reason.sentence} {reason.remedy}" for reason in track.result.verdict.reasons)
        return
    for start, stop in _stretches(track):
        here = track.moments[start:stop]
        ends = f"{here[0].time_s:.1f} to {here[-1].time_s:.1f} s"
        empty = sum(one.share < HELD for one in here)
        if 2 * empty >= len(here):
            why = "hardly any sample of the memory before is of flight that can be used"
        else:
            why = f"the interval is wider than ±{100.0 * TOLD:.0f} %; a longer memory narrows it (--memory)"
        yield f"{ends}: {why}."


def _stretches(track: Track) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff([0, *(not one.told for one in track.moments), 0]))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _at(track: Track) -> Iterator[str]:
    if track.at:
        values = ", ".join(
            f"{name.replace('_', ' ')} {1e3 * value:.0f} ms" for name, value in track.at.items()
        )
        yield f"Followed at {values}, with a memory of {track.memory_s:g} s."


def marks(values: Sequence[float], told: Sequence[bool]) -> str:
    """Line of marks: the least value told is the lowest, the largest the highest."""
    seen = np.array([value for value, is_told in zip(values, told, strict=True) if is_told])
    if not seen.size:
        return UNTOLD * len(values)
    middle = 0.5 * float(seen.min() + seen.max())
    span = max(float(np.ptp(seen)), FLAT * abs(middle))
    low = middle - 0.5 * span
    return "".join(
        MARKS[min(int((value - low) / span * len(MARKS)), len(MARKS) - 1)] if is_told else UNTOLD
        for value, is_told in zip(values, told, strict=True)
    )


def _thinned(track: Track, most: int) -> list[Moment]:
    """Moments evenly spread, changes among them."""
    step = max(1, -(-len(track.moments) // most))
    return [one for number, one in enumerate(track.moments) if one.change or number % step == step - 1]


def _line(track: Track) -> Facts:
    shown = _thinned(track, LINE)
    line = marks([one.value for one in shown], [one.told for one in shown])
    ends = f"{track.moments[0].time_s:.1f} to {track.moments[-1].time_s:.1f} s"
    symbol = track.result.motion.wording[track.name].symbol
    return Facts((Fact(symbol, line), Fact("", f"{ends}; {UNTOLD} is not told")))


def _table(track: Track) -> TableOf:
    wording = track.result.motion.wording[track.name]
    columns = (
        TableColumn("time [s]", strong=True),
        TableColumn(f"{wording.symbol} [{wording.shown_unit or wording.unit}]", right=True, whole=True),
        TableColumn("95 % interval", whole=True),
        TableColumn("of the first told", right=True),
        TableColumn("", below=Tone.WARNING),
    )
    first = track.told[0].value if track.told else None
    rows = []
    for one in _thinned(track, ROWS):
        value, interval = NO_NUMBER, NO_NUMBER
        if one.told:
            scaled = wording.scale * one.value, wording.scale * one.half_width
            value, interval = plain_numbers(scaled[0], (scaled[0] - scaled[1], scaled[0] + scaled[1]))
        share = f"{100.0 * one.value / first:.0f} %" if one.told and first else ""
        note = {1: "rose", -1: "fell", 0: ""}[one.change]
        rows.append((Cell(f"{one.time_s:.1f}"), Cell(value), Cell(interval), Cell(share), Cell(note)))
    return TableOf(columns, tuple(rows))
