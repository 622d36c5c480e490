"""Products of the columns of signals, without a matrix of lags.

The columns of a `SignalRegression` are slices of its channels, so the product of an instrument and a
regressor is a dot product of two slices, and successive lags are folded into matrix products; all pairs
of a block are taken while it is in the cache.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from eivor.errors import TooFewSamplesError
from eivor.estimation.products.folded_lags import FOLD, folded_products, successive_lags, unfolded
from eivor.inference.products import ProductLayout, Products
from eivor.linalg.row_blocks import MULTIPLIED_ROWS, row_blocks
from eivor.linalg.triangular import merged_roots
from eivor.models.column import Column
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Float

#: Blocks that one thread sums before it hands in, and how many such stretches are worth threads.
STRETCH_BLOCKS = 64
THREADED_FROM = 4


def products_of_signals(problem: SignalRegression, *, instruments: bool, whole: bool) -> Products:
    """Products of a problem's columns, in one block.

    Parameters
    ----------
    problem : SignalRegression
        Rows.
    instruments : bool
        False takes the regressors themselves as psi.
    whole : bool
        Also multiply instruments, and regressors and response, among themselves.

    Raises
    ------
    TooFewSamplesError
        When there is no row.
    """
    right = (*problem.regressor_columns, problem.equation.response)
    left = problem.instrument_columns if instruments else problem.regressor_columns
    counts = np.array([row_count(problem)], dtype=np.float64)
    layout = ProductLayout(len(left), len(right) - 1, whole)
    cross = _sums(problem, left, right)
    if not whole:
        return Products(counts, cross[None], layout)
    sums = np.block([[_own_sums(problem, left), cross], [cross.T, _own_sums(problem, right)]])
    return Products(counts, sums[None], layout)


def _sums(
    problem: SignalRegression, left: Sequence[Column], right: Sequence[Column]
) -> Float[np.ndarray, "left right"]:
    """Sums of products of columns.

    Stretches of a long record are shared between threads (NumPy's products leave the interpreter free).
    What the stretches are does not depend on the number of threads, and their sums are added in their
    order, so that the result does not either.
    """
    first, last = problem.first, problem.signals.sample_count
    gains = np.outer([c.gain for c in left], [c.gain for c in right])
    lags = successive_lags(left)
    plain = problem.used is None and all(c.channel and not c.gain_channel for c in right)
    if lags is None or not plain:
        stretches = list(row_blocks(first, last, MULTIPLIED_ROWS))
        return gains * _added(lambda stretch: _products_of(problem, left, right, *stretch), stretches)
    series = problem.signals.channel(left[0].channel)
    others = [problem.signals.channel(c.channel)[first - c.lag : last - c.lag] for c in right]
    whole = first + (last - first) // FOLD * FOLD
    stretches = list(row_blocks(first, whole, MULTIPLIED_ROWS * STRETCH_BLOCKS))

    def folded(stretch: tuple[int, int]) -> Float[np.ndarray, "others width fold"]:
        return folded_products(series, lags, others, list(row_blocks(*stretch, MULTIPLIED_ROWS)), first)

    sums = unfolded(_added(folded, stretches)) if stretches else np.zeros((len(left), len(right)))
    return gains * (sums + _products_of(problem, left, right, whole, last))


def _products_of(
    problem: SignalRegression, left: Sequence[Column], right: Sequence[Column], start: int, stop: int
) -> Float[np.ndarray, "left right"]:
    """Products of all pairs of columns over a stretch, without their constant gains."""
    rights = [_slice(problem, column, start, stop) for column in right]
    lefts = [_slice(problem, column, start, stop) for column in left]
    return np.array([[np.dot(one, other) for other in rights] for one in lefts])


def _added(
    part: Callable[[tuple[int, int]], Float[np.ndarray, "*shape"]], stretches: list[tuple[int, int]]
) -> Float[np.ndarray, "*shape"]:
    """Parts of all stretches, added in their order."""
    total = part(stretches[0])
    if len(stretches) < THREADED_FROM:
        for stretch in stretches[1:]:
            total = total + part(stretch)
        return total
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for found in pool.map(part, stretches[1:]):
            total = total + found
    return total


def _own_sums(problem: SignalRegression, columns: Sequence[Column]) -> Float[np.ndarray, "p p"]:
    """Sums of products of columns among themselves.

    For lags of one channel the sum at lags (i + 1, j + 1) is that at (i, j) but for the samples at both
    ends of the record, so that one row of sums gives them all.
    """
    count = len(columns)
    sums = np.empty((count, count))
    if successive_lags(columns) is None or problem.used is not None:
        for j in range(count):
            sums[j, : j + 1] = sums[: j + 1, j] = _sums(problem, columns[: j + 1], columns[j : j + 1])[:, 0]
        return sums
    lags = [column.lag for column in columns]
    sums[0] = sums[:, 0] = _sums(problem, columns, columns[:1])[:, 0] / columns[0].gain ** 2
    values = problem.signals.channel(columns[0].channel)
    first, last = problem.first, problem.signals.sample_count
    for i in range(count - 1):
        for j in range(i + 1):
            entering = values[first - 1 - lags[i]] * values[first - 1 - lags[j]]
            leaving = values[last - 1 - lags[i]] * values[last - 1 - lags[j]]
            sums[i + 1, j + 1] = sums[j + 1, i + 1] = sums[i, j] + entering - leaving
    return sums * columns[0].gain ** 2


def root_of_signals(problem: SignalRegression) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [phi y], block by block."""
    columns = (*problem.regressor_columns, problem.equation.response)
    gains = np.array([column.gain for column in columns])
    root = np.empty((0, len(columns)))
    for start, stop in row_blocks(problem.first, problem.signals.sample_count, 4 * MULTIPLIED_ROWS):
        block = np.column_stack([_slice(problem, column, start, stop) for column in columns])
        root = merged_roots(root, block * gains)
    return row_count(problem), root


def row_count(problem: SignalRegression) -> int:
    """Number of rows of a problem.

    Raises
    ------
    TooFewSamplesError
        When there is none.
    """
    count = problem.signals.sample_count - problem.first
    if count < 1:
        raise TooFewSamplesError(
            f"more than {problem.first} samples, the largest lag",
            f"{problem.signals.sample_count}",
            "Give a longer record or fewer lags.",
        )
    return count if problem.used is None else int(problem.used.sum())


def _slice(problem: SignalRegression, column: Column, start: int, stop: int) -> Float[np.ndarray, " rows"]:
    """Rows of a column without its constant gain: a view, unless it is multiplied or masked."""
    values = problem.slice_of(column, start, stop)
    if problem.used is not None:
        values = values[problem.used[start - problem.first : stop - problem.first]]
    return values
