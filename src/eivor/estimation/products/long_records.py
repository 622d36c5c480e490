"""Products of all columns of a signal regression over successive blocks of time, in one pass.

Their sum makes the moments of an estimate, and the blocks themselves its diagnostics, so that neither
reads the record for the other. No array of lags is made: instruments that are successive lags of one
channel are folded (see `folded_lags`), and their products among themselves follow from one row of them
and the samples at both ends of each block.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from eivor.estimation.products.folded_lags import FOLD, folded_products, successive_lags, unfolded
from eivor.inference.diagnostics.constancy import GROUPS
from eivor.inference.products import ProductLayout, Products, block_edges
from eivor.linalg.row_blocks import MULTIPLIED_ROWS, row_blocks
from eivor.models.column import Column
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Float, Int

#: Blocks of time, unless there are many instruments; for each of those there are so many.
BLOCKS = 128
BLOCKS_PER_INSTRUMENT = 6
#: So many rows of a record are worth threads.
THREADED_FROM = 8_000_000
#: Shorter records are multiplied faster as a whole, and their diagnostics from rows.
FOLDED_FROM = 250_000


def block_count(rows: int, instruments: int) -> int:
    """A multiple of the groups of the constancy test when there are rows enough."""
    wanted = GROUPS * -(-max(BLOCKS, BLOCKS_PER_INSTRUMENT * instruments) // GROUPS)
    return min(wanted, GROUPS * (rows // GROUPS)) if rows >= GROUPS else rows


def products_of_long_record(problem: SignalRegression) -> Products | None:
    """Products of a long record whose instruments are successive lags of one channel, else None.

    The last few rows, fewer than are folded into one, are added to the last block.
    """
    psi = problem.instrument_columns
    first, last = problem.first, problem.signals.sample_count
    if problem.used is not None or last - first < FOLDED_FROM or successive_lags(psi) is None:
        return None
    columns = (*problem.regressor_columns, problem.equation.response)
    values = [np.ascontiguousarray(problem.slice_of(column, first, last)) for column in columns]
    whole = (last - first) // FOLD
    edges = first + FOLD * block_edges(whole, block_count(whole, len(psi)))
    # A column that is one of the lags has its products among theirs.
    places = [_place(column, psi) for column in columns]
    strangers = [series for series, place in zip(values, places, strict=True) if place is None]
    lagged = _lag_products(problem.signals.channel(psi[0].channel), psi, strangers, edges, last)
    own, rest = lagged[:, :, : len(psi)], lagged[:, :, len(psi) :]
    remaining = iter(np.moveaxis(rest, 2, 0))
    cross = np.stack([next(remaining) if at is None else own[:, :, at] for at in places], axis=2)
    edges[-1] = last
    squares = _squares(values, places, cross, edges - first)
    gains = np.array([psi[0].gain] * len(psi) + [column.gain for column in columns])
    sums = np.block([[own, cross], [cross.transpose(0, 2, 1), squares]]) * np.outer(gains, gains)
    layout = ProductLayout(len(psi), len(columns) - 1, whole=True)
    return Products(np.diff(edges).astype(np.float64), sums, layout)


def _place(column: Column, lags: Sequence[Column]) -> int | None:
    """Which of successive lags of one channel a column is, but for its gain."""
    alike = column.channel == lags[0].channel and not column.gain_channel
    return column.lag - lags[0].lag if alike and lags[0].lag <= column.lag <= lags[-1].lag else None


def _lag_products(
    series: Float[np.ndarray, " samples"],
    psi: Sequence[Column],
    others: Sequence[Float[np.ndarray, " rows"]],
    edges: Int[np.ndarray, " K_plus_1"],
    last: int,
) -> Float[np.ndarray, "K p p_plus_others"]:
    """Sums over each block of u_k-i u_k-j, and of u_k-i w_k for each other series w.

    Parameters
    ----------
    series : ndarray, shape (samples,)
        u.
    psi : sequence of Column
        Its successive lags i.
    others : sequence of ndarray
        Each w, from sample ``edges[0]`` on.
    edges : ndarray of int, shape (K + 1,)
        First sample of each block, and the end, by steps of `FOLD`.
    last : int
        End of the record; rows between the last edge and it belong to the last block.
    """
    first, least, most = int(edges[0]), psi[0].lag, psi[-1].lag
    with_lagged = [np.ascontiguousarray(series[first - least : last - least]), *others]

    def folded(block: tuple[int, int]) -> Float[np.ndarray, "others width fold"]:
        parts = list(row_blocks(*block, MULTIPLIED_ROWS))
        return folded_products(series, (least, most), with_lagged, parts, first)

    blocks = list(pairwise(edges.tolist()))
    if last - first < THREADED_FROM:
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
    own = np.empty((len(blocks), p, p))
    own[:, :, 0] = own[:, 0, :] = sums[:, :, 0]
    start, stop = edges[:-1], np.append(edges[1:-1], last)
    entering, leaving = (series[end[:, None] - 1 - least - np.arange(p)] for end in (start, stop))
    for i in range(p - 1):
        done = slice(0, i + 1)
        change = entering[:, [i]] * entering[:, done] - leaving[:, [i]] * leaving[:, done]
        own[:, i + 1, 1 : i + 2] = own[:, 1 : i + 2, i + 1] = own[:, i, done] + change
    return np.concatenate([own, sums[:, :, 1:]], axis=2)


def _squares(
    columns: Sequence[Float[np.ndarray, " rows"]],
    places: Sequence[int | None],
    cross: Float[np.ndarray, "K p m"],
    edges: Int[np.ndarray, " K_plus_1"],
) -> Float[np.ndarray, "K m m"]:
    """Sums over each block of the products of columns among themselves."""
    m, ends = len(columns), list(pairwise(edges.tolist()))
    sums = np.empty((len(ends), m, m))
    for i in range(m):
        for j in range(i + 1):
            place, other = (places[i], j) if places[i] is not None else (places[j], i)
            if place is not None:
                sums[:, i, j] = cross[:, place, other]
            else:
                sums[:, i, j] = [columns[i][a:b] @ columns[j][a:b] for a, b in ends]
            sums[:, j, i] = sums[:, i, j]
    return sums
