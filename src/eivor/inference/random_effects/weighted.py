"""Weighted means of groups, and how far estimates lie from them, at a given variance between estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Float


@dataclass(frozen=True)
class Weighted:
    """Weighted means.

    Parameters
    ----------
    weights : ndarray, shape (rows,)
        w = 1 / (v + between).
    total : ndarray, shape (groups,)
        Sum of the weights of a group.
    mean : ndarray, shape (groups,)
        Weighted mean.
    squares : ndarray, shape (rows,)
        w (y - mean)^2.
    """

    weights: Float[np.ndarray, " rows"]
    total: Float[np.ndarray, " groups"]
    mean: Float[np.ndarray, " groups"]
    squares: Float[np.ndarray, " rows"]


def weighted(
    groups: Groups,
    estimates: Float[np.ndarray, " rows"],
    variances: Float[np.ndarray, " rows"],
    between: Float[np.ndarray, " groups"],
) -> Weighted:
    """Weighted means of groups. Performs no checks.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    estimates, variances : ndarray, shape (rows,)
        y, and v > 0.
    between : ndarray, shape (groups,)
        Variance between the estimates of each group.
    """
    weights = weights_of(groups, variances, between)
    total = groups.sums(weights)
    mean = groups.sums(weights * estimates) / total
    squares = groups.spread(mean)
    squares -= estimates
    squares *= squares
    squares *= weights
    return Weighted(weights, total, mean, squares)


def weights_of(
    groups: Groups, variances: Float[np.ndarray, " rows"], between: Float[np.ndarray, " groups"]
) -> Float[np.ndarray, " rows"]:
    """1 / (v + between), in an array of its own. Performs no checks."""
    weights = groups.spread(between)
    weights += variances
    return np.reciprocal(weights, out=weights)
