"""Search of the least of a cheap function: on a grid, then in boxes that shrink around the least.

For functions that cost little more at many points than at one. The box reaches to the neighbours of the
least on the grid. Where the least in a box lies at its edge the box follows it and grows; else it shrinks
to that point's neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eivor.errors import ConvergenceError
from eivor.shapes import Float, Int

#: Axes of a box: one increasing array for each variable.
Box = Sequence[Float[np.ndarray, " _"]]
#: From a box to the values at its points, the last axis the fastest.
Objective = Callable[[Box], Float[np.ndarray, " points"]]

#: Points of a box on one axis, at most and at least; and of a box of several axes about so many.
MOST, LEAST, POINTS = 33, 5, 200
#: The search ends where a box's points are so close, as a share of the first box.
FINEST = 2.0**-17
#: Boxes before a search is given up.
ROUNDS = 100


def least_place(objective: Objective, grid: Box) -> Float[np.ndarray, " axes"]:
    """Place of the least value between the ends of a grid.

    Parameters
    ----------
    objective : callable
        See `Objective`.
    grid : sequence of ndarray
        Where to begin: two places or more for each variable, or no variable at all.

    Raises
    ------
    ConvergenceError
        When the boxes do not shrink.
    """
    axes = len(grid)
    if not axes:
        return np.empty(0)
    best = _best(objective, grid)
    low, high = (
        np.array([axis[np.clip(at + step, 0, axis.size - 1)] for axis, at in zip(grid, best, strict=True)])
        for step in (-1, 1)
    )
    bottom, top = (np.array([axis[end] for axis in grid]) for end in (0, -1))
    first, points = high - low, _points(axes)
    for _ in range(ROUNDS):
        box = [np.linspace(a, b, points) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
        best = _best(objective, box)
        place = np.array([axis[at] for axis, at in zip(box, best, strict=True)])
        spacing = (high - low) / (points - 1)
        at_edge = ((best == 0) & (low > bottom)) | ((best == points - 1) & (high < top))
        if not at_edge.any() and (spacing <= FINEST * first).all():
            return place
        reach = np.where(at_edge, 1.0, 0.5) * (high - low) if at_edge.any() else spacing
        low, high = np.maximum(place - reach, bottom), np.minimum(place + reach, top)
    raise ConvergenceError(
        f"a search of {axes} variables that settles",
        f"one that still moves after {ROUNDS} boxes",
        "Give narrower grids, or more exciting data.",
    )


def _points(axes: int) -> int:
    """Points of a box on each axis, an odd number, so that its middle is one of them."""
    points = min(int(POINTS ** (1.0 / axes)), MOST)
    return max(points - 1 + points % 2, LEAST)


def _best(objective: Objective, box: Box) -> Int[np.ndarray, " axes"]:
    place = int(np.argmin(objective(box)))
    return np.array(np.unravel_index(place, [axis.size for axis in box]))
