"""Draws of a vector of estimates, each by the law that its interval is read from, and correlated as they are.

Each estimate has the part of the covariance that makes its 95 % interval the widest: Student's t of that
part's degrees of freedom, times its standard error. One chi-square variable is shared by all that have the
same degrees, so that those are jointly of a multivariate t, whose correlations are the covariance's; between
different degrees the normal scores' correlation is raised by what the tails take from it.

The draws are a Latin hypercube with this dependence (Packham and Schmidt, 2010): of m draws each estimate has
one in each of m strata of its law, in the order of the plain draws, so that quantiles do not err by chance.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from eivor.errors import EstimationError
from eivor.inference.covariances.covariance import JointCovariance
from eivor.shapes import Float

#: Level of the interval that chooses an estimate's part.
LEVEL = 0.95
#: Student's t with fewer degrees has no variance, hence no correlations.
FEWEST_DEGREES = 2.0
#: Strata at the least: of fewer the order of the draws would not tell their correlations.
STRATA = 16384


def joint_draws(
    values: Float[np.ndarray, " n"], covariance: JointCovariance, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "count n"]:
    """Draw vectors around the estimates.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Estimates: the medians.
    covariance : JointCovariance
        Of them.
    count : int
        How many.
    rng : numpy.random.Generator
        Where they come from.

    Returns
    -------
    ndarray, shape (count, n)
        One vector in each row.

    Raises
    ------
    EstimationError
        When an estimate has no finite variance.
    """
    laws = [_law(covariance, direction) for direction in np.eye(values.size)]
    degrees = np.array([one for one, _ in laws])
    scales = np.array([scale for _, scale in laws])
    if not np.all(np.isfinite(scales)) or np.any(degrees <= FEWEST_DEGREES):
        raise EstimationError(
            f"estimates with finite variances, of more than {FEWEST_DEGREES:g} degrees of freedom",
            f"{degrees.min():.3g} degrees and a largest standard error of {scales.max():.3g}",
            "Fly longer, or pool several flights.",
        )
    strata = max(count, STRATA)
    scores = rng.standard_normal((strata, values.size)) @ _root(_score_correlations(covariance, degrees)).T
    for each in np.unique(degrees[np.isfinite(degrees)]):
        scores[:, degrees == each] *= np.sqrt(each / rng.chisquare(each, strata))[:, None]
    shares = (scores.argsort(axis=0).argsort(axis=0)[:count] + rng.random((count, values.size))) / strata
    return values + scales * np.stack(
        [_quantiles(column, one) for column, one in zip(shares.T, degrees, strict=True)], axis=1
    )


def _quantiles(shares: Float[np.ndarray, " count"], degrees: float) -> Float[np.ndarray, " count"]:
    """Quantiles of Student's t, or of the normal distribution."""
    found = special.ndtri(shares) if math.isinf(degrees) else special.stdtrit(degrees, shares)
    return np.asarray(found)


def _law(covariance: JointCovariance, direction: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Degrees of freedom and scale of the part whose interval is the widest."""
    part = max(covariance.parts, key=lambda one: one.half_width(direction, LEVEL))
    return part.degrees, math.sqrt(part.variance(direction) / part.share)


def _score_correlations(
    covariance: JointCovariance, degrees: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n n"]:
    """Correlations of the normal scores, with which the draws have those of the covariance."""
    matrix = covariance.matrix
    scale = np.sqrt(np.diag(matrix))
    size = np.outer(scale, scale)
    correlations = np.divide(matrix, size, out=np.zeros_like(matrix), where=size > 0.0)
    kept = np.array([_kept(one) for one in degrees])
    apart = degrees[:, None] != degrees
    correlations = np.where(apart, correlations / np.outer(kept, kept), correlations)
    np.fill_diagonal(correlations, 1.0)
    return np.clip(correlations, -1.0, 1.0)


def _kept(degrees: float) -> float:
    """Mean over root mean square of the factor that turns a normal score into Student's t."""
    if math.isinf(degrees):
        return 1.0
    half = 0.5 * degrees
    mean = math.exp(special.gammaln(half - 0.5) - special.gammaln(half)) * math.sqrt(half)
    return mean * math.sqrt((degrees - 2.0) / degrees)


def _root(correlations: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Square root of the nearest matrix without negative eigenvalues, its diagonal one again."""
    eigenvalues, vectors = np.linalg.eigh(correlations)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    scaled: Float[np.ndarray, "n n"] = root / np.linalg.norm(root, axis=1, keepdims=True)
    return scaled
