"""How the autocovariance of fractional noise grows with the age of its record.

E[x(m) x(m + lag)] = sum_{q <= m} a_q a_{q + lag} for white noise of unit variance behind the operator.
A record that is read in chunks asks for stretches of it far from the beginning, so the state at the
beginning of each block is kept: any stretch costs its own length, and the whole record is linear.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from eivor.shapes import Float

BLOCK = 4_096


@dataclass(slots=True)
class GrowthTable:
    """Autocovariance of one order at one lag, block by block.

    Parameters
    ----------
    order : float
        Exponent of Delta.
    lag : int
        Samples between the two factors.
    states : list of (sum, a_q, a_{q + lag})
        Before each block: the sum so far and the two weights of its first term.
    """

    order: float
    lag: int
    states: list[tuple[float, float, float]] = field(default_factory=list)

    def stretch(self, start: int, count: int) -> Float[np.ndarray, " count"]:
        """Values for m = start .. start + count - 1."""
        first, last = start // BLOCK, (start + count - 1) // BLOCK
        parts = [self._block(number) for number in range(first, last + 1)]
        offset = start - first * BLOCK
        return np.concatenate(parts)[offset : offset + count]

    def _block(self, number: int) -> Float[np.ndarray, " block"]:
        while len(self.states) <= number + 1:
            self._extend()
        total, a, a_lagged = self.states[number]
        products = self._weights(number * BLOCK, a) * self._weights(number * BLOCK + self.lag, a_lagged)
        growth: Float[np.ndarray, " block"] = total + np.cumsum(products[:BLOCK])
        return growth

    def _extend(self) -> None:
        """Add the state before the next block."""
        if not self.states:
            self.states.append((0.0, 1.0, float(self._weights(0, 1.0, self.lag + 1)[-1])))
            return
        number = len(self.states) - 1
        total, a, a_lagged = self.states[number]
        own = self._weights(number * BLOCK, a)
        lagged = self._weights(number * BLOCK + self.lag, a_lagged)
        total += float(np.sum(own[:BLOCK] * lagged[:BLOCK]))
        self.states.append((total, float(own[BLOCK]), float(lagged[BLOCK])))

    def _weights(self, first: int, value: float, count: int = BLOCK + 1) -> Float[np.ndarray, " count"]:
        """Weights a_first .. by their recursion, from the first one's value."""
        j = np.arange(first + 1, first + count)
        return np.cumprod(np.concatenate([[value], (j - 1 - self.order) / j]))


@lru_cache(maxsize=256)
def growth_table(order: float, lag: int) -> GrowthTable:
    """Table of that order and lag, shared by all who ask: its content does not depend on who did."""
    return GrowthTable(order, lag)
