"""Slopes of estimates on covariates that groups share, from what varies within groups beside their course.

Means and courses of the groups are taken out of estimates and covariates alike (Frisch and Waugh 1933), so
that neither what makes a group another one nor its wear is taken for the weather.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.inference.courses.ordered import centred, slope
from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Float

#: Degrees of freedom that must be left for slopes to be estimated.
FEWEST_DEGREES = 5
#: Directions in which covariates vary by less than this share of their whole variation have no slope.
SMALL = 1e-6


@dataclass(frozen=True)
class SharedSlopes:
    """Slopes of sets of groups.

    Parameters
    ----------
    values : ndarray, shape (sets, p)
        As expected where there is too little to tell them.
    covariance : ndarray, shape (sets, p, p)
        Theirs.
    """

    values: Float[np.ndarray, "sets p"]
    covariance: Float[np.ndarray, "sets p p"]


def shared_slopes(
    groups: Groups,
    sets: Groups,
    y: Float[np.ndarray, " rows"],
    weights: Float[np.ndarray, " rows"],
    courses: Float[np.ndarray, "c rows"],
    covariates: Float[np.ndarray, "p rows"],
    expected: Float[np.ndarray, " p"],
    uncertainty: Float[np.ndarray, " p"],
) -> SharedSlopes:
    """Slopes by weighted least squares. Performs no checks.

    Parameters
    ----------
    groups, sets : Groups
        Of the rows, and of the groups: those of a set share their slopes.
    y, weights : ndarray, shape (rows,)
        Estimates, and 1 / variance.
    courses : ndarray, shape (c, rows)
        What else groups may go with, each with a slope of its own: time, a step.
    covariates : ndarray, shape (p, rows)
        Each row without gaps.
    expected, uncertainty : ndarray, shape (p,)
        What slopes are expected to be, and how well that is known (one standard deviation, infinite where it
        is not): a measurement beside the others.
    """
    count = covariates.shape[0]
    taken: list[Float[np.ndarray, " rows"]] = []

    def within(values: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        left = centred(groups, weights, values)
        for one in taken:
            left = left - groups.spread(slope(groups, weights, one, left)) * one
        return left

    taken.extend(within(one) for one in courses)  # each without those before it

    def total(values: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " sets"]:
        return sets.sums(groups.sums(values))

    left, x = within(y), [within(one) for one in covariates]
    gram = np.empty((sets.sizes.size, count, count))
    moment = np.empty((sets.sizes.size, count))
    for i in range(count):
        moment[:, i] = total(weights * x[i] * left)
        for j in range(count):
            gram[:, i, j] = total(weights * x[i] * x[j])
    whole = np.array([total(weights * one**2) for one in covariates]).reshape(count, sets.sizes.size).T
    degrees = sets.sums(np.maximum(groups.sizes - 1 - len(taken), 0).astype(float)) - count
    told = degrees >= FEWEST_DEGREES
    prior = np.diag(uncertainty**-2.0)
    gram = np.where(told[:, None, None], gram, 0.0) + prior
    moment = np.where(told[:, None], moment, 0.0) + prior @ expected
    size = np.sqrt(np.maximum(np.einsum("sii->si", gram), SMALL * whole + np.finfo(float).tiny))
    inverse = np.linalg.pinv(gram / (size[:, :, None] * size[:, None, :]), rcond=SMALL, hermitian=True)
    inverse = inverse / (size[:, :, None] * size[:, None, :])
    values = np.einsum("sij,sj->si", inverse, moment)
    squares = total(weights * left**2) + expected @ prior @ expected - np.einsum("si,si->s", values, moment)
    scale = np.where(told, np.maximum(squares / np.maximum(degrees, 1.0), 1.0), 1.0)
    return SharedSlopes(values, scale[:, None, None] * inverse)
