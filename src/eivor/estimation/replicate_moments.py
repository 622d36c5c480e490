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
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.estimation.solved import Solved
from eivor.inference.products import Products, products_of_rows
from eivor.inference.resampling.blocks import BlockPlan, piece_sums
from eivor.linalg.system import Solver
from eivor.linalg.triangular import triangular_root
from eivor.models.regression import Regression
from eivor.shapes import Float, Int


class PieceMoments(ABC):
    """Products of pieces of a record, which the moments of any replicate are added up from.

    Attributes
    ----------
    products : Products
        A block for each piece.
    """

    products: Products

    @abstractmethod
    def moments(self, drawn: Int[np.ndarray, " k"]) -> Moments:
        """Moments of a replicate of those pieces."""

    @abstractmethod
    def influence(
        self, pieces: Int[np.ndarray, " k"] | slice, solved: Solved, count: float, /
    ) -> Float[np.ndarray, "k n"]:
        """What each of some pieces moves the parameters by, to first order: M^-1 times the sum of its scores.

        Parameters
        ----------
        pieces : ndarray of int, shape (k,), or slice
            Which.
        solved : Solved
            What the scores are taken at.
        count : float
            Rows of the replicate that was solved.
        """


@dataclass(frozen=True)
class CrossPieces(PieceMoments):
    """Cross-products of the instruments with [Phi y].

    Parameters
    ----------
    products : Products
        Of [psi phi y]; whole when psi psi' is needed.
    noise : ndarray, shape (p, n + 1), optional
        C and c.
    """

    products: Products
    noise: Float[np.ndarray, "p n_plus_1"] | None

    def moments(self, drawn: Int[np.ndarray, " k"]) -> CrossMoments:
        """Mean cross-products."""
        return CrossMoments(self.products.resampled(drawn), self.noise)

    def influence(
        self, pieces: Int[np.ndarray, " k"] | slice, solved: Solved, count: float
    ) -> Float[np.ndarray, "k n"]:
        """Of A'W (psi e + C theta - c)."""
        away = np.append(-solved.solution.theta, 1.0)
        products = self.products.equations[pieces] @ away
        if self.noise is not None:
            products = products - self.products.counts[pieces, None] * (self.noise @ away)
        A = solved.system.matrix
        if solved.factor is not None:
            A = scipy.linalg.solve_triangular(solved.factor, A, lower=True)
            products = scipy.linalg.solve_triangular(solved.factor, products.T, lower=True).T
        return over_sensitivity(products @ A, A) / count


@dataclass(frozen=True)
class RootPieces(PieceMoments):
    """Gram matrices of [Phi y] in the coordinates of its triangular root.

    Parameters
    ----------
    products : Products
        Of Q = [Phi y] R^-1, without instruments.
    root : ndarray, shape (n + 1, n + 1)
        R.
    noise : ndarray, shape (n + 1, n + 1), optional
        Covariance of the measurement noises of [Phi y].
    solver : Solver
        Which corrects the scores.
    """

    products: Products
    root: Float[np.ndarray, "n_plus_1 n_plus_1"]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None
    solver: Solver

    def moments(self, drawn: Int[np.ndarray, " k"]) -> TriangularMoments:
        """Root of the replicate: that of its Gram matrix, times R."""
        replicate = self.products.resampled(drawn)
        powers, directions = np.linalg.eigh(replicate.sums[0])
        half = np.sqrt(np.maximum(powers, 0.0))[:, None] * directions.T
        return TriangularMoments(replicate.count, half @ self.root, self.noise)

    def influence(
        self,
        pieces: Int[np.ndarray, " k"] | slice,
        solved: Solved,
        _count: float,  # a root is of the sum already
        /,
    ) -> Float[np.ndarray, "k n"]:
        """Of Phi e + c e^2, with the solver's correction."""
        theta = solved.solution.theta
        A, b = solved.system.matrix, solved.system.right
        away = self.root @ np.append(-theta, 1.0)
        products = self.products.sums[pieces] @ away
        covariance = solved.system.error_covariance
        pull = self.solver.score_correction(np.ones(1), theta, covariance).rows[0]
        scores = products @ self.root[:, :-1] + np.outer(products @ away, pull)
        return over_sensitivity(
            scores, A, self.solver.score_correction(b - A @ theta, theta, covariance).sensitivity
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


def piece_moments(rows: Regression, method: LinearMethod, whole: Moments, plan: BlockPlan) -> PieceMoments:
    """Products of the pieces of a plan.

    Parameters
    ----------
    rows : Regression
        The rows.
    method : LinearMethod
        What they will be estimated by.
    whole : Moments
        Moments of all rows, from the method's assembler.
    plan : BlockPlan
        The pieces.

    Notes
    -----
    One pass over the rows: O(rows p n), and in memory one block of products for each piece.
    """
    Phi, y = rows.regressors, rows.response
    if isinstance(whole, TriangularMoments):
        Q = _orthonormal(np.column_stack([Phi, y]), whole.root)
        of_atoms = products_of_rows(np.empty((y.size, 0)), Q[:, :-1], Q[:, -1], edges=plan.bounds)
        return RootPieces(_pieces(of_atoms, plan), whole.root, whole.noise, method.solver)
    psi = method.assembler.test_functions(rows)
    own = method.equation_weighting.needs_instrument_products
    of_atoms = products_of_rows(psi, Phi, y, edges=plan.bounds, whole=own)
    noise = whole.noise if isinstance(whole, CrossMoments) else None
    return CrossPieces(_pieces(of_atoms, plan), noise)


def _pieces(atoms: Products, plan: BlockPlan) -> Products:
    """Products of each piece, from those of the atoms that it has."""
    return replace(atoms, counts=piece_sums(atoms.counts, plan), sums=piece_sums(atoms.sums, plan))


def _orthonormal(
    both: Float[np.ndarray, "rows n_plus_1"], root: Float[np.ndarray, "n_plus_1 n_plus_1"]
) -> Float[np.ndarray, "rows n_plus_1"]:
    """[Phi y] R^-1, with zeros for a direction that no row has (an exact fit)."""
    diagonal = np.diag(root)
    safe = root + np.diag(np.where(diagonal == 0.0, 1.0, 0.0))
    Q: Float[np.ndarray, "rows n_plus_1"] = scipy.linalg.solve_triangular(safe, both.T, trans="T").T
    return Q
