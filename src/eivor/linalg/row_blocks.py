"""How many rows are worked on at a time, settled here for all rooms, and the blocks that this makes.

The sizes trade calls against memory. Sums are added block by block: another size rounds differently.
"""

from __future__ import annotations

from collections.abc import Iterator

#: Rows that pass through several steps: a dozen columns of them fit in a second-level cache.
PASSED_ROWS = 16_384
#: Rows that are multiplied with each other: a few columns of them fit.
MULTIPLIED_ROWS = 32_768
#: Rows of which a copy is made: so many that calls cost nothing, so few that the copy is small.
COPIED_ROWS = 65_536


def row_blocks(first: int, stop: int, size: int) -> Iterator[tuple[int, int]]:
    """First row of each block from `first` to `stop`, and the row after its last.

    Parameters
    ----------
    first, stop : int
        First row of all, and the row after the last.
    size : int
        Rows of every block but the last, which may have fewer.
    """
    for start in range(first, stop, size):
        yield start, min(start + size, stop)
