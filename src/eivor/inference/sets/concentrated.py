"""Values of one parameter that a ratio of two quadratic forms allows, the other parameters being free.

The statistic is J = (x'N x) / (x'D x), x = (1; -delta): N of what instruments see of a residual, D of its
variance, both quadratic in the parameters. With the others where J is least, the values of one parameter
at which J stays below a bound are the solutions of a quadratic inequality (Dufour and Taamouti 2005).
Everything here is made for many pairs N and D at once. Performs no checks.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from eivor.shapes import Bool, Float


def least_ratio(N: Float[np.ndarray, "k m m"], D: Float[np.ndarray, "k m m"]) -> Float[np.ndarray, " k"]:
    """Least J over all parameters.

    Raises
    ------
    LinAlgError
        When a D is not positive definite: columns are collinear, or nothing is left of the response.
    """
    root = np.linalg.cholesky(D)
    half = np.linalg.solve(root, N)
    return np.asarray(np.linalg.eigvalsh(np.linalg.solve(root, half.transpose(0, 2, 1)))[:, 0])


@dataclass(frozen=True)
class Allowed:
    """For each pair of forms the values that stay below its bound.

    Parameters
    ----------
    low, high : ndarray, shape (k,)
        Ends; NaN where no value does, infinite where all do.
    outside : ndarray of bool, shape (k,)
        Whether it is what lies not between but beyond the ends.
    """

    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    outside: Bool[np.ndarray, " k"]

    def pieces(self) -> list[tuple[float, float]]:
        """Union over pairs that follow one another closely: what lies between ends joins to one interval."""
        between = self._between
        found = [(-inf, inf)] if np.isinf(self.low).any() else []
        if between.any():
            found.append((float(self.low[between].min()), float(self.high[between].max())))
        if self.outside.any():
            found.append((-inf, float(self.low[self.outside].max())))
            found.append((float(self.high[self.outside].min()), inf))
        return found

    def continued(self) -> list[tuple[float, float]]:
        """The same where pairs would go on after the last: without a bound on the side they move to."""
        between = np.flatnonzero(self._between)
        if not between.size:
            return self.pieces()
        first, last = (self.low[at] + self.high[at] for at in between[[0, -1]])
        ends = float(self.low[between].min()), float(self.high[between].max())
        moving = (ends[0], inf) if last >= first else (-inf, ends[1])
        return [moving if piece == ends else piece for piece in self.pieces()]

    @property
    def _between(self) -> Bool[np.ndarray, " k"]:
        return np.isfinite(self.low) & np.isfinite(self.high) & ~self.outside


def allowed(
    N: Float[np.ndarray, "k m m"], D: Float[np.ndarray, "k m m"], bound: Float[np.ndarray, " k"]
) -> Allowed:
    """Values of the first delta at which the least J over the others is at most a bound."""
    Q = N - bound[:, None, None] * D
    S = Q[:, :2, :2]
    free = np.zeros(bound.size, dtype=np.bool_)
    if Q.shape[1] > 2:
        inner, cross = Q[:, 2:, 2:], Q[:, 2:, :2]
        # The others can go to infinity at no cost, whatever this one is.
        free = np.linalg.eigvalsh(inner)[:, 0] <= 0.0
        inner = np.where(free[:, None, None], np.eye(inner.shape[1]), inner)
        S = S - cross.transpose(0, 2, 1) @ np.linalg.solve(inner, cross)
    a, half, c = S[:, 1, 1], S[:, 0, 1], S[:, 0, 0]
    square = half**2 - a * c
    free |= (a <= 0.0) & (square <= 0.0)
    none = ~free & (square < 0.0)
    # the root that does not cancel, and the other one by their product
    larger = half + np.where(half < 0.0, -1.0, 1.0) * np.sqrt(np.maximum(square, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([larger / a, np.where(larger != 0.0, c / larger, 0.0)])
    low, high = roots.min(axis=0), roots.max(axis=0)
    low, high = np.where(free, -inf, low), np.where(free, inf, high)
    outside = (a < 0.0) & ~free
    return Allowed(np.where(none, np.nan, low), np.where(none, np.nan, high), outside)
