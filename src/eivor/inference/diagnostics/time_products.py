"""Cross-products of a record, block by block in time: what the diagnostics are computed from.

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
from jaxtyping import Float

#: Directions of the unit-length instruments with smaller singular values are noise and are dropped.
SMALLEST_DIRECTION = 1e-4


@dataclass(frozen=True)
class TimeProducts:
    """Sums of products over successive blocks of K.

    Parameters
    ----------
    counts : ndarray, shape (K,)
        Samples in each block.
    instruments : ndarray, shape (K, p, p)
        psi psi'.
    cross : ndarray, shape (K, p, n)
        psi G'.
    residual : ndarray, shape (K, p)
        psi e.
    regressors : ndarray, shape (K, n, n)
        G G'.
    regressor_residual : ndarray, shape (K, n)
        G e.
    power : ndarray, shape (K,)
        e^2.
    shared : ndarray, shape (p, n)
        C: what the measurement noises add to psi G' in a sample on average; zero unless compensated.
    constant : ndarray, shape (p,)
        C theta - c.
    """

    counts: Float[np.ndarray, " K"]
    instruments: Float[np.ndarray, "K p p"]
    cross: Float[np.ndarray, "K p n"]
    residual: Float[np.ndarray, "K p"]
    regressors: Float[np.ndarray, "K n n"]
    regressor_residual: Float[np.ndarray, "K n"]
    power: Float[np.ndarray, " K"]
    shared: Float[np.ndarray, "p n"]
    constant: Float[np.ndarray, " p"]

    @cached_property
    def count(self) -> int:
        """Samples in all blocks, N."""
        return round(float(self.counts.sum()))

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


def time_products(
    *,
    instruments: Float[np.ndarray, "rows p"],
    jacobian: Float[np.ndarray, "rows n"],
    residual: Float[np.ndarray, " rows"],
    blocks: int,
    shared: Float[np.ndarray, "p n"] | None = None,
    constant: Float[np.ndarray, " p"] | None = None,
) -> TimeProducts:
    """Moments of rows that are samples in time order. Performs no checks.

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
    edges = block_edges(rows, blocks)
    products = np.empty((blocks, p + n + 1, p + n + 1))
    for k in range(blocks):
        here = slice(edges[k], edges[k + 1])
        block = np.column_stack([instruments[here], jacobian[here], residual[here]])
        products[k] = block.T @ block
    return products_of_columns(np.diff(edges), products, p, shared, constant)


def products_of_columns(
    counts: Float[np.ndarray, " K"] | np.ndarray,
    products: Float[np.ndarray, "K m m"],
    instruments: int,
    shared: Float[np.ndarray, "p n"] | None = None,
    constant: Float[np.ndarray, " p"] | None = None,
) -> TimeProducts:
    """Moments from the products of all columns, the instruments first and the residual last."""
    p, n = instruments, products.shape[1] - instruments - 1
    return TimeProducts(
        np.asarray(counts, dtype=np.float64),
        products[:, :p, :p],
        products[:, :p, p : p + n],
        products[:, :p, -1],
        products[:, p : p + n, p : p + n],
        products[:, p : p + n, -1],
        products[:, -1, -1],
        np.zeros((p, n)) if shared is None else shared,
        np.zeros(p) if constant is None else constant,
    )


def block_edges(rows: int, blocks: int) -> np.ndarray:
    """First row of each of `blocks` blocks that differ by one row at most, and the end."""
    return (np.arange(blocks + 1) * rows) // blocks
