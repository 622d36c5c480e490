"""From a solution to the products that its diagnostics are computed from, in one pass over the rows.

Rows in time are multiplied block by block. Of a signal regression with successive lags as instruments no
array of lags is made: the products are folded (see `lagged_products`), and those of the instruments among
themselves follow from one row of them and the samples at both ends of each block. Rows in frequency are
brought back to time first; by Parseval their products keep their sums.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from eivor.estimation.inferred import Solved
from eivor.estimation.lagged_products import FOLD, folded_products, unfolded
from eivor.estimation.products import successive_lags
from eivor.inference.constancy import GROUPS
from eivor.inference.time_products import TimeProducts, block_edges, products_of_columns, time_products
from eivor.models.column import Column
from eivor.models.signal_regression import SignalRegression
from eivor.models.spectral import BinRows

#: Blocks of time, unless there are many instruments; for each of those there are so many.
BLOCKS = 128
BLOCKS_PER_INSTRUMENT = 6
#: Blocks that a thread multiplies before it hands them in.
STRETCH_BLOCKS = 16
#: Shared noise below this share of a product is its rounding.
ROUNDING = 1e-9
#: Records of fewer samples are not worth folding.
FOLDED_FROM = 50_000


@dataclass(frozen=True)
class RecordProducts:
    """A record as its diagnostics see it.

    Parameters
    ----------
    products : TimeProducts
        With the method's test functions psi as instruments; the sensitivity is that of its equations.
    weights : ndarray, shape (p, n)
        W A, the combinations of the equations that the estimate solves.
    residual : ndarray, shape (samples,)
        e in time order.
    columns : tuple of ndarray, shapes (samples,)
        Regressors in time order; views where that can be, without their gains.
    factors : tuple of float
        Parameters, times those gains.
    step_s : float or None
        Time between samples [s]; None when it is not known.
    thinning : int or None
        For rows in frequency: every so many samples of the residual fill its band. In time it is smooth,
        however white in the band.
    """

    products: TimeProducts
    weights: Float[np.ndarray, "p n"]
    residual: Float[np.ndarray, " samples"]
    columns: tuple[Float[np.ndarray, " samples"], ...]
    factors: tuple[float, ...]
    step_s: float | None
    thinning: int | None = None

    @property
    def score_sums(self) -> Float[np.ndarray, "K n"]:
        """Sums of the estimating equation's scores over each block."""
        return self.products.equation_sums @ self.weights

    @property
    def sensitivities(self) -> Float[np.ndarray, "K n n"]:
        """Minus their derivatives by the joint vector."""
        products = self.products
        return self.weights.T @ (products.cross - products.counts[:, None, None] * products.shared)


def record_products(solved: Solved) -> RecordProducts:
    """Products of a solution's record. Linear in the rows."""
    problem = solved.problem
    plain = isinstance(problem, SignalRegression) and solved.method.assembler.moment_equations
    if plain and isinstance(problem, SignalRegression) and _folds(problem, solved):
        return _of_lags(problem, solved)
    return _of_rows(solved)


def _of_rows(solved: Solved) -> RecordProducts:
    """Any problem, from its rows in arrays."""
    rows, theta = solved.problem.rows(), solved.solution.theta
    residual = rows.response - rows.regressors @ theta
    jacobian = rows.regressors
    if solved.nuisance_columns.size:
        jacobian = np.column_stack([jacobian, solved.nuisance_columns])
    if solved.method.assembler.moment_equations:
        psi = solved.method.assembler.test_functions(rows)
    else:
        correction = solved.method.solver.score_correction(residual, theta, solved.system.error_covariance)
        psi = jacobian + np.pad(correction.rows, ((0, 0), (0, jacobian.shape[1] - theta.size)))
    step_s, thinning = None, None
    if isinstance(rows.layout, BinRows):
        columns = rows.layout.series(np.column_stack([psi, jacobian, residual])) / np.sqrt(2.0)
        psi, jacobian, residual = columns[:, : psi.shape[1]], columns[:, psi.shape[1] : -1], columns[:, -1]
        step_s = rows.layout.runs[0].step_s
        thinning = max(int(0.5 / (step_s * max(run.band_hz[1] for run in rows.layout.runs))), 1)
    elif isinstance(solved.problem, SignalRegression):
        step_s = solved.problem.signals.step_s
    residual = np.ascontiguousarray(residual)
    products = time_products(
        instruments=psi,
        jacobian=jacobian,
        residual=residual,
        blocks=_block_count(residual.size, psi.shape[1]),
    )
    whole, weights = _assembled(solved, products)
    columns = tuple(jacobian[:, j] for j in range(theta.size))
    return RecordProducts(whole, weights, residual, columns, tuple(theta.tolist()), step_s, thinning)


def _assembled(solved: Solved, products: TimeProducts) -> tuple[TimeProducts, Float[np.ndarray, "p n"]]:
    """With what the compensation, or a direct method's correction, adds to the products; and W A."""
    total = np.asarray(products.cross.sum(axis=0))
    if solved.method.assembler.moment_equations:
        # the equations are means over rows; of rows in frequency there are not as many as samples
        rows = solved.count / products.count
        A = total / solved.count
        linear = solved.system.matrix.shape[1]
        noise = A[:, :linear] - solved.system.matrix
        shared = np.zeros(A.shape)
        shared[:, :linear] = rows * np.where(np.abs(noise) > ROUNDING * np.abs(A[:, :linear]), noise, 0.0)
        A[:, :linear] = solved.system.matrix
        WA = A if solved.factor is None else scipy.linalg.cho_solve((solved.factor, True), A)
        constant = rows * solved.method.assembler.score_constants(solved.problem, solved.solution.theta)
    else:
        shared = (total - solved.inference.equation.sensitivity) / products.count
        WA, constant = np.eye(total.shape[0]), np.zeros(total.shape[0])
    return replace(products, shared=shared, constant=constant), WA


def _block_count(rows: int, instruments: int) -> int:
    """A multiple of the groups of the constancy test when there are rows enough."""
    wanted = GROUPS * -(-max(BLOCKS, BLOCKS_PER_INSTRUMENT * instruments) // GROUPS)
    return min(wanted, GROUPS * (rows // GROUPS)) if rows >= GROUPS else rows


# -- lags of one channel --------------------------------------------------------------------------------


def _folds(problem: SignalRegression, solved: Solved) -> bool:
    psi = problem.instrument_columns if solved.method.assembler.needs_instruments else ()
    return (
        problem.used is None
        and successive_lags(psi) is not None
        and problem.signals.sample_count - problem.first >= FOLDED_FROM
    )


def _of_lags(problem: SignalRegression, solved: Solved) -> RecordProducts:
    """Products with successive lags of one channel, folded; the last few rows are added to the last block."""
    first, last = problem.first, problem.signals.sample_count
    theta, psi = solved.solution.theta, problem.instrument_columns
    columns = problem.regressor_columns
    values = [problem.slice_of(column, first, last) for column in columns]
    factors = [float(parameter) * column.gain for parameter, column in zip(theta, columns, strict=True)]
    response = problem.equation.response
    residual = response.gain * problem.slice_of(response, first, last)
    for factor, series in zip(factors, values, strict=True):
        residual = _less(residual, factor, series)
    gains = np.array([column.gain for column in columns] + [1.0])
    others = [np.ascontiguousarray(series) for series in (*values, residual)]
    whole = (last - first) // FOLD
    edges = first + FOLD * block_edges(whole, _block_count(whole, len(psi)))
    # a regressor that is one of the lags has its products among theirs
    place = [_place(column, psi) for column in columns] + [None]
    series = problem.signals.channel(psi[0].channel)
    strangers = [other for other, found in zip(others, place, strict=True) if found is None]
    own, rest = _lag_products(series, psi[0].lag, psi[-1].lag, strangers, edges, last)
    remaining = iter(np.moveaxis(rest, 2, 0))
    cross = np.stack([next(remaining) if at is None else own[:, :, at] for at in place], axis=2)
    edges[-1] = last
    squares = _squares(others, edges - first) * np.outer(gains, gains)
    cross = psi[0].gain * cross * gains
    products = np.block([[psi[0].gain ** 2 * own, cross], [cross.transpose(0, 2, 1), squares]])
    found = products_of_columns(np.diff(edges), products, len(psi))
    step_s = problem.signals.step_s
    return RecordProducts(*_assembled(solved, found), residual, tuple(values), tuple(factors), step_s)


def _place(column: Column, lags: Sequence[Column]) -> int | None:
    """Which of successive lags of one channel a column is, but for its gain."""
    alike = column.channel == lags[0].channel and not column.gain_channel
    return column.lag - lags[0].lag if alike and lags[0].lag <= column.lag <= lags[-1].lag else None


def _less(
    residual: Float[np.ndarray, " rows"], factor: float, series: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Residual - factor x series, in place, while blocks of both are in the cache."""
    size = 32_768
    product = np.empty(min(size, residual.size))
    for start in range(0, residual.size, size):
        here = slice(start, start + size)
        part = product[: residual[here].size]
        np.multiply(series[here], factor, out=part)
        residual[here] -= part
    return residual


def _lag_products(
    series: Float[np.ndarray, " samples"],
    least: int,
    most: int,
    others: Sequence[Float[np.ndarray, " rows"]],
    edges: Int[np.ndarray, " K_plus_1"],
    last: int,
) -> tuple[Float[np.ndarray, "K p p"], Float[np.ndarray, "K p m"]]:
    """Sums over each block of u_k-i u_k-j, and of u_k-i w_k for each other series w.

    Parameters
    ----------
    series : ndarray, shape (samples,)
        u.
    least, most : int
        Lags i, successive.
    others : sequence of ndarray
        Each w, from sample ``edges[0]`` on.
    edges : ndarray of int, shape (K + 1,)
        First sample of each block, and the end, by steps of `FOLD`.
    last : int
        End of the record; rows between the last edge and it belong to the last block.
    """
    first = int(edges[0])
    lagged = np.ascontiguousarray(series[first - least : last - least])
    with_lagged = [lagged, *others]
    K, p = edges.size - 1, most - least + 1

    def of_blocks(start: int) -> Float[np.ndarray, "blocks p m_plus_1"]:
        some = pairwise(edges[start : start + STRETCH_BLOCKS + 1].tolist())
        folded = (folded_products(series, (least, most), with_lagged, [block], first) for block in some)
        return np.stack([unfolded(G) for G in folded])

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # every block by itself: threads change no sum
        sums = np.concatenate(list(pool.map(of_blocks, range(0, K, STRETCH_BLOCKS))))
    for sample in range(int(edges[-1]), last):
        now = series[sample - np.arange(least, most + 1)]
        sums[-1] += np.outer(now, [other[sample - first] for other in with_lagged])
    own = np.empty((K, p, p))
    own[:, :, 0] = own[:, 0, :] = sums[:, :, 0]
    start, stop = edges[:-1], np.append(edges[1:-1], last)
    for i in range(p - 1):
        for j in range(i + 1):
            entering = series[start - 1 - least - i] * series[start - 1 - least - j]
            leaving = series[stop - 1 - least - i] * series[stop - 1 - least - j]
            own[:, i + 1, j + 1] = own[:, j + 1, i + 1] = own[:, i, j] + entering - leaving
    return own, sums[:, :, 1:]


def _squares(
    columns: Sequence[Float[np.ndarray, " rows"]], edges: Int[np.ndarray, " K_plus_1"]
) -> Float[np.ndarray, "K m m"]:
    """Sums over each block of the products of columns among themselves."""
    K, m = edges.size - 1, len(columns)
    sums = np.empty((K, m, m))
    for k in range(K):
        here = slice(int(edges[k]), int(edges[k + 1]))
        parts = [column[here] for column in columns]
        for i in range(m):
            for j in range(i + 1):
                sums[k, i, j] = sums[k, j, i] = parts[i] @ parts[j]
    return sums
