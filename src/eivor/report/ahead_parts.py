"""Predictions some tenths of a second ahead in documents: a table by horizon, and what it lacks."""

from __future__ import annotations

import math

from eivor.flights.ahead import Ahead
from eivor.report.document import Bullets, Cell, Part, TableColumn, TableOf

#: Units that people read angles in, with what numbers are multiplied by.
SHOWN_IN = {"rad": ("deg", math.degrees(1.0)), "rad/s": ("deg/s", math.degrees(1.0))}


def shown_in(unit: str) -> tuple[str, float]:
    """Unit to show what is in another one, and what its numbers are multiplied by."""
    return SHOWN_IN.get(unit, (unit, 1.0))


def ahead_rows(ahead: Ahead) -> list[tuple[str, ...]]:
    """Quantity, model, shown unit, and root mean square errors by horizon, of every prediction."""
    rows = []
    for one in ahead.errors:
        unit, times = shown_in(one.unit)
        rows.append((one.quantity, one.words, unit, *(f"{times * error:.3g}" for error in one.rms)))
    return rows


def ahead_parts(ahead: Ahead, *, sentence: bool = True) -> tuple[Part, ...]:
    """Root mean square errors of every quantity and model by horizon, and what is left out.

    Parameters
    ----------
    ahead : Ahead
        The predictions.
    sentence : bool
        Whether what was found is said besides.
    """
    said = (ahead.sentence,) if sentence and ahead.errors else ()
    table = (_table(ahead),) if ahead.errors else ()
    bullets = (*said, *ahead.left_out)
    return (*table, Bullets(bullets)) if bullets else table


def _table(ahead: Ahead) -> TableOf:
    horizons = (TableColumn(f"{one:g} s", right=True, whole=True) for one in ahead.horizons_s)
    columns = (TableColumn("RMS error of", whole=True), TableColumn("by"), *horizons)
    rows, before = [], ""
    for quantity, words, unit, *errors in ahead_rows(ahead):
        first = "" if quantity == before else f"{quantity} [{unit}]"
        rows.append(tuple(map(Cell, (first, words, *errors))))
        before = quantity
    return TableOf(columns, tuple(rows))
