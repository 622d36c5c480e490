"""Moments: the mergeable summary of a problem, all that its assembler needs of it.

Direct methods keep a triangular root of their rows, so that no condition number is squared; instrumental
methods keep mean cross-products, which is how they are defined. Merging is associative and weighted by
the numbers of rows: it gives streaming, pooling, and distributed reduction alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.inference.products import Products
from eivor.linalg.triangular import merged_roots
from eivor.models.equation import Parameter
from eivor.shapes import Float


class Moments(ABC):
    """Summary of some rows."""

    @property
    @abstractmethod
    def rows(self) -> float:
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
    count : float
        Number of rows.
    root : ndarray, shape (k, n + 1), k <= n + 1
        R with R'R = [Phi y]'[Phi y].
    noise : ndarray, shape (n + 1, n + 1), optional
        Mean covariance of the measurement noises of [Phi y].
    """

    count: float
    root: Float[np.ndarray, "k n_plus_1"]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None

    @property
    def rows(self) -> float:
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
    """Mean cross-products of the instruments with [Phi y], a view of a table of products.

    Parameters
    ----------
    products : Products
        Of [psi phi y]; whole for weights and the strength of the instruments.
    noise : ndarray, shape (p, n + 1), optional
        C and c: what the measurement noises add to mean(psi [phi' y]) on average.
    """

    products: Products
    noise: Float[np.ndarray, "p n_plus_1"] | None = None

    @property
    def rows(self) -> float:
        """Number of rows."""
        return self.products.count

    @property
    def equations(self) -> Float[np.ndarray, "p n_plus_1"]:
        """mean(psi [phi' y])."""
        return np.asarray(self.products.equations.sum(axis=0)) / self.rows

    @property
    def instruments(self) -> Float[np.ndarray, "p p"] | None:
        """mean(psi psi'); None when it was not made."""
        if not self.products.layout.whole:
            return None
        return np.asarray(self.products.instruments.sum(axis=0)) / self.rows

    @property
    def regressors(self) -> Float[np.ndarray, "n n"] | None:
        """mean(phi phi'); None when it was not made."""
        if not self.products.layout.whole:
            return None
        return np.asarray(self.products.regressors.sum(axis=0)) / self.rows

    @property
    def columns(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"] | None:
        """mean([phi y] [phi y]'); None when it was not made."""
        if not self.products.layout.whole:
            return None
        first = self.products.layout.first_right
        return np.asarray(self.products.sums[:, first:, first:].sum(axis=0)) / self.rows

    def shared_noise(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " p"]:
        """What the noises add to each row's products with the residual on average, C theta - c."""
        if self.noise is None:
            return np.zeros(self.products.layout.instruments)
        return self.noise[:, :-1] @ theta - self.noise[:, -1]

    def merge(self, other: Moments) -> CrossMoments:
        """Sums of both; count-weighted means of the noises' covariances."""
        if not isinstance(other, CrossMoments) or _columns(self) != _columns(other):
            raise _unlike(self, other)
        both = [self.products, other.products]
        if not all(products.layout.whole for products in both):
            both = [products.equations_only for products in both]
        noise = None
        if self.noise is not None and other.noise is not None:
            noise = _mean(self.rows, self.noise, other.rows, other.noise)
        return CrossMoments((both[0].total + both[1].total).total, noise)


def _columns(moments: CrossMoments) -> tuple[int, int]:
    return moments.products.layout.instruments, moments.products.layout.regressors


@dataclass(frozen=True)
class ProblemMoments:
    """Moments of a problem, with the names of its parameters.

    Parameters
    ----------
    parameters : tuple of Parameter
        In the order of the regressors.
    moments : Moments
        What the method's assembler needs.
    """

    parameters: tuple[Parameter, ...]
    moments: Moments

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        return tuple(parameter.name for parameter in self.parameters)

    def merge(self, other: ProblemMoments) -> ProblemMoments:
        """Moments of both sets of rows: other chunks, other flights, other machines.

        Raises
        ------
        UsageError
            When the parameters or the kinds of moments differ.
        """
        if self.names != other.names:
            raise UsageError(
                f"moments of the parameters {', '.join(self.names)}",
                f"moments of {', '.join(other.names)}",
                "Merge moments of one model.",
            )
        return replace(self, moments=self.moments.merge(other.moments))


def _mean(
    count: float, values: Float[np.ndarray, "m n"], other_count: float, other: Float[np.ndarray, "m n"]
) -> Float[np.ndarray, "m n"]:
    total = count + other_count
    return values * (count / total) + other * (other_count / total)


def _unlike(one: Moments, other: Moments) -> UsageError:
    return UsageError(
        f"moments of the same kind and columns as these {type(one).__name__}",
        f"{type(other).__name__} of other columns" if type(one) is type(other) else type(other).__name__,
        "Merge moments that one method made of one problem.",
    )
