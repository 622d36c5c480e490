"""The messages of a type as columns, which are taken out of the file when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.logs.dataflash.layouts import Layout
from eivor.shapes import Bool, Float

#: Clocks, and the seconds in one tick of each; firmware up to 3.3 counts milliseconds.
CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}


@dataclass(frozen=True, slots=True)
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
        anywhere = np.ndarray(
            (self.data.size - self.layout.length + 1,), field.kind, self.data, field.offset, (1,)
        )
        return np.asarray(anywhere[self.places])

    def values(self, column: str) -> Float[np.ndarray, " n"]:
        """Return a column as numbers, in its unit."""
        factor = self.layout.fields[column].factor
        with np.errstate(invalid="ignore", over="ignore"):
            values = self.stored(column).astype(np.float64)
        return np.asarray(values if factor == 1.0 else values * factor)

    def texts(self, column: str) -> list[str]:
        """Return a column of texts."""
        return [text.decode("latin-1").rstrip("\0") for text in self.stored(column).tolist()]

    def time_s(self) -> Float[np.ndarray, " n"]:
        """Return the stamps [s], from the autopilot's start on."""
        return self.values(self.clock) * CLOCKS[self.clock]

    def where(self, chosen: Bool[np.ndarray, " n"]) -> Messages:
        """Return some of the messages."""
        return self if chosen.all() else replace(self, places=self.places[chosen])
