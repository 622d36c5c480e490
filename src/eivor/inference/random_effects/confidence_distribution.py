"""Intervals that count how little is known of the variance between: of a mean, and of what comes next.

The usual interval of the next member, mean +- t_{n-2} sqrt(between + variance of the mean), takes the
variance between as it was estimated, which is zero too often: where it is as large as the errors, 95 % become
84 %. Here it has its confidence distribution (Nagashima, Noma and Furukawa 2019): Q(t), see `between`, is
chi-square with n - 1 degrees of freedom at the true t and falls in t, so P(between <= t) =
P(chi-square > Q(t)). Given t the mean has the variance 1 / sum w and the next member t more; their mixtures
over t give the intervals.

Q is computed on a grid; the t of a probability is found between its points along 1/Q, which is a straight
line where errors are equal, and nearly one elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.quantiles import normal_quantile
from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.mean import RandomEffectsMeans
from eivor.inference.random_effects.weighted import weights_of
from eivor.shapes import Bool, Float, Int

#: Members of a group with a prediction, at least, and those below which it should be taken with care.
FEWEST, FEW = 3, 6
#: Variances between at which Q is computed, as shares of what the estimates scatter by.
GRID = np.concatenate(([0.0], np.geomspace(3e-3, 3e2, 20)))
_ROOTS, _WEIGHTS = np.polynomial.legendre.leggauss(24)
#: Probabilities at which the distribution is looked at, and what each counts.
PROBABILITIES, COUNTS = 0.5 + 0.5 * _ROOTS, 0.5 * _WEIGHTS
#: Steps of the search for a half-width, at most, and the share of it by which a last one moves: what is left
#: is its square.
STEPS, CLOSE = 30, 1e-4


@dataclass(frozen=True)
class BetweenDistribution:
    """The variance between estimates as a distribution, group by group.

    Parameters
    ----------
    sizes : ndarray of int, shape (groups,)
        Members of each.
    means, mean_errors, next_errors : ndarray, shape (nodes, groups)
        Mean, its standard deviation and that of the next member, at the variances between that are not
        exceeded with `PROBABILITIES`.
    """

    sizes: Int[np.ndarray, " groups"]
    means: Float[np.ndarray, "nodes groups"]
    mean_errors: Float[np.ndarray, "nodes groups"]
    next_errors: Float[np.ndarray, "nodes groups"]

    def mean_half_widths(
        self, found: RandomEffectsMeans, level: float = 0.95
    ) -> Float[np.ndarray, " groups"]:
        """Half-widths of the means: Hartung and Knapp's, but not less than this distribution says.

        Alone, theirs covers .94 where the variance between is about that of the errors.
        """
        half = found.half_widths(level)
        short = self._missed(half, found.value, self.mean_errors)[0] > 1.0 - level
        half[short] = self._only(short)._half_widths(found.value[short], self.mean_errors[:, short], level)
        return half

    def next_half_widths(
        self, centre: Float[np.ndarray, " groups"], level: float = 0.95
    ) -> Float[np.ndarray, " groups"]:
        """Half-widths about a centre of the next members; infinite for groups of fewer than `FEWEST`."""
        found = self._half_widths(centre, self.next_errors, level)
        return np.where(self.sizes >= FEWEST, found, np.inf)

    def _only(self, which: Bool[np.ndarray, " groups"]) -> BetweenDistribution:
        return BetweenDistribution(
            self.sizes[which], self.means[:, which], self.mean_errors[:, which], self.next_errors[:, which]
        )

    def _missed(
        self,
        half_width: Float[np.ndarray, " groups"],
        centre: Float[np.ndarray, " groups"],
        errors: Float[np.ndarray, "nodes groups"],
    ) -> tuple[Float[np.ndarray, " groups"], Float[np.ndarray, " groups"]]:
        """Probability outside a half-width, and the density at its ends."""
        offsets = self.means - centre
        above, below = (half_width - offsets) / errors, (half_width + offsets) / errors
        density = (np.exp(-0.5 * above**2) + np.exp(-0.5 * below**2)) / errors
        missed = COUNTS @ (special.ndtr(-above) + special.ndtr(-below))
        return missed, COUNTS @ density / np.sqrt(2.0 * np.pi)

    def _half_widths(
        self, centre: Float[np.ndarray, " groups"], errors: Float[np.ndarray, "nodes groups"], level: float
    ) -> Float[np.ndarray, " groups"]:
        """Half-widths by Newton's method on logarithms, where tails are straight lines or bend downward."""
        z = normal_quantile(level)
        offsets = np.abs(self.means - centre).max(axis=0)
        low, high = z * errors.min(axis=0), z * errors.max(axis=0) + offsets  # of the normals that are mixed
        found = np.clip(z * (COUNTS @ errors), low, high)
        for _ in range(STEPS):
            missed, density = self._missed(found, centre, errors)
            step = np.log(missed / (1.0 - level)) * missed / (found * density)
            found, before = np.clip(found * np.exp(step), low, high), found
            if np.all(np.abs(found - before) <= CLOSE * found):
                break
        return found


def between_distribution(
    groups: Groups, estimates: Float[np.ndarray, " rows"], variances: Float[np.ndarray, " rows"]
) -> BetweenDistribution:
    """Confidence distribution of the variance between the estimates of each group. Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y and v.
    """
    degrees = np.maximum(groups.sizes - 1, 1)
    centre = groups.sums(estimates) / groups.sizes
    about = estimates - groups.spread(centre)
    scatter = groups.sums(about**2) / degrees
    grid = GRID[:, None] * np.maximum(scatter, groups.sums(variances) / groups.sizes)
    squares, means, variance = (np.empty_like(grid) for _ in range(3))
    for number, between in enumerate(grid):
        weights = weights_of(groups, variances, between)
        total = groups.sums(weights)
        weights *= about
        first = groups.sums(weights)
        weights *= about
        squares[number] = groups.sums(weights) - first**2 / total
        means[number], variance[number] = centre + first / total, 1.0 / total
    inverse = 1.0 / np.maximum(squares, np.finfo(float).tiny)
    place = _between(inverse, 1.0 / special.chdtri(degrees, PROBABILITIES[:, None]))
    of_mean = place(variance)
    return BetweenDistribution(groups.sizes, place(means), np.sqrt(of_mean), np.sqrt(of_mean + place(grid)))


def _between(
    rising: Float[np.ndarray, "grid groups"], wanted: Float[np.ndarray, "nodes groups"]
) -> Callable[[Float[np.ndarray, "grid groups"]], Float[np.ndarray, "nodes groups"]]:
    """What turns values on a grid into those where something that rises along it is as wanted, or begins."""
    left = np.zeros(wanted.shape, dtype=int)
    for row in rising[1:-1]:
        left += row <= wanted
    low, high = (np.take_along_axis(rising, left + step, axis=0) for step in (0, 1))
    share = np.maximum((wanted - low) / np.where(high > low, high - low, 1.0), 0.0)

    def values(given: Float[np.ndarray, "grid groups"]) -> Float[np.ndarray, "nodes groups"]:
        before, after = (np.take_along_axis(given, left + step, axis=0) for step in (0, 1))
        return before + share * (after - before)

    return values
