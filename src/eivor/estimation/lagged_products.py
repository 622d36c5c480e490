"""Sums of products of successive lags of one series with other series, as matrix products.

Written one lag at a time these are dot products, which wait for memory. Instead the time axis of a block
is folded into rows of `FOLD` samples: with A[r, c] = u[start - last + FOLD r + c] and W[r, p] =
w[start + FOLD r + p], one matrix product G = A'W holds every product, and the sum at lag l is that of the
elements G[p + last - l, p]. Only A is a copy, of one block.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import as_strided

#: Samples folded into one row.
FOLD = 16


def lagged_products(
    series: Float[np.ndarray, " n"],
    lags: tuple[int, int],
    others: Sequence[Float[np.ndarray, " block"]],
    start: int,
    stop: int,
) -> Float[np.ndarray, "lags others"]:
    """sum_k series[k - l] other[k - start] for k = start .. stop-1 and each lag l from first to last.

    Parameters
    ----------
    series : ndarray, shape (n,)
        The lagged series, contiguous; `start` is at least the largest lag.
    lags : tuple of int
        First and last lag.
    others : sequence of ndarray, shape (stop - start,)
        Slices to multiply with, contiguous.
    start, stop : int
        Range of samples.

    Notes
    -----
    Performs no checks.
    """
    first, last = lags
    sums = np.zeros((last - first + 1, len(others)))
    rows = (stop - start) // FOLD
    folded = rows * FOLD
    if rows:
        width = FOLD + last - first
        origin = series[start - last :]
        A = as_strided(origin, (rows, width), (FOLD * origin.strides[0], origin.strides[0])).copy()
        for j, other in enumerate(others):
            G = A.T @ other[:folded].reshape(rows, FOLD)
            for p in range(FOLD):
                sums[:, j] += G[p : p + last - first + 1, p][::-1]
    for lag in range(first, last + 1):
        rest = series[start + folded - lag : stop - lag]
        for j, other in enumerate(others):
            sums[lag - first, j] += np.dot(rest, other[folded:])
    return sums
