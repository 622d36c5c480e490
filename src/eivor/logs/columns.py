"""Columns of numbers: what every reader of tables hands to a channel map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a table as numbers.

    Parameters
    ----------
    values : mapping of str to ndarray, shape (n,)
        By column name, in the logged unit; NaN where the table has no number.
    unreadable : mapping of str to int
        Number of cells, by column, that hold a text which is no number.
    seconds : frozenset of str
        Columns that hold points in time and have been turned into seconds.
    lists : mapping of str to str
        The first cell of columns whose cells are lists, which are no numbers.
    """

    values: Mapping[str, Float[np.ndarray, " n"]]
    unreadable: Mapping[str, int] = field(default_factory=dict)
    seconds: frozenset[str] = frozenset()
    lists: Mapping[str, str] = field(default_factory=dict)
