"""Search of the least of a smooth function in the unit cube by quadratics through points around the best.

Each quadratic goes through the best place, both neighbours of it along each axis, and one more for each pair
of axes. The next best place is the minimum of the quadratic within the cube, a few distances away at most;
the distances shrink with the way that was gone (Winfield 1973, J. Inst. Maths Applics 12). Near a minimum the
places settle quadratically, so that a few dozen values of the function suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from eivor.shapes import Float

#: Rounds before the search is given up.
ROUNDS = 12
#: The next place is at most so many distances away; distances shrink to this share at least, and to twice the
#: way that was gone, but not below the least.
REACH, SHRINK, LEAST_DISTANCE = 3.0, 0.25, 1e-3

#: From a place in the unit cube to the value there.
Values = Callable[[Float[np.ndarray, " q"]], float]


def quadratics_settle(
    value_at: Values, place: Float[np.ndarray, " q"], distance: Float[np.ndarray, " q"], accuracy: float
) -> bool:
    """Go to a minimum; whether places settle there. What is found is the least that `value_at` has seen.

    Parameters
    ----------
    value_at : callable
        The function.
    place : ndarray, shape (q,)
        Where to begin.
    distance : ndarray, shape (q,)
        Of the first neighbours.
    accuracy : float
        Places have settled when they move no further along any axis.
    """
    for _ in range(ROUNDS):
        middle = np.clip(place, distance, 1.0 - distance)
        slope, bend = quadratic(value_at, middle, distance)
        if not (np.isfinite(bend).all() and np.linalg.eigvalsh(bend)[0] > 0.0):
            return False
        reach = REACH * distance
        low, high = np.maximum(-reach, -middle), np.minimum(reach, 1.0 - middle)
        better = middle + least_of_quadratic(slope, bend, low, high)
        moved, place = np.abs(better - place), better
        value_at(place)
        if (moved <= accuracy).all():
            return True
        distance = np.clip(2.0 * moved, LEAST_DISTANCE, np.maximum(SHRINK * distance, LEAST_DISTANCE))
    return False


def quadratic(
    value_at: Values, middle: Float[np.ndarray, " q"], distance: Float[np.ndarray, " q"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    """Slope and second derivatives at the middle of the quadratic through points around it."""
    steps = np.diag(distance)
    centre = value_at(middle)
    after = np.array([value_at(middle + step) for step in steps])
    before = np.array([value_at(middle - step) for step in steps])
    slope = (after - before) / (2.0 * distance)
    bend = np.diag((after - 2.0 * centre + before) / distance**2)
    for i, j in combinations(range(middle.size), 2):
        corner = value_at(middle + steps[i] + steps[j])
        bend[i, j] = bend[j, i] = (corner - after[i] - after[j] + centre) / (distance[i] * distance[j])
    return slope, bend


def least_of_quadratic(
    slope: Float[np.ndarray, " q"],
    bend: Float[np.ndarray, "q q"],
    low: Float[np.ndarray, " q"],
    high: Float[np.ndarray, " q"],
) -> Float[np.ndarray, " q"]:
    """Least place of ``slope x + x bend x / 2`` between bounds; what leaves them is put on them in turn."""
    place, free = np.zeros(slope.size), np.ones(slope.size, dtype=np.bool_)
    for _ in range(slope.size):
        rest = slope[free] + bend[np.ix_(free, ~free)] @ place[~free]
        place[free] = -np.linalg.solve(bend[np.ix_(free, free)], rest)
        beyond = np.maximum(low - place, place - high) / (high - low)
        if not (beyond > 0.0).any():
            return place
        worst = int(np.argmax(beyond))
        place[worst] = np.clip(place[worst], low[worst], high[worst])
        free[worst] = False
    return np.clip(place, low, high)
