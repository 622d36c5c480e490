"""The messages of a topic as columns of numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.logs.bags.layouts import Layout, UnsoundMessageError
from eivor.shapes import Bool, Int

#: Layouts that the messages of one topic may have, those that are none included; more are left out.
MAX_LAYOUTS = 256


@dataclass(frozen=True, slots=True)
class Decoded:
    """Messages of a topic.

    Parameters
    ----------
    fields : mapping of str to ndarray, shape (n,)
        Columns that all of the messages have, by the full name of the field, in the order of the record.
    places : ndarray, shape (n,)
        Which of the messages they are.
    reason : str
        Why others are none; empty when there are no others.
    """

    fields: Mapping[str, np.ndarray]
    places: Int[np.ndarray, " n"]
    reason: str


def decoded(payloads: Sequence[bytes], layout_of: Callable[[bytes], Layout]) -> Decoded:
    """Read the messages of a topic.

    Parameters
    ----------
    payloads : sequence of bytes
        The messages.
    layout_of : callable
        Gives the layout of one, or raises `UnsoundMessageError`.
    """
    tables: list[tuple[list[int], np.ndarray]] = []
    reason, tried = "", 0
    by_length: dict[int, list[int]] = {}
    for place, payload in enumerate(payloads):
        by_length.setdefault(len(payload), []).append(place)
    for waiting in by_length.values():
        rest = waiting
        while rest and tried < MAX_LAYOUTS:
            tried += 1
            try:
                layout = layout_of(payloads[rest[0]])
            except UnsoundMessageError as error:
                reason, rest = reason or str(error), rest[1:]
                continue
            joined = b"".join([payloads[place] for place in rest])
            alike = _alike(joined, layout, len(rest))
            same = [place for place, is_so in zip(rest, alike.tolist(), strict=True) if is_so]
            if len(same) < len(rest):
                joined = b"".join([payloads[place] for place in same])
                rest = [place for place, is_so in zip(rest, alike.tolist(), strict=True) if not is_so]
            else:
                rest = []
            tables.append((same, layout.table(joined)))
        if rest:
            reason = reason or f"they have more than {MAX_LAYOUTS} layouts"
    return _merged(tables, reason)


def _alike(joined: bytes, layout: Layout, count: int) -> Bool[np.ndarray, " n"]:
    """Which messages are written as the first is, with texts and sequences of the same lengths."""
    rows = np.frombuffer(joined, np.uint8).reshape(count, layout.size)
    same = np.ones(count, dtype=np.bool_)
    for place in layout.lengths:
        same &= np.all(rows[:, place : place + 4] == rows[0, place : place + 4], axis=1)
    return same


def _merged(tables: list[tuple[list[int], np.ndarray]], reason: str) -> Decoded:
    if not tables:
        return Decoded({}, np.empty(0, dtype=np.int64), reason)
    places = np.concatenate([np.array(one, dtype=np.int64) for one, _ in tables])
    order = np.argsort(places, kind="stable")
    names = tables[0][1].dtype.names or ()
    shared = [name for name in names if all(name in (table.dtype.names or ()) for _, table in tables)]
    fields = {name: np.concatenate([table[name] for _, table in tables])[order] for name in shared}
    return Decoded(fields, places[order], reason)
