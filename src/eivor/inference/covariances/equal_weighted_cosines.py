"""Long-run covariance by equal-weighted cosine averages (EWC).

L_j = sqrt(2/N) sum_t s_t cos(pi j (t - 1/2) / N), j = 1..B; the covariance of the sum of the scores is
(N/B) sum_j L_j L_j' (Lazarus, Lewis, Stock and Watson 2018). A constant in the scores drops out.

In a long record the cosines hardly change over a group of scores. Around the middle a of a group
cos(a + x) = (1 - x^2/2 + x^4/24) cos a - (x - x^3/6 + x^5/120) sin a, to rounding when x is small enough, so
that six moments of the group stand for all of its scores.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from eivor.shapes import Float

#: Number of cosine averages of the autocorrelation-robust covariance.
COSINE_AVERAGES = 8
#: Largest angle from the middle of a group: x^6/720 and x^7/5040 are below the rounding of sums.
LARGEST_ANGLE = 1e-2
#: Signs and factorials of the series, cosine and sine in turns.
SIGNS, FACTORIALS = (1, -1, -1, 1, 1, -1), np.array([1.0, 1.0, 2.0, 6.0, 24.0, 120.0])
#: Groups of fewer scores save nothing.
SHORTEST_GROUP = 8


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
    moments, middles, sums, start = [], [], [], 0
    step = np.pi * np.arange(1, averages + 1)[:, None] / count
    for block in scores:
        samples = block.shape[0]
        longest = min(int(2.0 * LARGEST_ANGLE / step[-1, 0]), samples)
        length = 1 << max(longest.bit_length() - 1, 0)  # a block is a power of two as well: no rest
        groups = samples // length if length >= SHORTEST_GROUP else 0
        grouped = groups * length
        if groups:
            moments.append(block[:grouped].T.reshape(-1, groups, length) @ _powers(float(step[0, 0]), length))
            middles.append(start + 0.5 * length + length * np.arange(groups))
        if grouped < samples:
            sums.append(np.cos(step * (start + 0.5 + np.arange(grouped, samples))) @ block[grouped:])
        start += samples
    if moments:
        sums.append(_sums_of_groups(np.concatenate(moments, axis=1), step * np.concatenate(middles)))
    if not sums:
        raise ValueError("no block of scores")
    return np.asarray(sum(sums))


def _sums_of_groups(
    moments: Float[np.ndarray, "n groups powers"], middles: Float[np.ndarray, "averages groups"]
) -> Float[np.ndarray, "averages n"]:
    """Sums of the scores times each cosine, from moments of groups around their middle angles."""
    cosine, sine = np.cos(middles), np.sin(middles)
    order = np.arange(1, middles.shape[0] + 1)[:, None]
    return np.asarray(
        sum(
            sign * order**power * ((sine if power % 2 else cosine) @ moments[:, :, power].T)
            for power, sign in enumerate(SIGNS)
        )
    )


def cosine_averages(
    scores: Float[np.ndarray, "samples *shape"], averages: int
) -> Float[np.ndarray, "averages *shape"]:
    """sqrt(count) L_j of scores that are all at hand: the mean of their squares is the variance of the sum.

    By a cosine transform, O(count log(count)) for each column however many averages. Performs no checks.

    Notes
    -----
    The transform is the Fourier transform of the even scores followed by the odd ones backwards, each
    coefficient turned by half a sample (Makhoul 1980); `scipy.fft` alone takes longer to load than that.
    """
    count = scores.shape[0]
    spectrum = np.fft.fft(np.concatenate([scores[::2], scores[1::2][::-1]]), axis=0)[1 : averages + 1]
    turned = np.exp(-0.5j * np.pi * np.arange(1, averages + 1) / count)[: spectrum.shape[0]]
    return np.sqrt(2.0) * (turned * spectrum.T).T.real


def long_run_sum_covariance(
    scores: Float[np.ndarray, "samples n"], averages: int = COSINE_AVERAGES
) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum of scores that are all at hand."""
    return cosine_covariance([scores], scores.shape[0], averages)


def long_run_mean_variance(series: Float[np.ndarray, " samples"], averages: int = COSINE_AVERAGES) -> float:
    """Variance of the mean of an autocorrelated series, by the same cosine averages."""
    return float(long_run_sum_covariance(series[:, None], averages)[0, 0]) / series.size**2


@lru_cache(maxsize=8)
def _powers(step: float, length: int) -> Float[np.ndarray, "length powers"]:
    """x^k / k! at the samples of a group, for angles x from its middle."""
    offset = np.arange(length) - 0.5 * (length - 1)
    return np.vander(step * offset, len(SIGNS), increasing=True) / FACTORIALS
