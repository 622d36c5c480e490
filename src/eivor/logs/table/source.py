"""What the table readers share: a table whose header has been read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from eivor.errors import CorruptLogError
from eivor.logs.columns import Columns
from eivor.signals.recording import Finding

#: More columns than any log has; a header beyond it is not one.
MAX_COLUMNS = 4096


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
