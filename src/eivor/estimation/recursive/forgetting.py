"""Exponential forgetting: a row counts less by one factor with every sample that comes after it.

With the factor lambda a row that is k samples old has the weight lambda^k. The weights add up to the *memory*
1 / (1 - lambda), and estimates scatter as those of (sum of weights)^2 / (sum of squared weights) =
(1 + lambda) / (1 - lambda) rows do, the *effective rows*: about twice the memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.shapes import Float

#: Memory [samples] when none is chosen: a factor of 0.995.
DEFAULT_MEMORY = 200.0
#: Shortest and longest memory [samples]: rows of a block wait in arrays, and a block is a part of the memory.
MEMORIES = (10.0, 1e7)
#: Blocks that a memory is divided into, and memories whose blocks are kept apart: older ones count e^-8.
BLOCKS_PER_MEMORY, MEMORIES_KEPT = 24, 8
#: Blocks that a change is looked for in at once: an eighth of the memory.
BLOCKS_PER_LOOK = 3


@dataclass(frozen=True, slots=True)
class Forgetting:
    """How fast rows are forgotten.

    Parameters
    ----------
    memory : float
        Sum of the weights of all rows before, 1 / (1 - lambda) [samples].

    Raises
    ------
    UsageError
        When it is no number from 10 to 1e7.
    """

    memory: float = DEFAULT_MEMORY

    def __post_init__(self) -> None:
        checks.number("memory", self.memory)
        least, most = MEMORIES
        if not least <= self.memory <= most:
            raise UsageError(
                f"a memory of {least:g} to {most:g} samples",
                f"{self.memory:g}",
                "It is 1 / (1 - lambda): 200 for a forgetting factor of 0.995.",
            )

    @property
    def factor(self) -> float:
        """Weight of a row over that of the row after it, lambda."""
        return 1.0 - 1.0 / self.memory

    @property
    def effective_rows(self) -> float:
        """Rows of equal weight whose mean scatters as much."""
        return (1.0 + self.factor) / (1.0 - self.factor)

    @property
    def block(self) -> int:
        """Samples of a block."""
        return max(int(self.memory / BLOCKS_PER_MEMORY), 1)

    @property
    def kept_blocks(self) -> int:
        """Blocks that are kept apart."""
        return int(np.ceil(MEMORIES_KEPT * self.memory / self.block))

    @property
    def look(self) -> int:
        """Samples that a change is looked for in at once."""
        return self.block * BLOCKS_PER_LOOK

    def weights(self, count: int) -> Float[np.ndarray, " count"]:
        """Weights of successive samples after the last of them."""
        weights: Float[np.ndarray, " count"] = self.factor ** np.arange(count - 1, -1, -1.0)
        return weights
