"""Steps: the place after which the estimates of a group have another mean, and whether there is one.

For every place the two means are compared, t = difference / standard error, with a scale from the scatter
about both, so that a step does not hide itself in it. The p-value of the largest |t| counts the search: as
normal scores z of the t's tails, P(some |z_k| > c) <= sum P(|z_k| > c) - sum P(|z_k| > c, |z_{k+1}| > c),
with what neighbours share, rho^2 = W_k (W - W_{k+1}) / (W_{k+1} (W - W_k)), W_k the sum of the weights up to
k (Worsley 1983). The places that the likelihood ratio leaves are those within 7.35 of the best (Hansen 2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.courses.ordered import Ordered, centred
from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Bool, Float, Int

#: Estimates on each side of a step, at least: fewer are members that deviate.
FEWEST = 3
#: P-values above this are bounds.
NO_NEWS = 0.02
#: -2 ln(1 - sqrt(.95)): likelihood ratio of the true place below which it is in 95 %.
PLACES = 7.352


@dataclass(frozen=True)
class Steps:
    """The best place of a step in each group.

    Parameters
    ----------
    place, first, last : ndarray of int, shape (groups,)
        Rows of the group before the step, and the fewest and most that the estimates leave open.
    size, half_width : ndarray, shape (groups,)
        Mean after it less mean before it, with the half-width of its 95 % interval at that place.
    p_values : ndarray, shape (groups,)
        Of no step anywhere; one where a group has too few estimates.
    squares : ndarray, shape (groups,)
        Weighted squares about both means.
    line : ndarray, shape (rows,)
        Those means.
    leverage : ndarray, shape (rows,)
        What each row has of its mean.
    """

    place: Int[np.ndarray, " groups"]
    first: Int[np.ndarray, " groups"]
    last: Int[np.ndarray, " groups"]
    size: Float[np.ndarray, " groups"]
    half_width: Float[np.ndarray, " groups"]
    p_values: Float[np.ndarray, " groups"]
    squares: Float[np.ndarray, " groups"]
    line: Float[np.ndarray, " rows"]
    leverage: Float[np.ndarray, " rows"]


def after_step(ordered: Ordered) -> Bool[np.ndarray, " rows"]:
    """Which rows come after the best step of their group; none where there are too few. Performs no checks.

    Parameters
    ----------
    ordered : Ordered
        The estimates.
    """
    found = _Search.of(ordered)
    return found.possible[found.best[found.group]] & (found.number > found.number[found.best[found.group]])


def steps(ordered: Ordered) -> Steps:
    """Best step of each group, see this module. Performs no checks.

    Parameters
    ----------
    ordered : Ordered
        The estimates.
    """
    groups, w, search = ordered.groups, ordered.weights, _Search.of(ordered)
    best, gain, possible, number = search.best, search.gain, search.possible, search.number
    squares = groups.spread(groups.sums(w * search.y**2)) - gain
    degrees = np.maximum(groups.sizes - 2, 1)
    scale = np.maximum(squares / groups.spread(degrees.astype(float)), groups.spread(ordered.least_scale))
    differences = np.array([search.jump(one) for one in ordered.covariates]).reshape(-1, w.size)
    variance = scale * search.inverse + ordered.correction_variance(differences, of_rows=True)
    score = np.where(possible, np.abs(search.size) / np.sqrt(variance), 0.0)
    largest = np.maximum.reduceat(score, groups.starts)
    found = possible[best]
    line, leverage = _two_means(groups, w, ordered.y, number <= groups.spread(number[best]))
    near = possible & (groups.spread(gain[best]) - gain <= PLACES * groups.spread(scale[best]))
    half_width = special.stdtrit(degrees, 0.975) * np.sqrt(variance[best])
    return Steps(
        np.where(found, number[best], 0).astype(int),
        np.where(found, _smallest(groups, number, near), 0).astype(int),
        np.where(found, -_smallest(groups, -number, near), 0).astype(int),
        np.where(found, search.size[best], 0.0),
        np.where(found, half_width, np.inf),
        np.where(found, _tail(groups, largest, degrees, possible, search.before, search.total), 1.0),
        np.where(found, squares[best], np.inf),
        line,
        leverage,
    )


@dataclass(frozen=True)
class _Search:
    """Difference of the means after and before every row, and the row with the clearest one."""

    ordered: Ordered
    y: Float[np.ndarray, " rows"]
    number: Float[np.ndarray, " rows"]
    possible: Bool[np.ndarray, " rows"]
    before: Float[np.ndarray, " rows"]
    total: Float[np.ndarray, " rows"]
    after: Float[np.ndarray, " rows"]
    inverse: Float[np.ndarray, " rows"]
    size: Float[np.ndarray, " rows"]
    gain: Float[np.ndarray, " rows"]
    best: Int[np.ndarray, " groups"]

    @classmethod
    def of(cls, ordered: Ordered) -> _Search:
        groups, w = ordered.groups, ordered.weights
        y = centred(groups, w, ordered.y)
        number = groups.running(np.ones(w.size))
        possible = (number >= FEWEST) & (groups.spread(groups.sizes.astype(float)) - number >= FEWEST)
        before, total = groups.running(w), groups.spread(groups.sums(w))
        after = np.where(possible, total - before, 1.0)
        inverse = 1.0 / before + 1.0 / after
        size = _jump(groups, w, y, before, after)
        gain = np.where(possible, size**2 / inverse, -1.0)
        best = _first_largest(groups, gain)
        return cls(ordered, y, number, possible, before, total, after, inverse, size, gain, best)

    @property
    def group(self) -> Int[np.ndarray, " rows"]:
        groups = self.ordered.groups
        return np.repeat(np.arange(groups.sizes.size), groups.sizes)

    def jump(self, values: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Mean of values after each row less that up to it."""
        return _jump(self.ordered.groups, self.ordered.weights, values, self.before, self.after)


def _jump(
    groups: Groups,
    w: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, " rows"],
    before: Float[np.ndarray, " rows"],
    after: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " rows"]:
    weighted = w * values
    upto = groups.running(weighted)
    return (groups.spread(groups.sums(weighted)) - upto) / after - upto / before


def _first_largest(groups: Groups, values: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " groups"]:
    """First row of each group with its largest value."""
    is_largest = values >= groups.spread(np.maximum.reduceat(values, groups.starts))
    return np.minimum.reduceat(np.where(is_largest, np.arange(values.size), values.size), groups.starts)


def _smallest(
    groups: Groups, values: Float[np.ndarray, " rows"], among: np.ndarray
) -> Float[np.ndarray, " groups"]:
    """Smallest value of each group among some rows; what it would be without any is of no use."""
    return np.minimum.reduceat(np.where(among, values, values.max() + 1.0), groups.starts)


def _two_means(
    groups: Groups, w: Float[np.ndarray, " rows"], y: Float[np.ndarray, " rows"], early: np.ndarray
) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
    """Mean of its side of the step for each row, and what the row has of it."""
    line, leverage = np.empty(y.size), np.empty(y.size)
    for side in (early, ~early):
        weights = np.where(side, w, 0.0)
        total = groups.sums(weights)
        total = groups.spread(np.where(total > 0.0, total, 1.0))
        mean = groups.spread(groups.sums(weights * y)) / total
        line, leverage = np.where(side, mean, line), np.where(side, w / total, leverage)
    return line, leverage


def _tail(
    groups: Groups,
    largest: Float[np.ndarray, " groups"],
    degrees: Int[np.ndarray, " groups"],
    possible: np.ndarray,
    before: Float[np.ndarray, " rows"],
    total: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " groups"]:
    """P-value of the largest |t| over all places, see this module; where that is no news, only a bound."""
    one_sided = np.maximum(special.stdtr(degrees, -largest), 1e-300)
    bound = 2.0 * one_sided * groups.sums(possible.astype(float))
    pairs = np.append(possible[:-1] & possible[1:], False) & (groups.spread(2.0 * one_sided) < NO_NEWS)
    k = np.flatnonzero(pairs)
    shared = before[k] * (total - before)[k + 1] / (before[k + 1] * (total - before)[k])
    rho = np.sqrt(np.clip(shared, 0.0, 1.0))
    own = groups.spread(one_sided)[k]
    c = -special.ndtri(own)
    both = np.zeros(before.size)
    for sign in (1.0, -1.0):
        apart = special.owens_t(c, np.sqrt((1.0 - sign * rho) / (1.0 + sign * rho)))
        both[k] += 2.0 * np.maximum(own - 2.0 * apart, 0.0)
    return np.clip(bound - groups.sums(both), 2.0 * one_sided, 1.0)
