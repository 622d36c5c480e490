"""Covariance of an estimate whose rows are forgotten, robust to errors with memory.

The estimate makes G = sum_b a_b g_b zero, where g_b are the scores of blocks and a_b their weights. With the
long-run covariance Omega of the scores, the variance of G is Omega sum of squared weights. Omega is the mean
square of weighted sums P_j = sum_b c_jb g_b, where the c_j are orthonormal, orthogonal to the weights a, so
that P_j and G are independent, and to the sensitivities of the blocks, so that what theta_hat misses drops
out. They are cosines over the weights' own time, s_b = share of the squared weights up to b, times the
weights: equal-weighted cosines of an estimate that forgets, with t on their number of degrees of freedom.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from eivor.estimation.recursive.faded_products import FadedProducts
from eivor.estimation.solved import Solved
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.covariances.equal_weighted_cosines import COSINE_AVERAGES
from eivor.shapes import Float


def equation_map(solved: Solved) -> Float[np.ndarray, "n p"]:
    """Return what a change of the mean scores changes the solution by, to first order: (A'WA)^-1 A'W."""
    A, factor = solved.system.matrix, solved.factor
    if factor is not None:
        A = scipy.linalg.solve_triangular(factor, A, lower=True)
    Q, R = np.linalg.qr(A)
    if factor is not None:
        Q = scipy.linalg.solve_triangular(factor, Q, lower=True, trans="T")
    mapped: Float[np.ndarray, "n p"] = scipy.linalg.solve_triangular(R, Q.T)
    return mapped


def faded_covariance(
    faded: FadedProducts, theta: Float[np.ndarray, " n"], mapped: Float[np.ndarray, "n p"]
) -> JointCovariance:
    """Covariance of an estimate from faded products.

    Parameters
    ----------
    faded : FadedProducts
        Blocks of rows.
    theta : ndarray, shape (n,)
        The estimate.
    mapped : ndarray, shape (n, p)
        See `equation_map`.

    Returns
    -------
    JointCovariance
        Of equal-weighted cosines, and of blocks without memory beyond their own length: the wider counts.
    """
    scores, weights, leaks = _weighted_blocks(faded, theta, mapped)
    count = faded.total.products.count
    rows = scores / count
    cosines = _cosines(weights, leaks)
    averages = cosines.T @ rows
    used = averages.shape[0]
    power = float(weights @ weights)
    meat = power * (averages.T @ averages) / max(used, 1)
    weighted = weights[:, None] * rows
    single = weighted.T @ weighted
    effective = power**2 / float(np.sum(weights**4)) if power > 0.0 else 0.0
    degrees = max(effective - theta.size, 0.0)
    single = single * (effective / degrees if degrees > 0.0 else 1.0)
    return JointCovariance(
        (
            CovariancePart("equal_weighted_cosines", meat, float(used)),
            CovariancePart("blocks", single, degrees),
        )
    )


def _weighted_blocks(
    faded: FadedProducts, theta: Float[np.ndarray, " n"], mapped: Float[np.ndarray, "n p"]
) -> tuple[Float[np.ndarray, "K n"], Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Scores of unit variance, weights and sensitivities of the blocks that have rows and are kept apart."""
    blocks, factors = faded.recent
    filled = blocks.squares > 0.0
    size = np.sqrt(np.where(filled, blocks.squares, 1.0))
    scores = faded.scores(blocks, theta) @ mapped.T / size[:, None]
    return scores[filled], (factors * size)[filled], (blocks.products.counts / size)[filled]


def _cosines(
    weights: Float[np.ndarray, " K"], leaks: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K averages"]:
    """Orthonormal cosines over the weights' own time, orthogonal to the weights and to the leaks."""
    averages = min(COSINE_AVERAGES, weights.size - 2)
    if averages < 1:
        return np.zeros((weights.size, 0))
    shares = weights**2
    time = (np.cumsum(shares) - 0.5 * shares) / shares.sum()
    waves = np.cos(np.pi * np.arange(1, averages + 1) * time[:, None])
    Q, _ = np.linalg.qr(np.column_stack([weights, leaks, weights[:, None] * waves]))
    found: Float[np.ndarray, "K averages"] = Q[:, 2:]
    return found
