"""Tables of numbers beside pictures."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from eivor.report.document import Cell, TableColumn, TableOf
from eivor.report.wording import NO_NUMBER


def number_table(titles: Iterable[str], rows: Iterable[Iterable[float | str | Cell]]) -> TableOf:
    """Table of numbers, and of words where a row has them.

    Parameters
    ----------
    titles : iterable of str
        Of the columns, with their units.
    rows : iterable of iterables of float, str or Cell
        Numbers are written to four significant digits.
    """
    told = tuple(tuple(one if isinstance(one, Cell) else Cell(_told(one)) for one in row) for row in rows)
    left = {place for row in told for place, cell in enumerate(row) if cell.text and cell.text[0].isalpha()}
    columns = (
        TableColumn(title, right=place not in left, whole=place not in left)
        for place, title in enumerate(titles)
    )
    return TableOf(tuple(columns), told)


def _told(one: float | str) -> str:
    if isinstance(one, str):
        return one
    return f"{one:.4g}".replace("-", "−") if np.isfinite(one) else NO_NUMBER
