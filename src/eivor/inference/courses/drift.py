"""Drifts: straight lines through the estimates of each group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.courses.ordered import Ordered, centred, slope
from eivor.shapes import Float, Int


@dataclass(frozen=True)
class Drifts:
    """Straight lines.

    Parameters
    ----------
    slope, std_error : ndarray, shape (groups,)
        By the unit of `Ordered.at`.
    degrees : ndarray of int, shape (groups,)
        Of freedom; none for fewer than three estimates.
    squares : ndarray, shape (groups,)
        Weighted squares about the line.
    line : ndarray, shape (rows,)
        Its values.
    leverage : ndarray, shape (rows,)
        What each row has of it.
    """

    slope: Float[np.ndarray, " groups"]
    std_error: Float[np.ndarray, " groups"]
    degrees: Int[np.ndarray, " groups"]
    squares: Float[np.ndarray, " groups"]
    line: Float[np.ndarray, " rows"]
    leverage: Float[np.ndarray, " rows"]

    def half_widths(self, level: float = 0.95) -> Float[np.ndarray, " groups"]:
        """Half-widths of the slopes' intervals; infinite where there is none."""
        quantile = special.stdtrit(np.maximum(self.degrees, 1), 0.5 + 0.5 * level)
        return np.where(self.degrees > 0, quantile * self.std_error, np.inf)

    @property
    def p_values(self) -> Float[np.ndarray, " groups"]:
        """Of no drift; one where there is no line."""
        score = np.abs(self.slope) / np.where(self.std_error > 0.0, self.std_error, np.inf)
        return np.where(self.degrees > 0, 2.0 * special.stdtr(np.maximum(self.degrees, 1), -score), 1.0)


def drifts(ordered: Ordered) -> Drifts:
    """Weighted least squares, with a scale from each group's own scatter. Performs no checks.

    Parameters
    ----------
    ordered : Ordered
        The estimates.
    """
    groups, w = ordered.groups, ordered.weights
    at, y = centred(groups, w, ordered.at), centred(groups, w, ordered.y)
    found = slope(groups, w, at, y)
    squares = groups.sums(w * (y - groups.spread(found) * at) ** 2)
    spread = groups.sums(w * at**2)
    variance = ordered.scale(squares, 2) / np.where(spread > 0.0, spread, np.inf)
    along = np.array([slope(groups, w, at, one) for one in ordered.covariates]).reshape(-1, found.size)
    variance = variance + ordered.correction_variance(along, of_rows=False)
    line = ordered.y - y + groups.spread(found) * at
    leverage = w / groups.spread(groups.sums(w)) + w * at**2 / np.where(
        groups.spread(spread) > 0.0, groups.spread(spread), np.inf
    )
    degrees = np.where(spread > 0.0, np.maximum(groups.sizes - 2, 0), 0)
    return Drifts(found, np.sqrt(variance), degrees, squares, line, leverage)
