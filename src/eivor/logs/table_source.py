"""What the table readers share: the layout of a table, and its columns as arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from eivor.errors import CorruptLogError
from eivor.signals.recording import Finding

#: More columns than any log has; a header beyond it is not one.
MAX_COLUMNS = 4096


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
    """

    values: Mapping[str, Float[np.ndarray, " n"]]
    unreadable: Mapping[str, int] = field(default_factory=dict)
    seconds: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class TableSource:
    """A table whose header has been read.

    Parameters
    ----------
    names : tuple of str
        Columns, in their order.
    read : callable
        Reads some columns, by name.
    findings : tuple of Finding
        What the header and the layout showed.
    metadata : str
        What `write_recording` left in the file, as JSON; empty when nothing did.
    """

    names: tuple[str, ...]
    read: Callable[[Sequence[str]], Columns]
    findings: tuple[Finding, ...] = ()
    metadata: str = ""


def corrupt_table(name: str, reason: str, remedy: str) -> CorruptLogError:
    """Return the error for a table that cannot be read."""
    return CorruptLogError("a readable table", f"'{name}', {reason}", remedy)
