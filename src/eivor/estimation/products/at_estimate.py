"""From a solution to the products that its diagnostics are computed from.

Those of a long signal regression were made block by block with its moments, see `long_records`; other
rows are multiplied here. Rows in frequency are brought back to time first; by Parseval their products keep
their sums.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.linalg

from eivor.estimation.inferred import equation_of
from eivor.estimation.products.long_records import block_count
from eivor.estimation.solved import Solved
from eivor.inference.diagnostics.equation_products import EquationProducts, equation_products
from eivor.inference.products import Products
from eivor.linalg.row_blocks import MULTIPLIED_ROWS, row_blocks
from eivor.models.signal_regression import SignalRegression
from eivor.models.spectral import BinRows
from eivor.shapes import Float

#: Shared noise below this share of a product is its rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Record:
    """A record as its diagnostics see it.

    Parameters
    ----------
    products : EquationProducts
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

    products: EquationProducts
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


def record_of(solved: Solved) -> Record:
    """Products of a solution's record. Linear in the rows."""
    problem = solved.problem
    made = solved.products
    if made is not None and made.counts.size > 1 and isinstance(problem, SignalRegression):
        return _of_blocks(problem, solved, made)
    return _of_rows(solved)


def _of_rows(solved: Solved) -> Record:
    """Any problem, from its rows in arrays."""
    rows, theta = solved.rows, solved.solution.theta
    residual = rows.response - rows.regressors @ theta
    jacobian = rows.regressors
    if solved.nuisance_columns.size:
        jacobian = np.column_stack([jacobian, solved.nuisance_columns])
    if solved.assembler.moment_equations:
        psi = solved.assembler.test_functions(rows)
    else:
        correction = solved.solver.score_correction(residual, theta, solved.system.error_covariance)
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
    products = equation_products(
        instruments=psi,
        jacobian=jacobian,
        residual=residual,
        blocks=block_count(residual.size, psi.shape[1]),
    )
    whole, weights = _assembled(solved, products)
    columns = tuple(jacobian[:, j] for j in range(theta.size))
    return Record(whole, weights, residual, columns, tuple(theta.tolist()), step_s, thinning)


def _assembled(
    solved: Solved, products: EquationProducts
) -> tuple[EquationProducts, Float[np.ndarray, "p n"]]:
    """With what the compensation, or a direct method's correction, adds to the products; and W A."""
    total = np.asarray(products.cross.sum(axis=0))
    if solved.assembler.moment_equations:
        # the equations are means over rows; of rows in frequency there are not as many as samples
        rows = solved.count / products.count
        A = total / solved.count
        linear = solved.system.matrix.shape[1]
        noise = A[:, :linear] - solved.system.matrix
        shared = np.zeros(A.shape)
        shared[:, :linear] = rows * np.where(np.abs(noise) > ROUNDING * np.abs(A[:, :linear]), noise, 0.0)
        A[:, :linear] = solved.system.matrix
        WA = A if solved.factor is None else scipy.linalg.cho_solve((solved.factor, True), A)
        constant = rows * solved.constant
    else:
        known = solved.prior_rows()
        sensitivity = equation_of(solved).sensitivity - solved.residual_variance() * known.T @ known
        shared = (total - sensitivity) / products.count
        WA, constant = np.eye(total.shape[0]), np.zeros(total.shape[0])
    return replace(products, shared=shared, constant=constant, rows=solved.count), WA


# -- a record whose products were made with its moments ---------------------------------------------------


def _of_blocks(problem: SignalRegression, solved: Solved, made: Products) -> Record:
    """Products with the residual y - Phi theta in place of y, from those with y."""
    first, last = problem.first, problem.signals.sample_count
    theta, columns = solved.solution.theta, problem.regressor_columns
    values = [problem.slice_of(column, first, last) for column in columns]
    factors = [float(parameter) * column.gain for parameter, column in zip(theta, columns, strict=True)]
    response = problem.equation.response
    residual = response.gain * problem.slice_of(response, first, last)
    for factor, series in zip(factors, values, strict=True):
        residual = _less(residual, factor, series)
    products = made.with_residual(theta)
    # The power of the residual is no difference of large numbers.
    edges = np.concatenate([[0], np.cumsum(made.counts).astype(np.int64)])
    products.sums[:, -1, -1] = [residual[a:b] @ residual[a:b] for a, b in pairwise(edges.tolist())]
    found = EquationProducts(products, np.zeros((0, 0)), np.zeros(0))
    step_s = problem.signals.step_s
    return Record(*_assembled(solved, found), residual, tuple(values), tuple(factors), step_s)


def _less(
    residual: Float[np.ndarray, " rows"], factor: float, series: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Residual - factor x series, in place, while blocks of both are in the cache."""
    product = np.empty(min(MULTIPLIED_ROWS, residual.size))
    for start, stop in row_blocks(0, residual.size, MULTIPLIED_ROWS):
        here, part = slice(start, stop), product[: stop - start]
        np.multiply(series[here], factor, out=part)
        residual[here] -= part
    return residual
