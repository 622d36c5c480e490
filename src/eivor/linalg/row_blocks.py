"""How many rows are worked on at a time, settled here for all rooms, and the blocks that this makes.

The sizes trade calls against memory. Sums are added block by block: another size rounds differently.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

Block = TypeVar("Block")
Made = TypeVar("Made")

#: Rows that pass through several steps: a dozen columns of them fit in a second-level cache.
PASSED_ROWS = 16_384
#: Rows that are multiplied with each other: a few columns of them fit.
MULTIPLIED_ROWS = 32_768
#: Rows of which a copy is made: so many that calls cost nothing, so few that the copy is small.
COPIED_ROWS = 65_536
#: Fewer blocks are not worth threads.
THREADED_FROM = 8


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


def made_ahead(make: Callable[[Block], Made], blocks: Iterable[Block]) -> Iterator[Made]:
    """What is made of each block, in order; of many blocks by threads, a few ahead of what is used.

    Parameters
    ----------
    make : callable
        Makes something of one block, without side effects. What it makes does not depend on the threads.
    blocks : iterable
        The blocks.
    """
    remaining = iter(blocks)
    first = list(islice(remaining, THREADED_FROM))
    if len(first) < THREADED_FROM:
        yield from map(make, first)
        return
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Made]] = deque()
        for block in chain(first, remaining):
            waiting.append(pool.submit(make, block))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
