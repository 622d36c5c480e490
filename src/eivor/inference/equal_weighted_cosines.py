"""Long-run covariance by equal-weighted cosine averages (EWC).

L_j = sqrt(2/N) sum_t s_t cos(pi j (t - 1/2) / N), j = 1..B; the covariance of the sum of the scores is
(N/B) sum_j L_j L_j' (Lazarus, Lewis, Stock and Watson 2018). A constant in the scores drops out.

Within a block the cosine of a sum of angles splits into products, so that a block of m x r scores needs
m + r cosines for each average instead of m r, and one matrix product.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

#: Number of cosine averages of the autocorrelation-robust covariance.
COSINE_AVERAGES = 8


def cosine_covariance(
    scores: Iterable[Float[np.ndarray, "_ n"]], count: int, averages: int = COSINE_AVERAGES
) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum of autocorrelated scores. Performs no checks.

    Parameters
    ----------
    scores : iterable of ndarray, shapes (samples, n)
        Successive blocks.
    count : int
        Number of scores in all of them.
    averages : int
        B.

    Notes
    -----
    O(count n B).
    """
    sums = cosine_sums(scores, count, averages)
    covariance: Float[np.ndarray, "n n"] = (2.0 / averages) * sums.T @ sums
    return covariance


def cosine_sums(
    scores: Iterable[Float[np.ndarray, "_ n"]], count: int, averages: int
) -> Float[np.ndarray, "averages n"]:
    """Sums of the scores times each cosine, sqrt(count/2) L. Performs no checks."""
    total, start = None, 0
    for block in scores:
        found = _block_sums(block, start, count, averages)
        total = found if total is None else total + found
        start += block.shape[0]
    if total is None:
        raise ValueError("no block of scores")
    return total


def long_run_sum_covariance(
    scores: Float[np.ndarray, "samples n"], averages: int = COSINE_AVERAGES
) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum of scores that are all at hand."""
    return cosine_covariance([scores], scores.shape[0], averages)


def long_run_mean_variance(series: Float[np.ndarray, " samples"], averages: int = COSINE_AVERAGES) -> float:
    """Variance of the mean of an autocorrelated series, by the same cosine averages."""
    return float(long_run_sum_covariance(series[:, None], averages)[0, 0]) / series.size**2


def _block_sums(
    block: Float[np.ndarray, "samples n"], start: int, count: int, averages: int
) -> Float[np.ndarray, "averages n"]:
    """Sum over a block that begins at sample `start`, as a grid of m rows of r samples and a rest."""
    samples, unknowns = block.shape
    step = np.pi * np.arange(1, averages + 1)[:, None] / count
    r = max(int(np.sqrt(samples)), 1)
    m = samples // r
    outer, inner = step * (start + 0.5 + r * np.arange(m)), step * np.arange(r)
    grid = np.ascontiguousarray(block[: m * r]).reshape(m, r * unknowns)
    both = (np.concatenate([np.cos(outer), np.sin(outer)]) @ grid).reshape(2, averages, r, unknowns)
    sums: Float[np.ndarray, "averages n"] = np.einsum("jr,jrn->jn", np.cos(inner), both[0])
    sums -= np.einsum("jr,jrn->jn", np.sin(inner), both[1])
    if m * r < samples:
        sums += np.cos(step * (start + 0.5 + np.arange(m * r, samples))) @ block[m * r :]
    return sums
