"""Sums of products of successive lags of one series with other series, as matrix products.

Written one lag at a time these are dot products, which wait for memory. Instead the time axis is folded
into rows of `FOLD` samples: with A[r, c] = u[start - last + FOLD r + c] and W[r, p] = w[start + FOLD r + p],
one matrix product G = A'W holds every product, and the sum at lag l is that of the elements
G[p + last - l, p]. Only A is a copy, of one block; G is summed over the blocks before it is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeGuard

import numpy as np
from numpy.lib.stride_tricks import as_strided

from eivor.models.column import Column
from eivor.models.regression import LinearProblem, RowBlock
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Float

#: Samples folded into one row.
FOLD = 8
#: Taps of a filter that `np.correlate` computes fast; longer filters are sums of such.
FAST_TAPS = 11


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


def lags_without_gaps(problem: LinearProblem | None) -> TypeGuard[SignalRegression]:
    """Whether every sample of signals is a row, and the instruments are successive lags of one channel."""
    return (
        isinstance(problem, SignalRegression)
        and problem.used is None
        and problem.instrument_count > 0
        and successive_lags(problem.instrument_columns) is not None
    )


def filtered_instruments(
    problem: SignalRegression, combinations: Float[np.ndarray, "p n"], start: int, stop: int
) -> RowBlock:
    """Rows from sample `start` to `stop`, with combinations of successive lags in the instruments' place.

    Each combination is a filter of the channel, so that no array of lags is made.
    """
    lags = problem.instrument_columns
    reached = problem.signals.channel(lags[0].channel)[start - lags[-1].lag : stop - lags[0].lag]
    taps = lags[0].gain * combinations[::-1].T
    psi = np.empty((len(taps), stop - start))
    for row, one in zip(psi, taps, strict=True):
        _filter(reached, one, row)
    response = problem.columns_between([problem.equation.response], start, stop)[:, 0]
    regressors = problem.columns_between(problem.regressor_columns, start, stop)
    return RowBlock(response, regressors, psi.T, np.zeros(stop - start, dtype=np.int64))


def _filter(
    series: Float[np.ndarray, " reached"], taps: Float[np.ndarray, " p"], filtered: Float[np.ndarray, " rows"]
) -> None:
    """Fill in the sums of as many successive samples as there are taps, weighted by them."""
    filtered[:] = 0.0
    for at in range(0, taps.size, FAST_TAPS):
        some = taps[at : at + FAST_TAPS]
        filtered += np.correlate(series[at : at + filtered.size - 1 + some.size], some, "valid")
