"""Rows that a resampling tool made up: straight lines to the end of a table.

A tool that puts streams of several clocks on one grid continues a stream that has stopped by a straight
line, for as long as the longest stream lasts. Such rows look like data, and after a while like an
overflow. A measurement never runs along an exact sloping line, and several never begin to do so at the
same instant; where they do, the values are taken as missing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.shapes import Float
from eivor.signals.recording import Finding

#: Fewest rows of a line, fewest columns that begin one together, and what "together" means [rows].
MIN_ROWS = 50
MIN_COLUMNS = 3
TOGETHER_ROWS = 5


def without_extrapolation(
    time_s: Float[np.ndarray, " n"], columns: Mapping[str, Float[np.ndarray, " n"]]
) -> tuple[dict[str, Float[np.ndarray, " n"]], Finding | None]:
    """Return the columns with made-up values as NaN, and what was found.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Stamps of the rows [s].
    columns : mapping of str to ndarray, shape (n,)
        Columns of the table, in any unit.
    """
    starts = {name: _line_start(time_s, values) for name, values in columns.items()}
    begun = {name: start for name, start in starts.items() if start is not None}
    if len(begun) < MIN_COLUMNS:
        return dict(columns), None
    middle = int(np.median(list(begun.values())))
    together = [name for name, start in begun.items() if abs(start - middle) <= TOGETHER_ROWS]
    # four rotors on one commanded ramp are one line, not four
    different = {tuple(columns[name][-2:]) for name in together}
    if len(different) < MIN_COLUMNS:
        return dict(columns), None
    cleaned = dict(columns)
    for name in together:
        cleaned[name] = np.where(np.arange(time_s.size) > begun[name], np.nan, columns[name])
    named = ", ".join(map(repr, together))
    message = (
        f"From {time_s[middle]:.2f} s to the end, {len(together)} columns are straight lines ({named}): made "
        "up by a resampling tool after the stream had stopped, and taken as missing."
    )
    return cleaned, Finding("extrapolated", message)


def _line_start(time_s: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> int | None:
    """Row at which an exact sloping line to the last row begins; None when there is none of `MIN_ROWS`."""
    if values.size < 2 * MIN_ROWS:
        return None
    with np.errstate(all="ignore"):
        slopes = np.diff(values) / np.diff(time_s)
        last = slopes[-1]
        on_line = np.abs(slopes - last) <= 1e-5 * np.abs(last)
    if not np.isfinite(last) or last == 0.0 or on_line.all():
        return None
    start = int(np.flatnonzero(~on_line)[-1]) + 1
    return start if values.size - start >= MIN_ROWS else None
