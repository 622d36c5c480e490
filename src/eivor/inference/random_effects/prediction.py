"""What the next member of a group will be, which counts how little is known of the variance between.

The usual interval, mean +- t_{n-2} sqrt(between + variance of the mean), takes the variance between as it was
estimated, which is zero too often: where it is as large as the errors, 95 % become 84 %. Here it has its
confidence distribution (Nagashima, Noma and Furukawa 2019): Q(t), see `between`, is chi-square with n - 1
degrees of freedom at the true t and falls in t, so P(between <= t) = P(chi-square > Q(t)). Given t the mean
has the variance 1 / sum w and the next member t more; their mixture over t gives the interval.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.weighted import weighted
from eivor.shapes import Float

#: Members of a group with a prediction, at least, and those below which it should be taken with care.
FEWEST, FEW = 3, 6
#: Variances between at which its distribution is looked at, as shares of what the estimates scatter by.
NODES = np.concatenate(([0.0], np.geomspace(1e-3, 3e2, 31)))
#: Halvings of the half-width's logarithm.
HALVINGS = 34


def prediction_half_widths(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    centre: Float[np.ndarray, " groups"],
    level: float = 0.95,
) -> Float[np.ndarray, " groups"]:
    """Half-widths about a centre of the intervals of each group's next member. Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y and v.
    centre : ndarray, shape (groups,)
        The means.
    level : float
        Of confidence.

    Returns
    -------
    ndarray, shape (groups,)
        Infinite for groups of fewer than `FEWEST`.
    """
    shares, means, deviations = _mixture(groups, estimates, variances)
    offsets = means - centre
    low, high = 1e-3 * deviations[0], 1e3 * deviations[-1]
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        above, below = (
            special.ndtr((middle - offsets) / deviations),
            special.ndtr((-middle - offsets) / deviations),
        )
        short = np.einsum("ng,ng->g", shares, above - below) < level
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(groups.sizes >= FEWEST, high, np.inf)


def _mixture(
    groups: Groups, estimates: Float[np.ndarray, " rows"], variances: Float[np.ndarray, " rows"]
) -> tuple[
    Float[np.ndarray, "nodes groups"], Float[np.ndarray, "nodes groups"], Float[np.ndarray, "nodes groups"]
]:
    """Shares, means and standard deviations of what the next member is at each variance between."""
    degrees = np.maximum(groups.sizes - 1, 1)
    centre = groups.sums(estimates) / groups.sizes
    scatter = groups.sums((estimates - groups.spread(centre)) ** 2) / degrees
    nodes = NODES[:, None] * np.maximum(scatter, groups.sums(variances) / groups.sizes)
    below, means, deviations = (np.empty_like(nodes) for _ in range(3))
    for number, between in enumerate(nodes):
        at = weighted(groups, estimates, variances, between)
        below[number] = special.chdtrc(degrees, groups.sums(at.squares))
        means[number], deviations[number] = at.mean, np.sqrt(1.0 / at.total + between)
    below[-1] = 1.0
    steps = 0.5 * np.diff(below, axis=0)
    shares = np.zeros_like(below)
    shares[0] = below[0]
    shares[1:] += steps
    shares[:-1] += steps
    return shares, means, deviations
