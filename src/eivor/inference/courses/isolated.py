"""Single estimates that lie far from those before and after them, which must not pass for a course.

One flight that is far off widens the scatter in which a step hides, and near an end of the flights it looks
like a step itself. It is told from a step by both its sides: after a step the following estimates agree with
it. How far is far goes by differences of neighbours, which neither steps nor drifts widen, and by their
median, which single estimates do not. The variance of an isolated estimate is taken to be as large as its
distance squared: it counts little, and is kept.
"""

from __future__ import annotations

import numpy as np

from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Float, Int

#: Neighbours on each side whose median an estimate is held against.
SIDE = 3
#: Standard deviations from which on it is far.
FAR = 2.5
#: Variance of the median of three normal estimates over that of one; median of a chi-square with one degree.
OF_THREE, OF_SQUARES = 0.449, 0.455


def isolated_variances(
    groups: Groups, sets: Groups, y: Float[np.ndarray, " rows"], variances: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Variance to be added to that of isolated estimates, zero for all others. Performs no checks.

    Parameters
    ----------
    groups, sets : Groups
        Of the rows, and of the groups: those of a set scatter alike, or more.
    y, variances : ndarray, shape (rows,)
        Estimates in their order, and v.
    """
    distance = np.minimum(_distance(groups, y, -1), _distance(groups, y, 1))
    distance[np.isinf(distance)] = 0.0
    one = variances + groups.spread(_between_neighbours(groups, sets, y, variances))
    usual = groups.sums(one) / groups.sizes
    far = distance**2 > FAR**2 * (one + OF_THREE * groups.spread(usual))
    return np.where(far, distance**2, 0.0)


def _distance(groups: Groups, y: Float[np.ndarray, " rows"], way: int) -> Float[np.ndarray, " rows"]:
    """Distance from the median of the next few rows one way; from the nearest where there are fewer."""
    row = np.arange(y.size)
    ends = groups.starts if way < 0 else groups.starts + groups.sizes - 1
    left = np.abs(row - np.repeat(ends, groups.sizes))
    first, second, third = (np.roll(y, -way * (number + 1)) - y for number in range(SIDE))
    low, high = np.minimum(first, second), np.maximum(first, second)
    middle = np.abs(np.maximum(low, np.minimum(high, third)))
    nearer = np.minimum(np.abs(first), np.abs(second))
    few = np.where(left == 1, np.abs(first), np.where(left == 2, nearer, middle))
    return np.where(left > 0, few, np.inf)


def _between_neighbours(
    groups: Groups, sets: Groups, y: Float[np.ndarray, " rows"], variances: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " groups"]:
    """Variance between estimates by the median of squared differences: of its set, or its own if larger."""
    of_row = np.repeat(np.arange(groups.sizes.size), groups.sizes)
    pairs = np.flatnonzero(of_row[1:] == of_row[:-1])
    squares, errors = (y[pairs + 1] - y[pairs]) ** 2, variances[pairs + 1] + variances[pairs]

    def between(sizes: Int[np.ndarray, " parts"]) -> Float[np.ndarray, " parts"]:
        excess = _medians(sizes, squares) / OF_SQUARES - _medians(sizes, errors)
        return 0.5 * np.maximum(excess, 0.0)

    of_group = groups.sizes - 1
    of_set = np.add.reduceat(of_group, sets.starts)
    return np.maximum(between(of_group), sets.spread(between(of_set)))


def _medians(
    sizes: Int[np.ndarray, " parts"], values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " parts"]:
    """Lower median of each part of values that are not negative; zero of an empty one."""
    found = np.zeros(sizes.size)
    some = np.flatnonzero(sizes > 0)
    scale = float(values.mean()) if values.size else 0.0
    if scale > 0.0:  # one sort for all parts: their numbers, and values as fractions
        ordered = np.sort(np.repeat(np.arange(sizes.size), sizes) + values / (values + scale))
        middle = ordered[(np.cumsum(sizes) - sizes + (sizes - 1) // 2)[some]] - some
        found[some] = scale * middle / (1.0 - middle)
    return found
