"""The mean of estimates that differ: a random-effects mean whose interval counts the differences.

Weights w = 1 / (v + between), and the variance of the mean by how far the estimates lie from it,
q = sum w (y - mean)^2 / (n - 1), never below what the weights say: max(1, q) / sum w, with Student's t on
n - 1 degrees of freedom (Hartung and Knapp 2001; Sidik and Jonkman 2002; modified by Rover, Knapp and Friede
2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.weighted import weighted
from eivor.shapes import Float, Int


@dataclass(frozen=True)
class RandomEffectsMeans:
    """Means of groups of estimates that differ by more than chance.

    Parameters
    ----------
    value, variance : ndarray, shape (groups,)
        The means, and their variances.
    between : ndarray, shape (groups,)
        Variance between what is estimated.
    degrees : ndarray of int, shape (groups,)
        Of freedom of the variance; none for a single estimate, whose variance is its own.
    weights : ndarray, shape (rows,)
        What each estimate counts; their sum over a group is one.
    """

    value: Float[np.ndarray, " groups"]
    variance: Float[np.ndarray, " groups"]
    between: Float[np.ndarray, " groups"]
    degrees: Int[np.ndarray, " groups"]
    weights: Float[np.ndarray, " rows"]

    def half_widths(self, level: float = 0.95) -> Float[np.ndarray, " groups"]:
        """Half-widths of the means' intervals; infinite for a single estimate.

        Parameters
        ----------
        level : float
            Of confidence.
        """
        several = self.degrees > 0
        quantile = special.stdtrit(np.maximum(self.degrees, 1), 0.5 + 0.5 * level)
        return np.where(several, quantile * np.sqrt(self.variance), np.inf)


def random_effects_means(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    between: Float[np.ndarray, " groups"],
) -> RandomEffectsMeans:
    """Means of groups, see this module. Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y and v.
    between : ndarray, shape (groups,)
        Variance between the estimates of each group, as `between` finds it.
    """
    found = weighted(groups, estimates, variances, between)
    degrees = groups.sizes - 1
    q = groups.sums(found.squares) / np.maximum(degrees, 1)
    return RandomEffectsMeans(
        found.mean,
        np.maximum(q, 1.0) / found.total,
        between,
        degrees,
        found.weights / groups.spread(found.total),
    )
