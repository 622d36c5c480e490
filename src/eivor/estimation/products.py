"""Sums over rows in blocks: cross-products and roots, without a matrix of lags.

The columns of a `SignalRegression` are slices of its channels, so the product of an instrument and a
regressor is a dot product of two slices, and successive lags are folded into matrix products; all pairs
of a block are taken while it is in the cache. For rows in arrays it is a matrix product, block by block.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import InstrumentError, NonFiniteError, TooFewSamplesError
from eivor.estimation.block_products import BlockProducts, block_products
from eivor.estimation.lagged_products import FOLD, folded_products, successive_lags, unfolded
from eivor.linalg.triangular import merged_roots, triangular_root
from eivor.models.column import Column
from eivor.models.regression import LinearProblem, Regression
from eivor.models.signal_regression import SignalRegression

#: Rows in a block: a few columns of it fit in a second-level cache.
BLOCK_ROWS = 32_768
#: Blocks that one thread sums before it hands in, and how many such stretches are worth threads.
STRETCH_BLOCKS = 64
THREADED_FROM = 4


@dataclass(frozen=True, slots=True)
class MeanProducts:
    """Mean cross-products over the rows.

    Parameters
    ----------
    count : int
        Number of rows.
    cross : ndarray, shape (p, n + 1)
        mean(psi [phi' y]).
    instruments, regressors : ndarray, shapes (p, p) and (n, n), optional
        mean(psi psi') and mean(phi phi').
    blocks : BlockProducts, optional
        The sums that they were made of, block by block in time.
    """

    count: int
    cross: Float[np.ndarray, "p n_plus_1"]
    instruments: Float[np.ndarray, "p p"] | None = None
    regressors: Float[np.ndarray, "n n"] | None = None
    blocks: BlockProducts | None = None


def mean_cross_products(problem: LinearProblem, *, instruments: bool, own: bool) -> MeanProducts:
    """Mean cross-products; with `own` also those of instruments and of regressors among themselves.

    Parameters
    ----------
    problem : LinearProblem
        Rows.
    instruments : bool
        False takes the regressors themselves as psi.
    own : bool
        Also average the products of instruments, and of regressors, with each other.

    Raises
    ------
    InstrumentError
        When there are no instruments to multiply with.
    NonFiniteError
        When a product is not finite.
    """
    if instruments and not problem.instrument_count:
        raise InstrumentError(
            "instruments",
            "a problem without any",
            'Name them: regression(signals, ev.lags("input", 0, 10)), or regression(instruments=...).',
        )
    if isinstance(problem, SignalRegression):
        found = _of_signals(problem, instruments=instruments, own=own)
    else:
        found = _of_arrays(problem.rows(), instruments=instruments, own=own)
    if not np.isfinite(found.cross).all():
        raise NonFiniteError(
            "finite cross-products", "NaN or infinity", "Check the channels for overflow or missing values."
        )
    return found


def _of_arrays(rows: Regression, *, instruments: bool, own: bool) -> MeanProducts:
    Phi, y = rows.regressors, rows.response
    Psi = rows.instruments if instruments else Phi
    count = y.size
    cross = np.zeros((Psi.shape[1], Phi.shape[1] + 1))
    squares = [np.zeros((A.shape[1], A.shape[1])) for A in (Psi, Phi)] if own else []
    for first in range(0, count, BLOCK_ROWS):
        here = slice(first, first + BLOCK_ROWS)
        cross[:, :-1] += Psi[here].T @ Phi[here]
        cross[:, -1] += Psi[here].T @ y[here]
        for place, A in enumerate((Psi, Phi) if own else ()):
            squares[place] += A[here].T @ A[here]
    instrument_mean, regressor_mean = (square / count for square in squares) if own else (None, None)
    return MeanProducts(count, cross / count, instrument_mean, regressor_mean)


def _of_signals(problem: SignalRegression, *, instruments: bool, own: bool) -> MeanProducts:
    blocks = block_products(problem) if instruments and own else None
    if blocks is not None:
        return _of_blocks(problem, blocks)
    regressors = problem.regressor_columns
    left = problem.instrument_columns if instruments else regressors
    count = row_count(problem)
    cross = _sums(problem, left, (*regressors, problem.equation.response))
    if not own:
        return MeanProducts(count, cross / count)
    return MeanProducts(
        count, cross / count, _own_sums(problem, left) / count, _own_sums(problem, regressors) / count
    )


def _of_blocks(problem: SignalRegression, blocks: BlockProducts) -> MeanProducts:
    p, means = len(problem.instrument_columns), blocks.means
    return MeanProducts(row_count(problem), means[:p, p:], means[:p, :p], means[p:-1, p:-1], blocks)


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
        stretches = list(blocks(first, last))
        return gains * _added(lambda stretch: _products_of(problem, left, right, *stretch), stretches)
    series = problem.signals.channel(left[0].channel)
    others = [problem.signals.channel(c.channel)[first - c.lag : last - c.lag] for c in right]
    whole = first + (last - first) // FOLD * FOLD
    stretches = list(blocks(first, whole, BLOCK_ROWS * STRETCH_BLOCKS))

    def folded(stretch: tuple[int, int]) -> Float[np.ndarray, "others width fold"]:
        return folded_products(series, lags, others, list(blocks(*stretch)), first)

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
    if successive_lags(columns) is None or problem.used is not None:
        return _sums(problem, columns, columns)
    lags = [column.lag for column in columns]
    count = len(columns)
    sums = np.empty((count, count))
    sums[0] = sums[:, 0] = _sums(problem, columns, columns[:1])[:, 0] / columns[0].gain ** 2
    values = problem.signals.channel(columns[0].channel)
    first, last = problem.first, problem.signals.sample_count
    for i in range(count - 1):
        for j in range(i + 1):
            entering = values[first - 1 - lags[i]] * values[first - 1 - lags[j]]
            leaving = values[last - 1 - lags[i]] * values[last - 1 - lags[j]]
            sums[i + 1, j + 1] = sums[j + 1, i + 1] = sums[i, j] + entering - leaving
    return sums * columns[0].gain ** 2


def root_of_rows(problem: LinearProblem) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [Phi y]."""
    if not isinstance(problem, SignalRegression):
        rows = problem.rows()
        return rows.response.size, triangular_root(np.column_stack([rows.regressors, rows.response]))
    columns = (*problem.regressor_columns, problem.equation.response)
    gains = np.array([column.gain for column in columns])
    root = np.empty((0, len(columns)))
    for start, stop in blocks(problem.first, problem.signals.sample_count, 4 * BLOCK_ROWS):
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


def blocks(first: int, count: int, size: int = BLOCK_ROWS) -> Iterator[tuple[int, int]]:
    """Ranges of samples from `first` to `count`."""
    for start in range(first, count, size):
        yield start, min(start + size, count)


def _slice(problem: SignalRegression, column: Column, start: int, stop: int) -> Float[np.ndarray, " rows"]:
    """Rows of a column without its constant gain: a view, unless it is multiplied or masked."""
    values = problem.slice_of(column, start, stop)
    if problem.used is not None:
        values = values[problem.used[start - problem.first : stop - problem.first]]
    return values
