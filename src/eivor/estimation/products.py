"""Sums over rows in blocks: cross-products and roots, without a matrix of lags.

The columns of a `SignalRegression` are slices of its channels, so the product of an instrument and a
regressor is a dot product of two slices; all pairs of a block are taken while it is in the cache. For
rows in arrays it is a matrix product, block by block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from eivor.errors import NonFiniteError, TooFewSamplesError
from eivor.linalg.triangular import merged_roots, triangular_root
from eivor.models.column import Column
from eivor.models.regression import LinearProblem, Regression
from eivor.models.signal_regression import SignalRegression

#: Rows in a block: a few columns of it fit in a second-level cache.
BLOCK_ROWS = 16_384

Products = tuple[int, Float[np.ndarray, "p n_plus_1"], Float[np.ndarray, "p p"] | None]


def mean_cross_products(problem: LinearProblem, *, instruments: bool, own: bool) -> Products:
    """Number of rows, mean(psi [phi' y]), and with `own` mean(psi psi').

    Parameters
    ----------
    problem : LinearProblem
        Rows.
    instruments : bool
        False takes the regressors themselves as psi.
    own : bool
        Also average the instruments' products with each other.

    Raises
    ------
    NonFiniteError
        When a product is not finite.
    """
    if isinstance(problem, SignalRegression) and problem.used is None:
        found = _of_signals(problem, instruments=instruments, own=own)
    else:
        found = _of_arrays(problem.rows(), instruments=instruments, own=own)
    if not np.isfinite(found[1]).all():
        raise NonFiniteError(
            "finite cross-products", "NaN or infinity", "Check the channels for overflow or missing values."
        )
    return found


def _of_arrays(rows: Regression, *, instruments: bool, own: bool) -> Products:
    Psi = rows.instruments if instruments else rows.regressors
    count = rows.response.size
    products = np.zeros((Psi.shape[1], rows.regressors.shape[1] + 1))
    squares = np.zeros((Psi.shape[1], Psi.shape[1])) if own else None
    for first in range(0, count, BLOCK_ROWS):
        here = slice(first, first + BLOCK_ROWS)
        products[:, :-1] += Psi[here].T @ rows.regressors[here]
        products[:, -1] += Psi[here].T @ rows.response[here]
        if squares is not None:
            squares += Psi[here].T @ Psi[here]
    return count, products / count, None if squares is None else squares / count


def _of_signals(problem: SignalRegression, *, instruments: bool, own: bool) -> Products:
    right = (*problem.regressor_columns, problem.equation.response)
    left = problem.instrument_columns if instruments else problem.regressor_columns
    count = row_count(problem)
    products = np.zeros((len(left), len(right)))
    squares = np.zeros((len(left), len(left))) if own else None
    for start, stop in blocks(problem.first, problem.signals.sample_count):
        psi = [_slice(problem, column, start, stop) for column in left]
        phi = [_slice(problem, column, start, stop) for column in right]
        for i, one in enumerate(psi):
            for j, other in enumerate(phi):
                products[i, j] += np.dot(one, other)
        if squares is not None:
            for i, one in enumerate(psi):
                for j in range(i + 1):
                    squares[i, j] += np.dot(one, psi[j])
    gains = (np.array([c.gain for c in left]), np.array([c.gain for c in right]))
    products *= np.outer(*gains) / count
    if squares is not None:
        squares = (squares + np.tril(squares, -1).T) * np.outer(gains[0], gains[0]) / count
    return count, products, squares


def root_of_rows(problem: LinearProblem) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [Phi y]."""
    if not (isinstance(problem, SignalRegression) and problem.used is None):
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
    """Rows of a problem whose samples are all valid.

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
    return count


def blocks(first: int, count: int, size: int = BLOCK_ROWS) -> Iterator[tuple[int, int]]:
    """Ranges of samples from `first` to `count`."""
    for start in range(first, count, size):
        yield start, min(start + size, count)


def _slice(problem: SignalRegression, column: Column, start: int, stop: int) -> Float[np.ndarray, " rows"]:
    """Samples of a column without its constant gain: a view, unless a gain channel multiplies it."""
    signals = problem.signals
    if not column.channel:
        values = np.ones(stop - start)
    else:
        values = signals.channel(column.channel)[start - column.lag : stop - column.lag]
    if column.gain_channel:
        values = values * signals.channel(column.gain_channel)[start:stop]
    return values
