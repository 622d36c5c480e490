"""The record of diagnostics, and block cosines that they use."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from eivor.inference.covariance import cosine_averages, unit_scale
from eivor.inference.distributions import chi_square_tail
from eivor.inference.estimating_equation import Products
from eivor.inference.verdict import Reason
from eivor.tools import Float

#: Fewest averages, and how many there are for each equation that is tested.
LEAST_AVERAGES = 8
AVERAGES_PER_EQUATION = 3


def joint_averages(equations: int, blocks: int) -> int:
    """Averages for a joint test of `equations`: three for each and at least eight, as blocks permit."""
    return min(max(LEAST_AVERAGES, AVERAGES_PER_EQUATION * equations), blocks // 2)


def covariance_of_total(sums: Float[np.ndarray, "K n"], averages: int) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum over all blocks."""
    L = cosine_averages(sums, averages)
    return L.T @ L / averages


def quadratic_form(total: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> float:
    """Total' covariance^-1 total, without the directions in which a singular covariance says nothing."""
    scale = unit_scale(np.diag(covariance))
    correlation = np.outer(scale, scale) * covariance
    return float((scale * total) @ np.linalg.lstsq(correlation, scale * total, rcond=None)[0])


def hotelling_p_value(W: float, equations: int, averages: int | None) -> float:
    """P-value of a quadratic form on `averages` cosine averages, or with a known weight when None."""
    if equations < 1:
        return 1.0
    if averages is None:
        return chi_square_tail(W, equations)
    degrees = averages - equations + 1
    if degrees < 1:
        return float("nan")
    return float(scipy.special.fdtrc(equations, degrees, W * degrees / (averages * equations)))


#: Level at which a test speaks: four tests of a good estimate are silent together in 96 records of 100.
SIGNIFICANT = 0.01
#: Level from which on what a test says is beyond doubt, so that a verdict may rest on it.
BEYOND_DOUBT = 0.001


@dataclass(frozen=True, slots=True)
class Row:
    """One number of a diagnostic."""

    diagnostic: str  # Name of the number
    of: str
    value: float
    compare: float | None
    line: str = ""  # In words, of the main numbers


@dataclass(frozen=True)
class Subject:
    """What a diagnostic is of, as its sentences name it."""

    names: tuple[str, ...]  # Each joint parameter
    std_errors: Float[np.ndarray, " n"]
    at_row: Callable[[int], str]
    rows: int

    def when(self, share: float) -> str:
        """Where a share of the rows is, in words."""
        return self.at_row(round(share * self.rows))


class Diagnostic(ABC):
    """A statistic with what it is held against, its rows and its sentences."""

    @abstractmethod
    def rows(self, of: Subject, /) -> Iterator[Row]:
        """Every number."""

    def reasons(self, _of: Subject, /) -> Iterator[Reason]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return iter(())


def outcome_word(p_value: float, words: tuple[str, str, str]) -> str:
    """Word for the outcome of a test: kept, doubtful, rejected."""
    if p_value >= SIGNIFICANT:
        return words[0]
    return words[1] if p_value > BEYOND_DOUBT else words[2]


#: Directions of the unit-length instruments with smaller singular values are noise and are dropped.
SMALLEST_DIRECTION = 1e-4


def orthonormal_basis(instruments: Float[np.ndarray, "rows p"]) -> Float[np.ndarray, "rows q"]:
    """Orthonormal basis of the space of the instruments, each scaled to unit length first."""
    lengths = np.sqrt(np.einsum("ij,ij->j", instruments, instruments))
    moving = lengths > 0.0
    if not moving.any():
        return np.empty((instruments.shape[0], 0))
    U, singular, _ = np.linalg.svd(instruments[:, moving] / lengths[moving], full_matrices=False)
    return np.asarray(U[:, singular >= SMALLEST_DIRECTION])


def whitening(products: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p q"]:
    """T with T' products T = 1, without the directions in which the instruments hardly move."""
    scale = unit_scale(np.diag(products))
    values, vectors = np.linalg.eigh(np.outer(scale, scale) * products)
    kept = values > SMALLEST_DIRECTION**2
    return scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])


def conditional_first_stage(
    basis: Float[np.ndarray, "rows p"], jacobian: Float[np.ndarray, "rows n"], exact: int = 0
) -> Float[np.ndarray, " n"]:
    """F statistic of each column of G given the others (Sanderson and Windmeijer 2016, for whitened rows)."""
    rows, rank = basis.shape
    count, noisy = jacobian.shape[1], rank - exact
    if rank < count or rows <= rank:
        return np.zeros(count)
    projected = basis.T @ jacobian
    strengths = np.zeros(count)
    for j in range(count):
        others = [i for i in range(count) if i != j]
        delta = np.linalg.lstsq(projected[:, others], projected[:, j], rcond=None)[0]
        r = jacobian[:, j] - jacobian[:, others] @ delta
        explained = basis.T @ r
        unexplained = float(r @ r - explained @ explained)
        taken = np.linalg.qr(projected[:, others])[0][:noisy]
        degrees = noisy - float((taken**2).sum())
        if unexplained > 0.0 and degrees > 0.0:
            strengths[j] = float(explained @ explained) / degrees / (unexplained / (rows - rank))
        else:
            strengths[j] = np.inf
    return strengths


def first_stage_of_products(
    instruments: Float[np.ndarray, "p p"],
    cross: Float[np.ndarray, "p n"],
    regressors: Float[np.ndarray, "n n"],
    rows: int | float,
    shared: Float[np.ndarray, "p n"] | None = None,
) -> Float[np.ndarray, " n"]:
    """Conditional first-stage F from mean(psi psi'), mean(psi phi') and mean(phi phi')."""
    available, count = cross.shape
    degrees = available - (count - 1)
    if degrees < 1 or rows <= available or not np.diag(instruments).all():
        return np.zeros(count)
    to_basis = whitening(instruments).T
    noise_products = to_basis @ (np.zeros(cross.shape) if shared is None else shared)
    basis_products = to_basis @ cross - noise_products
    projected = basis_products.T @ basis_products
    strengths = np.zeros(count)
    for j in range(count):
        others = [i for i in range(count) if i != j]
        delta = np.linalg.lstsq(projected[np.ix_(others, others)], projected[others, j], rcond=None)[0]
        direction = np.zeros(count)
        direction[j], direction[others] = 1.0, -delta
        explained = float(direction @ projected @ direction)
        total = float(direction @ regressors @ direction)
        both = float((basis_products @ direction) @ (noise_products @ direction))
        unexplained = total - explained - 2.0 * both
        negligible = unexplained <= 1e-12 * float(regressors[j, j])
        strengths[j] = np.inf if negligible else explained / degrees / (unexplained / (rows - available))
    return strengths


@dataclass(frozen=True)
class EquationProducts(Products):
    """Products of [psi G e] over K successive blocks of time, and what compensation adds."""

    shared: Float[np.ndarray, "p n"]
    constant: Float[np.ndarray, " p"]  # C theta - c
    rows: float  # Rows that the sums are of, in which degrees of freedom are counted

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
    def equation_sums(self) -> Float[np.ndarray, "K p"]:
        """Sums of the equations' scores psi e + C theta - c over each block."""
        return self.instrument_response + self.counts[:, None] * self.constant

    @cached_property
    def whitening(self) -> Float[np.ndarray, "p q"]:
        """T with T' mean(psi psi') T = 1."""
        return whitening(self.instrument_mean)
