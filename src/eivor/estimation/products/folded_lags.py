"""Sums of products of successive lags of one series with other series, as matrix products.

Written one lag at a time these are dot products, which wait for memory. Instead the time axis is folded
into rows of `FOLD` samples: with A[r, c] = u[start - last + FOLD r + c] and W[r, p] = w[start + FOLD r + p],
one matrix product G = A'W holds every product, and the sum at lag l is that of the elements
G[p + last - l, p]. Only A is a copy, of one block; G is summed over the blocks before it is read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import as_strided

from eivor.models.column import Column
from eivor.shapes import Float

#: Samples folded into one row.
FOLD = 8


def folded_products(
    series: Float[np.ndarray, " n"],
    lags: tuple[int, int],
    others: Sequence[Float[np.ndarray, " m"]],
    blocks: Sequence[tuple[int, int]],
    start_of_others: int,
) -> Float[np.ndarray, "others width fold"]:
    """G of each other series, summed over the blocks.

    Parameters
    ----------
    series : ndarray, shape (n,)
        The lagged series, contiguous; every block starts at the largest lag or later.
    lags : tuple of int
        First and last lag.
    others : sequence of ndarray
        What to multiply with, contiguous, from sample `start_of_others` on.
    blocks : sequence of (start, stop)
        Ranges of samples, whose lengths are multiples of `FOLD`.
    start_of_others : int
        First sample of `others`.

    Notes
    -----
    Performs no checks.
    """
    width = FOLD + lags[1] - lags[0]
    total = np.zeros((len(others), width, FOLD))
    for start, stop in blocks:
        rows = (stop - start) // FOLD
        origin = series[start - lags[1] :]
        A = as_strided(origin, (rows, width), (FOLD * origin.strides[0], origin.strides[0])).copy()
        for j, other in enumerate(others):
            total[j] += A.T @ other[start - start_of_others : stop - start_of_others].reshape(rows, FOLD)
    return total


def unfolded(G: Float[np.ndarray, "*blocks others width fold"]) -> Float[np.ndarray, "*blocks lags others"]:
    """Sum at each lag, from the first to the last, of each other series."""
    count = G.shape[-2] - FOLD + 1
    p = np.arange(FOLD)
    return np.stack([G[..., p + count - 1 - lag, p].sum(axis=-1) for lag in range(count)], axis=-2)


def successive_lags(columns: Sequence[Column]) -> tuple[int, int] | None:
    """First and last lag of columns that are successive lags of one channel with a constant gain."""
    lags = [column.lag for column in columns]
    alike = len({(c.channel, c.gain, c.gain_channel) for c in columns}) == 1
    if len(lags) < 2 or not alike or not columns[0].channel or columns[0].gain_channel:
        return None
    return (lags[0], lags[-1]) if lags == list(range(lags[0], lags[-1] + 1)) else None
