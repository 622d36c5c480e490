"""Elements of columns whose cells are lists: ``v[2]`` is the third number in each cell of ``v``."""

from __future__ import annotations

import re
from collections.abc import Sequence

_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]")


def element_name(column: str, index: int) -> str:
    """Return the name of an element of a column."""
    return f"{column}[{index}]"


def element_of(name: str, columns: Sequence[str]) -> tuple[str, int] | None:
    """Return the column and the place that a name means; None for a column of its own, or of none.

    Parameters
    ----------
    name : str
        As a channel map has it.
    columns : sequence of str
        Columns of the table.
    """
    match = _ELEMENT.fullmatch(name)
    if match is None or name in columns or match[1] not in columns:
        return None
    return match[1], int(match[2])


def with_elements(needed: Sequence[str], columns: Sequence[str]) -> list[str]:
    """Return the columns of a table, and after them the elements of them that are needed."""
    found = [name for name in dict.fromkeys(needed) if element_of(name, columns) is not None]
    return [*columns, *found]
