"""Moments of the pieces of a record, from which those of any replicate are added up.

Two kinds, as moments have: sums of cross-products for instrumental and compensated methods; for direct
ones the pieces' Gram matrices *in the coordinates of the record's own triangular root*, Q = [Phi y] R^-1
with Q'Q = I. A replicate's Gram matrix there is near the identity, so that its root times R has the
condition of [Phi y], not the square of it.

What the measurement noises add on average, C and c, belongs to the noise model and not to the rows: it
is the same in every replicate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from eivor.estimation.method import Method
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.estimation.solve import SolvedEquations
from eivor.inference.resampling.blocks import BlockPlan, piece_sums
from eivor.linalg.triangular import triangular_root
from eivor.models.regression import Regression

#: Products of rows that are held at a time.
CHUNK_PRODUCTS = 4_000_000


class BlockMoments(ABC):
    """Sums over pieces, each flattened into a row of `table` whose first number is the count of rows.

    Attributes
    ----------
    table : ndarray, shape (pieces, columns)
        Sums over each piece.
    """

    table: Float[np.ndarray, "pieces columns"]

    @abstractmethod
    def moments(self, sums: Float[np.ndarray, " columns"]) -> Moments:
        """Moments of a replicate, from the sum of its pieces' rows of the table."""

    @abstractmethod
    def influence(
        self, pieces: Float[np.ndarray, "k columns"], solved: SolvedEquations, count: float
    ) -> Float[np.ndarray, "k n"]:
        """What each of some pieces moves the parameters by, to first order: M^-1 times the sum of its scores.

        Parameters
        ----------
        pieces : ndarray, shape (k, columns)
            Rows of the table.
        solved : SolvedEquations
            What the scores are taken at.
        count : float
            Rows of the replicate that was solved.
        """


@dataclass(frozen=True)
class ProductBlocks(BlockMoments):
    """Cross-products of the instruments with [Phi y].

    Parameters
    ----------
    table : ndarray, shape (pieces, columns)
        Counts, sums of psi [phi' y] and, when they are needed, of psi psi'.
    instruments, unknowns : int
        p and n.
    noise : ndarray, shape (p, n + 1), optional
        C and c.
    """

    table: Float[np.ndarray, "pieces columns"]
    instruments: int
    unknowns: int
    noise: Float[np.ndarray, "p n_plus_1"] | None

    def moments(self, sums: Float[np.ndarray, " columns"]) -> CrossMoments:
        """Mean cross-products."""
        p, count = self.instruments, float(sums[0])
        means = sums[1:] / count
        cross = means[: p * (self.unknowns + 1)].reshape(p, -1)
        own = means[cross.size :].reshape(p, p) if means.size > cross.size else None
        return CrossMoments(round(count), cross, self.noise, own)

    def influence(
        self, pieces: Float[np.ndarray, "k columns"], solved: SolvedEquations, count: float
    ) -> Float[np.ndarray, "k n"]:
        """Of A'W (psi e + C theta - c)."""
        p, away = self.instruments, np.append(-solved.solution.theta, 1.0)
        products = pieces[:, 1 : 1 + p * (self.unknowns + 1)].reshape(-1, p, self.unknowns + 1) @ away
        if self.noise is not None:
            products = products - pieces[:, :1] * (self.noise @ away)
        A = solved.system.matrix
        if solved.factor is not None:
            A = scipy.linalg.solve_triangular(solved.factor, A, lower=True)
            products = scipy.linalg.solve_triangular(solved.factor, products.T, lower=True).T
        return over_sensitivity(products @ A, A) / count


@dataclass(frozen=True)
class RootBlocks(BlockMoments):
    """Gram matrices of [Phi y] in the coordinates of its triangular root.

    Parameters
    ----------
    table : ndarray, shape (pieces, 1 + (n + 1)^2)
        Counts, and sums of q q'.
    root : ndarray, shape (n + 1, n + 1)
        R.
    noise : ndarray, shape (n + 1, n + 1), optional
        Covariance of the measurement noises of [Phi y].
    method : Method
        Whose solver corrects the scores.
    """

    table: Float[np.ndarray, "pieces columns"]
    root: Float[np.ndarray, "n_plus_1 n_plus_1"]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None
    method: Method

    def moments(self, sums: Float[np.ndarray, " columns"]) -> TriangularMoments:
        """Root of the replicate: that of its Gram matrix, times R."""
        size = self.root.shape[0]
        powers, directions = np.linalg.eigh(sums[1:].reshape(size, size))
        half = np.sqrt(np.maximum(powers, 0.0))[:, None] * directions.T
        return TriangularMoments(round(float(sums[0])), half @ self.root, self.noise)

    def influence(
        self, pieces: Float[np.ndarray, "k columns"], solved: SolvedEquations, count: float
    ) -> Float[np.ndarray, "k n"]:
        """Of Phi e + c e^2, with the solver's correction."""
        del count  # a root is of the sum already
        size, theta = self.root.shape[0], solved.solution.theta
        A, b = solved.system.matrix, solved.system.right
        away = self.root @ np.append(-theta, 1.0)
        products = pieces[:, 1:].reshape(-1, size, size) @ away
        solver, covariance = self.method.solver, solved.system.error_covariance
        pull = solver.score_correction(np.ones(1), theta, covariance).rows[0]
        scores = products @ self.root[:, :-1] + np.outer(products @ away, pull)
        return over_sensitivity(
            scores, A, solver.score_correction(b - A @ theta, theta, covariance).sensitivity
        )


def over_sensitivity(
    scores: Float[np.ndarray, "k n"],
    A: Float[np.ndarray, "m n"],
    correction: Float[np.ndarray, "n n"] | None = None,
) -> Float[np.ndarray, "k n"]:
    """Rows of scores times (A'A + correction)^-1, without A'A.

    Notes
    -----
    With A = Q R it is R^-1 (I + R^-T correction R^-1)^-1 R^-T. Performs no checks.
    """
    R = triangular_root(A)
    inner = scipy.linalg.solve_triangular(R, scores.T, trans="T")
    if correction is not None and correction.any():
        half = scipy.linalg.solve_triangular(R, correction, trans="T")
        S = scipy.linalg.solve_triangular(R, half.T, trans="T")
        inner = np.linalg.solve(np.eye(R.shape[0]) + S, inner)
    solution: Float[np.ndarray, "k n"] = scipy.linalg.solve_triangular(R, inner).T
    return solution


def block_moments(rows: Regression, method: Method, whole: Moments, plan: BlockPlan) -> BlockMoments:
    """Sums over the pieces of a plan.

    Parameters
    ----------
    rows : Regression
        The rows.
    method : Method
        What they will be estimated by.
    whole : Moments
        Moments of all rows, from the method's assembler.
    plan : BlockPlan
        The pieces.

    Notes
    -----
    One pass over the rows: O(rows p n), and in memory one row of sums for each piece.
    """
    bounds = plan.bounds
    both = np.column_stack([rows.regressors, rows.response])
    counts = np.diff(bounds).astype(np.float64)[:, None]
    if isinstance(whole, TriangularMoments):
        Q = _orthonormal(both, whole.root)
        table = np.column_stack([counts, _atom_products(Q, Q, bounds)])
        return RootBlocks(piece_sums(table, plan), whole.root, whole.noise, method)
    psi = method.assembler.test_functions(rows)
    columns = [counts, _atom_products(psi, both, bounds)]
    if method.weighting.needs_instrument_products:
        columns.append(_atom_products(psi, psi, bounds))
    table = np.column_stack(columns)
    noise = whole.noise if isinstance(whole, CrossMoments) else None
    return ProductBlocks(piece_sums(table, plan), psi.shape[1], rows.regressors.shape[1], noise)


def _orthonormal(
    both: Float[np.ndarray, "rows n_plus_1"], root: Float[np.ndarray, "n_plus_1 n_plus_1"]
) -> Float[np.ndarray, "rows n_plus_1"]:
    """[Phi y] R^-1, with zeros for a direction that no row has (an exact fit)."""
    diagonal = np.diag(root)
    safe = root + np.diag(np.where(diagonal == 0.0, 1.0, 0.0))
    Q: Float[np.ndarray, "rows n_plus_1"] = scipy.linalg.solve_triangular(safe, both.T, trans="T").T
    return Q


def _atom_products(
    left: Float[np.ndarray, "rows p"],
    right: Float[np.ndarray, "rows q"],
    bounds: Int[np.ndarray, " atoms_plus_1"],
) -> Float[np.ndarray, "atoms columns"]:
    """Sums of all products of a left and a right column over each atom, flattened."""
    width = left.shape[1] * right.shape[1]
    atoms = bounds.size - 1
    sums = np.empty((atoms, width))
    step = max(1, int(CHUNK_PRODUCTS * atoms / (width * bounds[-1])))
    for first in range(0, atoms, step):
        last = min(first + step, atoms)
        here = slice(bounds[first], bounds[last])
        products = (left[here, :, None] * right[here, None, :]).reshape(-1, width)
        sums[first:last] = np.add.reduceat(products, bounds[first:last] - bounds[first], axis=0)
    return sums
