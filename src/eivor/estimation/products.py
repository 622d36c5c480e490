"""Products of rows and instruments of a problem, in blocks and for long records."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeGuard

import numpy as np
from numpy.lib.stride_tricks import as_strided

from eivor.errors import InstrumentError, NonFiniteError, TooFewSamplesError
from eivor.inference.diagnostics.residuals import GROUPS
from eivor.inference.products import ProductLayout, Products, block_edges, products_of_rows
from eivor.linalg.system import MULTIPLIED_ROWS, merged_roots, row_blocks, triangular_root
from eivor.models.regression import Column, LinearProblem, Regression, RowBlock
from eivor.models.signal_regression import SignalRegression
from eivor.tools import Float, Int

# -- Folded lags --

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
    """G of each other series, summed over the blocks."""
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
    equal = len({(c.channel, c.gain, c.gain_channel) for c in columns}) == 1
    if len(lags) < 2 or not equal or not columns[0].channel or columns[0].gain_channel:
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
    """Rows from sample `start` to `stop`, with combinations of successive lags in the instruments' place."""
    lags = problem.instrument_columns
    reached = problem.signals.channel(lags[0].channel)[start - lags[-1].lag : stop - lags[0].lag]
    taps = lags[0].gain * combinations[::-1].T
    psi = np.empty((len(taps), stop - start))
    for row, tap in zip(psi, taps, strict=True):
        _filter(reached, tap, row)
    response = problem.columns_between([problem.equation.response], start, stop)[:, 0]
    regressors = problem.columns_between(problem.regressor_columns, start, stop)
    return RowBlock(response, regressors, psi.T, np.zeros(stop - start, dtype=np.int64))


def _filter(
    series: Float[np.ndarray, " reached"], taps: Float[np.ndarray, " p"], filtered: Float[np.ndarray, " rows"]
) -> None:
    """Fill in the sums of as many successive samples as there are taps, weighted by them."""
    filtered[:] = 0.0
    for index in range(0, taps.size, FAST_TAPS):
        some = taps[index : index + FAST_TAPS]
        filtered += np.correlate(series[index : index + filtered.size - 1 + some.size], some, "valid")


# -- Long records --

#: Blocks of time, unless there are many instruments; for each of those there are so many.
BLOCKS = 128
BLOCKS_PER_INSTRUMENT = 6
#: So many rows of a record are worth threads.
THREADED_FROM_ROWS = 8_000_000
#: Shorter records are multiplied faster as a whole, and their diagnostics from rows.
FOLDED_FROM = 250_000


def block_count(rows: int, instruments: int) -> int:
    """A multiple of the groups of the constancy test when there are rows enough."""
    wanted = GROUPS * -(-max(BLOCKS, BLOCKS_PER_INSTRUMENT * instruments) // GROUPS)
    return min(wanted, GROUPS * (rows // GROUPS)) if rows >= GROUPS else rows


def products_of_long_record(problem: SignalRegression) -> Products | None:
    """Products of a long record whose instruments are successive lags of one channel, else None."""
    psi = problem.instrument_columns
    first, last = problem.first, problem.signals.sample_count
    if problem.used is not None or last - first < FOLDED_FROM or successive_lags(psi) is None:
        return None
    columns = (*problem.regressor_columns, problem.equation.response)
    values = [np.ascontiguousarray(problem.slice_of(column, first, last)) for column in columns]
    whole = (last - first) // FOLD
    edges = first + FOLD * block_edges(whole, block_count(whole, len(psi)))
    # A column that is one of the lags has its products among theirs.
    positions = [_position(column, psi) for column in columns]
    strangers = [series for series, position in zip(values, positions, strict=True) if position is None]
    lagged = _lag_products(problem.signals.channel(psi[0].channel), psi, strangers, edges, last)
    current, rest = lagged[:, :, : len(psi)], lagged[:, :, len(psi) :]
    remaining = iter(np.moveaxis(rest, 2, 0))
    cross = np.stack(
        [next(remaining) if position is None else current[:, :, position] for position in positions], axis=2
    )
    edges[-1] = last
    squares = _squares(values, positions, cross, edges - first)
    gains = np.array([psi[0].gain] * len(psi) + [column.gain for column in columns])
    sums = np.block([[current, cross], [cross.transpose(0, 2, 1), squares]]) * np.outer(gains, gains)
    layout = ProductLayout(len(psi), len(columns) - 1, whole=True)
    return Products(np.diff(edges).astype(np.float64), sums, layout)


def _position(column: Column, lags: Sequence[Column]) -> int | None:
    """Which of successive lags of one channel a column is, but for its gain."""
    equal = column.channel == lags[0].channel and not column.gain_channel
    return column.lag - lags[0].lag if equal and lags[0].lag <= column.lag <= lags[-1].lag else None


def _lag_products(
    series: Float[np.ndarray, " samples"],
    psi: Sequence[Column],
    others: Sequence[Float[np.ndarray, " rows"]],
    edges: Int[np.ndarray, " K_plus_1"],
    last: int,
) -> Float[np.ndarray, "K p p_plus_others"]:
    """Sums over each block of u_k-i u_k-j, and of u_k-i w_k for each other series w."""
    first, least, most = int(edges[0]), psi[0].lag, psi[-1].lag
    with_lagged = [np.ascontiguousarray(series[first - least : last - least]), *others]

    def folded(block: tuple[int, int]) -> Float[np.ndarray, "others width fold"]:
        parts = list(row_blocks(*block, MULTIPLIED_ROWS))
        return folded_products(series, (least, most), with_lagged, parts, first)

    blocks = list(pairwise(edges.tolist()))
    if last - first < THREADED_FROM_ROWS:
        G = [folded(block) for block in blocks]
    else:  # every block by itself: threads change no sum
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            G = list(pool.map(folded, blocks))
    sums = unfolded(np.stack(G))
    for sample in range(int(edges[-1]), last):
        now = series[sample - np.arange(least, most + 1)]
        sums[-1] += np.outer(now, [other[sample - first] for other in with_lagged])
    # The sum at lags (i + 1, j + 1) is that at (i, j) but for the samples at both ends of the block.
    p = most - least + 1
    current = np.empty((len(blocks), p, p))
    current[:, :, 0] = current[:, 0, :] = sums[:, :, 0]
    start, stop = edges[:-1], np.append(edges[1:-1], last)
    entering, leaving = (series[end[:, None] - 1 - least - np.arange(p)] for end in (start, stop))
    for i in range(p - 1):
        done = slice(0, i + 1)
        change = entering[:, [i]] * entering[:, done] - leaving[:, [i]] * leaving[:, done]
        current[:, i + 1, 1 : i + 2] = current[:, 1 : i + 2, i + 1] = current[:, i, done] + change
    return np.concatenate([current, sums[:, :, 1:]], axis=2)


def _squares(
    columns: Sequence[Float[np.ndarray, " rows"]],
    indices: Sequence[int | None],
    cross: Float[np.ndarray, "K p m"],
    edges: Int[np.ndarray, " K_plus_1"],
) -> Float[np.ndarray, "K m m"]:
    """Sums over each block of the products of columns among themselves."""
    m, ends = len(columns), list(pairwise(edges.tolist()))
    sums = np.empty((len(ends), m, m))
    for i in range(m):
        for j in range(i + 1):
            position, other = (indices[i], j) if indices[i] is not None else (indices[j], i)
            if position is not None:
                sums[:, i, j] = cross[:, position, other]
            else:
                sums[:, i, j] = [columns[i][a:b] @ columns[j][a:b] for a, b in ends]
            sums[:, j, i] = sums[:, i, j]
    return sums


# -- Products of signals --

#: Blocks that one thread sums before it hands in, and how many such stretches are worth threads.
STRETCH_BLOCKS = 64
THREADED_FROM_STRETCHES = 4


def products_of_signals(problem: SignalRegression, *, instruments: bool, whole: bool) -> Products:
    """Products of a problem's columns, in one block."""
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
    """Sums of products of columns."""
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
    return np.array([[np.dot(item, other) for other in rights] for item in lefts])


def _added(
    part: Callable[[tuple[int, int]], Float[np.ndarray, "*shape"]], stretches: list[tuple[int, int]]
) -> Float[np.ndarray, "*shape"]:
    """Parts of all stretches, added in their order."""
    total = part(stretches[0])
    if len(stretches) < THREADED_FROM_STRETCHES:
        for stretch in stretches[1:]:
            total = total + part(stretch)
        return total
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for item in pool.map(part, stretches[1:]):
            total = total + item
    return total


def _own_sums(problem: SignalRegression, columns: Sequence[Column]) -> Float[np.ndarray, "p p"]:
    """Sums of products of columns among themselves."""
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
    """Number of rows of a problem."""
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


# -- Products of a problem --


def products_of(problem: LinearProblem, *, instruments: bool = True, whole: bool) -> Products:
    """Products of the columns [psi phi y] of a problem."""
    if instruments and not problem.instrument_count:
        raise InstrumentError(
            "instruments",
            "a problem without any",
            'Name them: regression(signals, ev.lags("input", 0, 10)), or regression(instruments=...).',
        )
    if isinstance(problem, SignalRegression):
        long_record = products_of_long_record(problem) if instruments and whole else None
        made = long_record or products_of_signals(problem, instruments=instruments, whole=whole)
    else:
        made = _of_arrays(problem.rows(), instruments=instruments, whole=whole)
    if not np.isfinite(made.sums).all():
        raise NonFiniteError(
            "finite cross-products", "NaN or infinity", "Check the channels for overflow or missing values."
        )
    return made


def _of_arrays(rows: Regression, *, instruments: bool, whole: bool) -> Products:
    psi = rows.instruments if instruments else rows.regressors
    edges = np.array([0, rows.response.size])
    return products_of_rows(psi, rows.regressors, rows.response, edges=edges, whole=whole)


def root_of_rows(problem: LinearProblem) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [phi y]."""
    if isinstance(problem, SignalRegression):
        return root_of_signals(problem)
    rows = problem.rows()
    return rows.response.size, triangular_root(np.column_stack([rows.regressors, rows.response]))
