"""The messages of a type as columns, which are taken out of the file when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.linalg.row_blocks import COPIED_ROWS, row_blocks
from eivor.logs.dataflash.layouts import Layout
from eivor.shapes import Bool, Float

#: Clocks, and the seconds in one tick of each; firmware up to 3.3 counts milliseconds.
CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
#: Messages that are together no larger are taken out of a file once, others column by column [bytes] ...
KEPT_BYTES = 1 << 24
#: ... and all of them column by column, where the file is larger than this [bytes].
LONG_FILE_BYTES = 1 << 27


@dataclass(frozen=True)
class Messages:
    """All messages of a type, or of one instance of it.

    Parameters
    ----------
    layout : Layout
        Of the type.
    data : ndarray of uint8
        The file.
    places : ndarray, shape (n,)
        Where each message begins.
    """

    layout: Layout
    data: np.ndarray
    places: np.ndarray

    @property
    def name(self) -> str:
        """Name of the type."""
        return self.layout.name

    @property
    def count(self) -> int:
        """Number of messages."""
        return int(self.places.size)

    @property
    def clock(self) -> str:
        """Column of the stamps; empty when there is none."""
        return next((name for name in CLOCKS if self.has(name)), "")

    def has(self, *columns: str) -> bool:
        """Say whether it has all of some columns."""
        return all(column in self.layout.fields for column in columns)

    def stored(self, column: str) -> np.ndarray:
        """Return a column as it is stored."""
        field = self.layout.fields[column]
        if not self.count:
            return np.empty(0, field.kind)
        if self.count * self.layout.length > KEPT_BYTES or self.data.size > LONG_FILE_BYTES:
            return self._taken(field.kind, field.offset)
        kept = np.ndarray((self.count,), field.kind, self._whole, field.offset, (self.layout.length,))
        return np.array(kept)

    @cached_property
    def _whole(self) -> np.ndarray:
        """All messages, one after the other: most of the time is that of finding each in the file."""
        return self._taken(np.dtype((np.void, self.layout.length)), 0)

    def _taken(self, kind: np.dtype[np.generic], offset: int) -> np.ndarray:
        """What is in each message from a byte on."""
        anywhere = np.ndarray((self.data.size - self.layout.length + 1,), kind, self.data, offset, (1,))
        taken = np.empty((self.count, *kind.shape), kind.base)
        for start, stop in row_blocks(0, self.count, COPIED_ROWS):
            taken[start:stop] = anywhere[self.places[start:stop]]
        return taken

    def values(self, column: str) -> Float[np.ndarray, " n"]:
        """Return a column as numbers, in its unit."""
        factor = self.layout.fields[column].factor
        with np.errstate(invalid="ignore", over="ignore"):
            values = self.stored(column).astype(np.float64)
            values *= factor
        return np.asarray(values)

    def texts(self, column: str) -> list[str]:
        """Return a column of texts."""
        return [text.decode("latin-1").rstrip("\0") for text in self.stored(column).tolist()]

    def time_s(self) -> Float[np.ndarray, " n"]:
        """Return the stamps [s], from the autopilot's start on."""
        stamps = self.values(self.clock)
        stamps *= CLOCKS[self.clock]
        return stamps

    def where(self, chosen: Bool[np.ndarray, " n"]) -> Messages:
        """Return some of the messages."""
        return self if chosen.all() else replace(self, places=self.places[chosen])
