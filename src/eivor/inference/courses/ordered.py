"""Estimates of groups in their order, and straight lines through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.inference.random_effects.groups import Groups
from eivor.shapes import Float


@dataclass(frozen=True)
class Ordered:
    """Estimates in the order of their groups.

    Parameters
    ----------
    groups : Groups
        Of the rows.
    y, errors : ndarray, shape (rows,)
        Estimates, less what covariates explain, and their variances v: their own, and what `isolated` adds.
    weights : ndarray, shape (rows,)
        w = 1 / (v + variance between).
    own_weights : ndarray, shape (rows,)
        The same by their own variances alone.
    at : ndarray, shape (rows,)
        When, in a unit that the slopes are of; it rises within a group.
    covariates : ndarray, shape (p, rows)
        What y was corrected for.
    slopes_covariance : ndarray, shape (groups, p, p)
        Of the slopes by which it was corrected.
    """

    groups: Groups
    y: Float[np.ndarray, " rows"]
    errors: Float[np.ndarray, " rows"]
    weights: Float[np.ndarray, " rows"]
    own_weights: Float[np.ndarray, " rows"]
    at: Float[np.ndarray, " rows"]
    covariates: Float[np.ndarray, "p rows"]
    slopes_covariance: Float[np.ndarray, "groups p p"]

    @property
    def least_scale(self) -> Float[np.ndarray, " groups"]:
        """What the weighted squares of rows are on average, at least: the share of their own variances."""
        return self.groups.sums(self.weights * self.errors) / self.groups.sizes

    def scale(self, squares: Float[np.ndarray, " groups"], parameters: int) -> Float[np.ndarray, " groups"]:
        """Mean of weighted squares about a model, never less than the rows' own variances say.

        Parameters
        ----------
        squares : ndarray, shape (groups,)
            Sum of them.
        parameters : int
            Of the model.
        """
        degrees = np.maximum(self.groups.sizes - parameters, 1)
        return np.maximum(squares / degrees, self.least_scale)

    def correction_variance(
        self, differences: Float[np.ndarray, "p rows"], of_rows: bool
    ) -> Float[np.ndarray, " rows"]:
        """Variance that unknown slopes add to an effect that covariates differ by, d' C d.

        Parameters
        ----------
        differences : ndarray, shape (p, groups) or (p, rows)
            d.
        of_rows : bool
            Whether it has a column for each row.
        """
        covariance = self.slopes_covariance
        if of_rows:
            covariance = np.repeat(covariance, self.groups.sizes, axis=0)
        return np.einsum("ig,gij,jg->g", differences, covariance, differences)


def centred(
    groups: Groups, weights: Float[np.ndarray, " rows"], values: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Values less the weighted mean of their group."""
    return values - groups.spread(groups.sums(weights * values) / groups.sums(weights))


def slope(
    groups: Groups,
    weights: Float[np.ndarray, " rows"],
    at: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, " groups"]:
    """Slope of values on something centred, in each group; zero where that does not vary."""
    spread = groups.sums(weights * at**2)
    return groups.sums(weights * at * values) / np.where(spread > 0.0, spread, np.inf)
