"""The products of a record at an estimate, as its diagnostics read them.

Sums over a hundred blocks or so are small, and yet they hold what autocorrelation, a change of the
parameters or a single stretch does to an estimate. Every score of a diagnostic is a combination of the
products below, so that one pass over the rows serves them all and no array of rows x instruments is made.

Notation: psi (p,) instruments, G (n,) Jacobian of the model part, e residual; equations
mean(psi e) + C theta - c = 0 and their sensitivity A = mean(psi G') - C.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.inference.diagnostics.instrument_tests import SMALLEST_DIRECTION
from eivor.inference.products import Products, block_edges, products_of_rows
from eivor.shapes import Float


@dataclass(frozen=True)
class EquationProducts:
    """Products of [psi G e] over K successive blocks of time, and what compensation adds.

    Parameters
    ----------
    products : Products
        Of all columns, the residual in the response's place.
    shared : ndarray, shape (p, n)
        C: what the measurement noises add to psi G' in a sample on average; zero unless compensated.
    constant : ndarray, shape (p,)
        C theta - c.
    rows : float, optional
        Rows that the sums are of. Default: as many as samples. Those in frequency are fewer, as a band holds
        fewer numbers than the time it is of.
    """

    products: Products
    shared: Float[np.ndarray, "p n"]
    constant: Float[np.ndarray, " p"]
    rows: float | None = None

    @property
    def counts(self) -> Float[np.ndarray, " K"]:
        """Samples in each block."""
        return self.products.counts

    @property
    def instruments(self) -> Float[np.ndarray, "K p p"]:
        """Psi psi'."""
        return self.products.instruments

    @property
    def cross(self) -> Float[np.ndarray, "K p n"]:
        """Psi G'."""
        return self.products.cross

    @property
    def residual(self) -> Float[np.ndarray, "K p"]:
        """Psi e."""
        return self.products.instrument_response

    @property
    def regressors(self) -> Float[np.ndarray, "K n n"]:
        """G G'."""
        return self.products.regressors

    @property
    def regressor_residual(self) -> Float[np.ndarray, "K n"]:
        """G e."""
        return self.products.regressor_response

    @property
    def power(self) -> Float[np.ndarray, " K"]:
        """e^2."""
        return self.products.power

    @cached_property
    def count(self) -> float:
        """Samples in all blocks, N."""
        return self.products.count

    @property
    def row_count(self) -> float:
        """Rows, which degrees of freedom are counted in."""
        return self.count if self.rows is None else self.rows

    @cached_property
    def instrument_mean(self) -> Float[np.ndarray, "p p"]:
        """mean(psi psi')."""
        return np.asarray(self.instruments.sum(axis=0)) / self.count

    @cached_property
    def sensitivity(self) -> Float[np.ndarray, "p n"]:
        """A = mean(psi G') - C."""
        return np.asarray(self.cross.sum(axis=0)) / self.count - self.shared

    @cached_property
    def regressor_mean(self) -> Float[np.ndarray, "n n"]:
        """mean(G G')."""
        return np.asarray(self.regressors.sum(axis=0)) / self.count

    @cached_property
    def equations(self) -> Float[np.ndarray, " p"]:
        """mean(psi e) + C theta - c."""
        return np.asarray(self.residual.sum(axis=0)) / self.count + self.constant

    @cached_property
    def equation_sums(self) -> Float[np.ndarray, "K p"]:
        """Sums of the equations' scores psi e + C theta - c over each block."""
        return self.residual + self.counts[:, None] * self.constant

    @cached_property
    def whitening(self) -> Float[np.ndarray, "p q"]:
        """T with T' mean(psi psi') T = 1, without the directions in which the instruments hardly move."""
        Q = self.instrument_mean
        lengths = np.sqrt(np.diag(Q))
        scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
        values, vectors = np.linalg.eigh(np.outer(scale, scale) * Q)
        kept = values > SMALLEST_DIRECTION**2
        return scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])


def equation_products(
    *,
    instruments: Float[np.ndarray, "rows p"],
    jacobian: Float[np.ndarray, "rows n"],
    residual: Float[np.ndarray, " rows"],
    blocks: int,
    shared: Float[np.ndarray, "p n"] | None = None,
    constant: Float[np.ndarray, " p"] | None = None,
) -> EquationProducts:
    """Products of rows that are samples in time order. Performs no checks.

    Parameters
    ----------
    instruments, jacobian, residual : ndarray, shapes (rows, p), (rows, n) and (rows,)
        psi, G and e.
    blocks : int
        K, at most the number of rows.
    shared, constant : ndarray, shapes (p, n) and (p,), optional
        C and C theta - c of compensated equations. Default: zero.

    Notes
    -----
    One matrix product for each block, O(rows (p + n)^2).
    """
    rows, p = instruments.shape
    n = jacobian.shape[1]
    return EquationProducts(
        products_of_rows(instruments, jacobian, residual, edges=block_edges(rows, blocks)),
        np.zeros((p, n)) if shared is None else shared,
        np.zeros(p) if constant is None else constant,
    )
