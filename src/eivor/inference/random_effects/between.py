"""Variance between what estimates estimate: by moments, by Paule and Mandel, and its interval.

Notation: Q(t) = sum w (y - mean)^2 with w = 1 / (v + t), which falls as t grows and, for normal errors, is
chi-square with n - 1 degrees of freedom where t is the variance between. Paule and Mandel (1982) take the t
where Q is its expectation; DerSimonian and Laird (1986) go by moments at t = 0; the interval consists of all
t at which Q is no surprise (Viechtbauer 2007).
"""

from __future__ import annotations

import numpy as np
from scipy import special

from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.weighted import weighted
from eivor.shapes import Float

#: Steps of the search: 1/Q is nearly a straight line, so that few are needed.
STEPS = 60
#: A search ends after a step by less than this share, beyond which its square is left.
CLOSE = 1e-8


def moment_between(
    groups: Groups, estimates: Float[np.ndarray, " rows"], variances: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " groups"]:
    """Variance between estimates by moments, of groups of two rows or more. Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y and v.
    """
    fixed = weighted(groups, estimates, variances, np.zeros(groups.sizes.size))
    excess = groups.sums(fixed.squares) - (groups.sizes - 1)
    scale = fixed.total - groups.sums(fixed.weights**2) / fixed.total
    return np.maximum(excess, 0.0) / scale


def paule_mandel(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    together: Groups | None = None,
    near: Float[np.ndarray, " groups"] | None = None,
) -> Float[np.ndarray, " groups"]:
    """Variance between estimates where Q is its expectation; zero where it is below that without any.

    Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y and v.
    together : Groups, optional
        Groups of the groups that have one variance between them; by default each has its own.
    near : ndarray, shape (groups,), optional
        Variances that are near, where the search is quick from; it ends at the same without.
    """
    together = together or _each_alone(groups)
    expected = together.sums((groups.sizes - 1).astype(float))
    return _where(groups, estimates, variances, expected, together, near)


def q_profile(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    level: float = 0.95,
    near: Float[np.ndarray, " groups"] | None = None,
) -> tuple[Float[np.ndarray, " groups"], Float[np.ndarray, " groups"]]:
    """Interval of the variance between estimates; from zero to infinity for a single one. Performs no checks.

    Parameters
    ----------
    groups, estimates, variances, near
        As for `paule_mandel`.
    level : float
        Its confidence.

    Returns
    -------
    low, high : ndarray, shape (groups,)
        Ends.
    """
    degrees = groups.sizes - 1
    tail = 0.5 * (1.0 - level)
    several = degrees > 0
    low, high = (
        _where(
            groups,
            estimates,
            variances,
            np.where(several, special.chdtri(np.maximum(degrees, 1), at), 1.0),
            _each_alone(groups),
            near,
        )
        for at in (tail, 1.0 - tail)
    )
    return np.where(several, low, 0.0), np.where(several, high, np.inf)


def _each_alone(groups: Groups) -> Groups:
    return Groups(np.ones(groups.sizes.size, dtype=int))


def _where(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    wanted: Float[np.ndarray, " sets"],
    together: Groups,
    near: Float[np.ndarray, " groups"] | None,
) -> Float[np.ndarray, " groups"]:
    """Variance at which Q, summed over groups that go together, has a value; zero where it begins below.

    Newton's method on 1/Q, which is concave and rises: from below it climbs to the root and never beyond;
    from above it comes out below.
    """
    found = np.zeros(wanted.size) if near is None else near[together.starts]
    for _ in range(STEPS):
        at = weighted(groups, estimates, variances, together.spread(found))
        q = together.sums(groups.sums(at.squares))
        fall = together.sums(groups.sums(at.weights * at.squares))
        searching = (fall > 0.0) & (wanted > 0.0)
        step = np.where(searching, q * (q - wanted) / np.where(searching, wanted * fall, 1.0), -found)
        before, found = found, np.maximum(found + step, 0.0)
        if np.all(np.abs(found - before) <= CLOSE * found):
            break
    return together.spread(found)
