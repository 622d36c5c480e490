"""Single estimates that lie far from those before and after them, which must not pass for a course.

One flight that is far off widens the scatter in which a step hides, and near an end of the flights it looks
like a step itself. It is told from a step by both its sides: after a step the following estimates agree with
it. How far is far goes by differences of neighbours, which neither steps nor drifts widen, and by their
median, which single estimates do not. The variance of an isolated estimate is taken to be as large as its
distance squared: it counts little, and is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Float, Int

#: Neighbours on each side whose median an estimate is held against.
SIDE = 3
#: Standard deviations from which on it is far.
FAR = 2.5
#: Variance of the median of three normal estimates over that of one; median of a chi-square with one degree.
OF_THREE, OF_SQUARES = 0.449, 0.455


@dataclass(frozen=True)
class Isolation:
    """What tells isolated estimates of some variances. Performs no checks.

    Parameters
    ----------
    groups, sets : Groups
        Of the rows, and of the groups: those of a set scatter alike, or more.
    variances : ndarray, shape (rows,)
        v.
    """

    groups: Groups
    sets: Groups
    variances: Float[np.ndarray, " rows"]

    def added(self, y: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Variance to be added to that of isolated estimates, zero for all others.

        Parameters
        ----------
        y : ndarray, shape (rows,)
            Estimates in their order.
        """
        groups = self.groups
        distance = np.minimum(_distance(groups, y, -1), _distance(groups, y, 1))
        distance[np.isinf(distance)] = 0.0
        one = self.variances + groups.spread(self._between_neighbours(y))
        usual = groups.sums(one) / groups.sizes
        far = distance**2 > FAR**2 * (one + OF_THREE * groups.spread(usual))
        return np.where(far, distance**2, 0.0)

    def _between_neighbours(self, y: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " groups"]:
        """Variance between, by the median of squared differences: of its set, or its own if larger."""
        squares = (y[self._pairs + 1] - y[self._pairs]) ** 2
        of_group, of_set = (
            0.5 * np.maximum(_medians(sizes, squares) / OF_SQUARES - errors, 0.0)
            for sizes, errors in zip(self._sizes, self._errors, strict=True)
        )
        return np.maximum(of_group, self.sets.spread(of_set))

    @cached_property
    def _pairs(self) -> Int[np.ndarray, " pairs"]:
        """First rows of neighbours in one group."""
        of_row = np.repeat(np.arange(self.groups.sizes.size), self.groups.sizes)
        return np.flatnonzero(of_row[1:] == of_row[:-1])

    @cached_property
    def _sizes(self) -> tuple[Int[np.ndarray, " groups"], Int[np.ndarray, " sets"]]:
        """Pairs of each group and of each set."""
        of_group = self.groups.sizes - 1
        return of_group, np.add.reduceat(of_group, self.sets.starts)

    @cached_property
    def _errors(self) -> tuple[Float[np.ndarray, " groups"], Float[np.ndarray, " sets"]]:
        """Median of what errors add to squared differences, in each group and in each set."""
        errors = self.variances[self._pairs + 1] + self.variances[self._pairs]
        of_group, of_set = (_medians(sizes, errors) for sizes in self._sizes)
        return of_group, of_set


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
