"""Moments: the mergeable summary of a problem, all that its assembler needs of it.

Direct methods keep a triangular root of their rows, so that no condition number is squared; instrumental
methods keep mean cross-products, which is how they are defined. Merging is associative and weighted by
the numbers of rows: it gives streaming, pooling, and distributed reduction alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import UsageError
from eivor.estimation.block_products import BlockProducts
from eivor.linalg.triangular import merged_roots


class Moments(ABC):
    """Summary of some rows."""

    @property
    @abstractmethod
    def rows(self) -> int:
        """Number of rows summarised."""

    @abstractmethod
    def merge(self, other: Moments) -> Moments:
        """Summary of both sets of rows.

        Raises
        ------
        UsageError
            When the two are of different kinds or problems.
        """


@dataclass(frozen=True, slots=True)
class TriangularMoments(Moments):
    """Triangular root of the rows [Phi y].

    Parameters
    ----------
    count : int
        Number of rows.
    root : ndarray, shape (k, n + 1), k <= n + 1
        R with R'R = [Phi y]'[Phi y].
    noise : ndarray, shape (n + 1, n + 1), optional
        Mean covariance of the measurement noises of [Phi y].
    """

    count: int
    root: Float[np.ndarray, "k n_plus_1"]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.count

    def merge(self, other: Moments) -> TriangularMoments:
        """Root of the stacked roots."""
        if not isinstance(other, TriangularMoments) or self.root.shape[1] != other.root.shape[1]:
            raise _unlike(self, other)
        noise = None
        if self.noise is not None and other.noise is not None:
            noise = _mean(self.count, self.noise, other.count, other.noise)
        return TriangularMoments(self.count + other.count, merged_roots(self.root, other.root), noise)


@dataclass(frozen=True, slots=True)
class CrossMoments(Moments):
    """Mean cross-products of the instruments with [Phi y].

    Parameters
    ----------
    count : int
        Number of rows.
    products : ndarray, shape (p, n + 1)
        mean(psi [phi' y]).
    noise : ndarray, shape (p, n + 1), optional
        C and c: what the measurement noises add to it on average.
    instruments : ndarray, shape (p, p), optional
        mean(psi psi'), for two-stage weighting.
    regressors : ndarray, shape (n, n), optional
        mean(phi phi'), for the strength of the instruments.
    blocks : BlockProducts, optional
        The sums that they were made of, for diagnostics; they do not merge.
    """

    count: int
    products: Float[np.ndarray, "p n_plus_1"]
    noise: Float[np.ndarray, "p n_plus_1"] | None = None
    instruments: Float[np.ndarray, "p p"] | None = None
    regressors: Float[np.ndarray, "n n"] | None = None
    blocks: BlockProducts | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.count

    def merge(self, other: Moments) -> CrossMoments:
        """Count-weighted means."""
        if not isinstance(other, CrossMoments) or self.products.shape != other.products.shape:
            raise _unlike(self, other)
        products = _mean(self.count, self.products, other.count, other.products)
        noise, instruments, regressors = (
            None if one is None or two is None else _mean(self.count, one, other.count, two)
            for one, two in (
                (self.noise, other.noise),
                (self.instruments, other.instruments),
                (self.regressors, other.regressors),
            )
        )
        return CrossMoments(self.count + other.count, products, noise, instruments, regressors)


def _mean(
    count: int, values: Float[np.ndarray, "m n"], other_count: int, other: Float[np.ndarray, "m n"]
) -> Float[np.ndarray, "m n"]:
    total = count + other_count
    return values * (count / total) + other * (other_count / total)


def _unlike(one: Moments, other: Moments) -> UsageError:
    return UsageError(
        f"moments of the same kind and columns as these {type(one).__name__}",
        f"{type(other).__name__} of other columns" if type(one) is type(other) else type(other).__name__,
        "Merge moments that one method made of one problem.",
    )
