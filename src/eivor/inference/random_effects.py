"""Random effects: mean and variance between groups, with a confidence distribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy

from eivor.inference.distributions import chi_square_tail, normal_quantile
from eivor.tools import Float, Int

PerNode = Float[np.ndarray, "nodes groups"]

#: A number for each row, and one for each group of rows.
Rows: TypeAlias = Float[np.ndarray, " rows"]
PerGroup: TypeAlias = Float[np.ndarray, " groups"]


@dataclass(frozen=True)
class Groups:
    """Consecutive rows of groups."""

    sizes: Int[np.ndarray, " groups"]

    @cached_property
    def starts(self) -> Int[np.ndarray, " groups"]:
        return np.cumsum(self.sizes) - self.sizes

    def sums(self, values: Rows) -> PerGroup:
        return np.add.reduceat(values, self.starts)

    def spread(self, values: PerGroup) -> Rows:
        """Value of its group, for each row."""
        return np.repeat(values, self.sizes)

    def running(self, values: Rows) -> Rows:
        """Sum over the rows of its group up to each row, that row included."""
        total = np.cumsum(values)
        offsets = np.concatenate(([0.0], total))[self.starts]
        return total - self.spread(offsets)


def one_group(rows: int) -> Groups:
    """All rows together."""
    return Groups(np.array([rows]))


@dataclass(frozen=True)
class Weighted:
    """Weighted means."""

    weights: Rows  # w = 1 / (v + between)
    total: PerGroup  # Sum of the weights of a group
    mean: PerGroup
    squares: Rows  # w (y - mean)^2


#: Steps of the search: 1/Q is nearly a straight line, so that few are needed.
BETWEEN_STEPS = 60
#: A search ends after a step by less than this share, beyond which its square is left.
BETWEEN_TOLERANCE = 1e-8


@dataclass(frozen=True)
class RandomEffectsMeans:
    """Means of groups of estimates that differ by more than chance."""

    value: PerGroup
    variance: PerGroup
    between: PerGroup
    degrees: Int[np.ndarray, " groups"]
    weights: Rows

    def half_widths(self, level: float = 0.95) -> PerGroup:
        """Half-widths of the means' intervals; infinite for a single estimate."""
        estimable = self.degrees > 0
        quantile = scipy.special.stdtrit(np.maximum(self.degrees, 1), 0.5 + 0.5 * level)
        return np.where(estimable, quantile * np.sqrt(self.variance), np.inf)


@dataclass(frozen=True)
class Grouped:
    """Estimates with their variances, in groups. Performs no checks."""

    groups: Groups
    y: Rows
    v: Rows

    def weights(self, between: PerGroup) -> Rows:
        """1 / (v + between), in an array of its own."""
        weights = self.groups.spread(between)
        weights += self.v
        return np.reciprocal(weights, out=weights)

    def weighted(self, between: PerGroup) -> Weighted:
        groups, weights = self.groups, self.weights(between)
        total = groups.sums(weights)
        mean = groups.sums(weights * self.y) / total
        squares = groups.spread(mean)
        squares -= self.y
        squares *= squares
        squares *= weights
        return Weighted(weights, total, mean, squares)

    def moment_between(self) -> PerGroup:
        """Variance between estimates by moments, of groups of two rows or more."""
        groups, fixed = self.groups, self.weighted(np.zeros(self.groups.sizes.size))
        excess = groups.sums(fixed.squares) - (groups.sizes - 1)
        scale = fixed.total - groups.sums(fixed.weights**2) / fixed.total
        return np.maximum(excess, 0.0) / scale

    def paule_mandel(self, sets: Groups | None = None, near: PerGroup | None = None) -> PerGroup:
        """Variance between estimates where Q is its expectation; zero where it is below that without any."""
        sets = sets or Groups(np.ones_like(self.groups.sizes))
        return self._solve(sets.sums((self.groups.sizes - 1).astype(float)), sets, near)

    def q_profile(self, level: float = 0.95, near: PerGroup | None = None) -> tuple[PerGroup, PerGroup]:
        """Interval of the variance between estimates."""
        degrees = self.groups.sizes - 1
        estimable, singles = degrees > 0, Groups(np.ones_like(self.groups.sizes))

        def end(tail: float) -> PerGroup:
            target = np.where(estimable, scipy.special.chdtri(np.maximum(degrees, 1), tail), 1.0)
            return self._solve(target, singles, near)

        tail = 0.5 * (1.0 - level)
        return np.where(estimable, end(tail), 0.0), np.where(estimable, end(1.0 - tail), np.inf)

    def _solve(self, target: Float[np.ndarray, " sets"], sets: Groups, near: PerGroup | None) -> PerGroup:
        """Variance at which Q, summed over sets of groups, meets its target, or zero."""
        groups = self.groups
        result = np.zeros(target.size) if near is None else near[sets.starts]
        for _ in range(BETWEEN_STEPS):
            index = self.weighted(sets.spread(result))
            q = sets.sums(groups.sums(index.squares))
            fall = sets.sums(groups.sums(index.weights * index.squares))
            searching = (fall > 0.0) & (target > 0.0)
            step = np.where(searching, q * (q - target) / np.where(searching, target * fall, 1.0), -result)
            previous, result = result, np.maximum(result + step, 0.0)
            if np.all(np.abs(result - previous) <= BETWEEN_TOLERANCE * result):
                break
        return sets.spread(result)

    def means(self, between: PerGroup) -> RandomEffectsMeans:
        groups, result, degrees = self.groups, self.weighted(between), self.groups.sizes - 1
        q = groups.sums(result.squares) / np.maximum(degrees, 1)
        variance, weights = np.maximum(q, 1.0) / result.total, result.weights / groups.spread(result.total)
        return RandomEffectsMeans(result.mean, variance, between, degrees, weights)


def homogeneity_p_value(estimates: Rows, variances: Rows) -> float:
    """P-value of Cochran's test that estimates have one mean."""
    squares = Grouped(one_group(estimates.size), estimates, variances).weighted(np.zeros(1)).squares
    return chi_square_tail(float(squares.sum()), estimates.size - 1)


#: Members of a group with a prediction, at least, and those below which it should be taken with care.
FEWEST, FEW = 3, 6
#: Variances between estimates at which Q is computed, as shares of their scatter.
GRID = np.concatenate(([0.0], np.geomspace(3e-3, 3e2, 20)))
_ROOTS, _WEIGHTS = np.polynomial.legendre.leggauss(24)
#: Probabilities at which the distribution is evaluated, and their weights.
PROBABILITIES, COUNTS = 0.5 + 0.5 * _ROOTS, 0.5 * _WEIGHTS
#: Steps of the search for a half-width, at most, and the share of it by which a last one moves: what is left
#: is its square.
HALF_WIDTH_STEPS, HALF_WIDTH_TOLERANCE = 30, 1e-4


#: Level of all intervals.
LEVEL = 0.95


@dataclass(frozen=True)
class BetweenDistribution:
    """The variance between estimates as a distribution, group by group."""

    sizes: Int[np.ndarray, " groups"]
    means: PerNode
    mean_errors: PerNode
    next_errors: PerNode

    def mean_half_widths(self, result: RandomEffectsMeans) -> PerGroup:
        """Half-widths of the means: Hartung and Knapp's, but not less than this distribution says."""
        half = result.half_widths(LEVEL)
        short = _tails(half, self.means - result.value, self.mean_errors)[0] > 1.0 - LEVEL
        offsets = self.means[:, short] - result.value[short]
        half[short] = _half_widths(offsets, self.mean_errors[:, short], LEVEL)
        return half

    def next_half_widths(self, centre: PerGroup) -> PerGroup:
        """Half-widths about a centre of the next members; infinite for groups of fewer than `FEWEST`."""
        half_widths = _half_widths(self.means - centre, self.next_errors, LEVEL)
        return np.where(self.sizes >= FEWEST, half_widths, np.inf)


def _tails(half_width: PerGroup, offsets: PerNode, errors: PerNode) -> tuple[PerGroup, PerGroup]:
    """Probability outside a half-width, and the density at its ends."""
    above, below = (half_width - offsets) / errors, (half_width + offsets) / errors
    density = (np.exp(-0.5 * above**2) + np.exp(-0.5 * below**2)) / errors
    missed = COUNTS @ (scipy.special.ndtr(-above) + scipy.special.ndtr(-below))
    return missed, COUNTS @ density / np.sqrt(2.0 * np.pi)


def _half_widths(offsets: PerNode, errors: PerNode, level: float) -> PerGroup:
    """Half-widths by Newton's method on logarithms, where tails are straight lines or bend downward."""
    z = normal_quantile(level)
    low = z * errors.min(axis=0)  # of the normals that are mixed
    high = z * errors.max(axis=0) + np.abs(offsets).max(axis=0)
    result = np.clip(z * (COUNTS @ errors), low, high)
    for _ in range(HALF_WIDTH_STEPS):
        missed, density = _tails(result, offsets, errors)
        step = np.log(missed / (1.0 - level)) * missed / (result * density)
        result, previous = np.clip(result * np.exp(step), low, high), result
        if np.all(np.abs(result - previous) <= HALF_WIDTH_TOLERANCE * result):
            break
    return result


def between_distribution(estimates: Grouped) -> BetweenDistribution:
    """Confidence distribution of the variance between the estimates of each group. Performs no checks."""
    groups, degrees = estimates.groups, np.maximum(estimates.groups.sizes - 1, 1)
    centre = groups.sums(estimates.y) / groups.sizes
    deviations = estimates.y - groups.spread(centre)
    scatter = groups.sums(deviations**2) / degrees
    grid = GRID[:, None] * np.maximum(scatter, groups.sums(estimates.v) / groups.sizes)
    squares, means, variance = (np.empty_like(grid) for _ in range(3))
    for number, between in enumerate(grid):
        weights = estimates.weights(between)
        total = groups.sums(weights)
        weights *= deviations
        first = groups.sums(weights)
        weights *= deviations
        squares[number] = groups.sums(weights) - first**2 / total
        means[number], variance[number] = centre + first / total, 1.0 / total
    inverse = 1.0 / np.maximum(squares, np.finfo(float).tiny)
    position = _interpolator(inverse, 1.0 / scipy.special.chdtri(degrees, PROBABILITIES[:, None]))
    mean_variance = position(variance)
    return BetweenDistribution(
        groups.sizes, position(means), np.sqrt(mean_variance), np.sqrt(mean_variance + position(grid))
    )


def _interpolator(
    rising: Float[np.ndarray, "grid groups"], target: PerNode
) -> Callable[[Float[np.ndarray, "grid groups"]], PerNode]:
    """Interpolator of values on a grid to where a rising quantity meets its target, or to the start."""
    index = np.zeros(target.shape, dtype=int)
    for row in rising[1:-1]:
        index += row <= target
    low, high = (np.take_along_axis(rising, index + step, axis=0) for step in (0, 1))
    share = np.maximum((target - low) / np.where(high > low, high - low, 1.0), 0.0)

    def values(table: Float[np.ndarray, "grid groups"]) -> PerNode:
        below, above = (np.take_along_axis(table, index + step, axis=0) for step in (0, 1))
        return below + share * (above - below)

    return values
