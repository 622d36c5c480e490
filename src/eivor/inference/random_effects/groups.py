"""Rows that belong together: groups of consecutive rows, none of them empty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.shapes import Float, Int


@dataclass(frozen=True)
class Groups:
    """Consecutive rows of groups.

    Parameters
    ----------
    sizes : ndarray of int, shape (groups,)
        Rows of each group, at least one.
    """

    sizes: Int[np.ndarray, " groups"]

    @cached_property
    def starts(self) -> Int[np.ndarray, " groups"]:
        """First row of each group."""
        return np.cumsum(self.sizes) - self.sizes

    def sums(self, values: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " groups"]:
        """Sum over each group."""
        return np.add.reduceat(values, self.starts)

    def spread(self, values: Float[np.ndarray, " groups"]) -> Float[np.ndarray, " rows"]:
        """Value of its group, for each row."""
        return np.repeat(values, self.sizes)

    def running(self, values: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Sum over the rows of its group up to each row, that row included."""
        total = np.cumsum(values)
        before = np.concatenate(([0.0], total))[self.starts]
        return total - self.spread(before)


def one_group(rows: int) -> Groups:
    """All rows together."""
    return Groups(np.array([rows]))
