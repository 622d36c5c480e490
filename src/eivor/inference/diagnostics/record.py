"""The record of diagnostics, and block cosines that they use."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from eivor.inference.covariance import column_scale, unit_scale
from eivor.inference.distributions import chi_square_tail
from eivor.inference.estimating_equation import Products
from eivor.inference.verdict import Reason
from eivor.linalg.system import symmetric_eigen, triangular_root
from eivor.tools import Float

#: Fewest averages, and how many there are for each equation that is tested.
LEAST_AVERAGES = 8
AVERAGES_PER_EQUATION = 3


def joint_averages(equations: int, blocks: int) -> int:
    """Averages for a joint test of `equations`: three for each and at least eight, as blocks permit."""
    return min(max(LEAST_AVERAGES, AVERAGES_PER_EQUATION * equations), blocks // 2)


def quadratic_form(total: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> float:
    """Total' covariance^-1 total, without the directions in which a singular covariance says nothing."""
    scale = unit_scale(covariance.diagonal())
    values, vectors = symmetric_eigen(scale[:, None] * covariance * scale)
    size, parts = np.abs(values), (scale * total) @ vectors
    significant = size > sys.float_info.epsilon * values.size * size.max(initial=0.0)
    return float(np.divide(parts * parts, values, out=np.zeros(values.size), where=significant).sum())


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
#: Level from which a test is beyond doubt, so that a verdict may rest on it.
BEYOND_DOUBT = 0.001


class Row(NamedTuple):
    """One number of a diagnostic."""

    diagnostic: str  # Name of the number
    of: str
    value: float
    compare: float | None
    line: str = ""  # In words, of the main numbers


@dataclass(frozen=True)
class Subject:
    """Estimate that a diagnostic is of, as its sentences name it."""

    names: tuple[str, ...]  # Each joint parameter
    std_errors: Float[np.ndarray, " n"]
    at_row: Callable[[int], str]
    rows: int

    def when(self, share: float) -> str:
        """Position of a share of the rows, in words."""
        return self.at_row(round(share * self.rows))


class Diagnostic(ABC):
    """A statistic with its thresholds, rows and sentences."""

    @abstractmethod
    def rows(self, subject: Subject, /) -> Iterator[Row]:
        """Every number."""

    def reasons(self, _subject: Subject, /) -> Iterator[Reason]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return iter(())


def outcome_word(p_value: float, words: tuple[str, str, str]) -> str:
    """Word for the outcome of a test: kept, doubtful, rejected."""
    if p_value >= SIGNIFICANT:
        return words[0]
    return words[1] if p_value > BEYOND_DOUBT else words[2]


#: Columns of unit length that differ by this share or less are the same.
LEAST_SHARE = 1e-13
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
    scale = unit_scale(products.diagonal())[:, None]
    scaled = scale * products * scale.T
    factor, failed = scipy.linalg.lapack.dpotrf(scaled)
    if not failed:
        inverse = scipy.linalg.lapack.dtrtri(factor)[0]
        if (inverse * inverse).sum() < SMALLEST_DIRECTION**-2:  # no direction has a smaller eigenvalue
            return scale * inverse
    values, vectors = symmetric_eigen(scaled)
    significant = values > SMALLEST_DIRECTION**2
    return scale * vectors[:, significant] / np.sqrt(values[significant])


def partial_directions(columns: Float[np.ndarray, "q n"]) -> Float[np.ndarray, "n n"]:
    """Row j: the combination of columns that is column j less its projection on the others."""
    scale = column_scale(columns)
    # a ridge that nothing but rounding is smaller than: of columns that are alike both have their share
    root = triangular_root(np.concatenate([columns * scale, LEAST_SHARE * np.eye(scale.size)]))
    inverse = scipy.linalg.lapack.dtrtri(root)[0]
    inverse = inverse @ inverse.T
    return inverse * scale / (inverse.diagonal() * scale)[:, None]


def conditional_first_stage(
    basis: Float[np.ndarray, "rows p"],
    jacobian: Float[np.ndarray, "rows n"],
    exact: int = 0,
    *,
    effective: bool = False,
) -> Float[np.ndarray, " n"]:
    """F statistic of each column of G given the others (Sanderson and Windmeijer 2016, for whitened rows).

    The effective F weights what rows leave by the power of instruments there (Montiel Olea, Pflueger 2013).
    """
    rows, rank = basis.shape
    count, noisy = jacobian.shape[1], rank - exact
    if rank < count or rows <= rank:
        return np.zeros(count)
    projected = basis.T @ jacobian
    residuals = jacobian @ partial_directions(projected).T
    fitted = basis.T @ residuals
    explained = (fitted**2).sum(axis=0)
    unexplained = (residuals**2).sum(axis=0) - explained
    if effective:
        power = (basis**2).sum(axis=1)
        unexplained = power @ (residuals - basis @ fitted) ** 2 * (rows - rank) / noisy
    others = (np.linalg.qr(np.delete(projected, j, axis=1))[0] for j in range(count))
    degrees = noisy - np.array([(Q[:noisy] ** 2).sum() for Q in others])
    tested = (unexplained > 0.0) & (degrees > 0.0)
    strengths = np.full(count, np.inf)
    return np.divide(explained * (rows - rank), degrees * unexplained, out=strengths, where=tested)


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
    if degrees < 1 or rows <= available or not instruments.diagonal().all():
        return np.zeros(count)
    to_basis = whitening(instruments).T
    noise_products = to_basis @ (np.zeros(cross.shape) if shared is None else shared)
    basis_products = to_basis @ cross - noise_products
    directions = partial_directions(basis_products)
    projected = basis_products @ directions.T
    explained = (projected * projected).sum(axis=0)
    unexplained = ((directions @ regressors) * directions).sum(axis=1) - explained
    unexplained -= 2.0 * (projected * (noise_products @ directions.T)).sum(axis=0)
    testable, strengths = unexplained > 1e-12 * regressors.diagonal(), np.full(count, np.inf)
    return np.divide(explained * (rows - available), degrees * unexplained, out=strengths, where=testable)


@dataclass(frozen=True)
class EquationProducts(Products):
    """Products of [psi G e] over K successive blocks of time, and the compensation."""

    shared: Float[np.ndarray, "p n"]
    constant: Float[np.ndarray, " p"]  # C theta - c
    rows: float  # Rows that the sums are of, in which degrees of freedom are counted

    @property
    def instrument_mean(self) -> Float[np.ndarray, "p p"]:
        """mean(psi psi')."""
        return self.mean[: self.tested, : self.tested]

    @cached_property
    def sensitivity(self) -> Float[np.ndarray, "p n"]:
        """A = mean(psi G') - C."""
        return self.mean[: self.tested, self.tested : -1] - self.shared

    @property
    def regressor_mean(self) -> Float[np.ndarray, "n n"]:
        """mean(G G')."""
        return self.mean[self.tested : -1, self.tested : -1]

    @cached_property
    def equation_sums(self) -> Float[np.ndarray, "K p"]:
        """Sums of the equations' scores psi e + C theta - c over each block."""
        return self.instrument_response + self.counts[:, None] * self.constant

    @cached_property
    def whitening(self) -> Float[np.ndarray, "p q"]:
        """T with T' mean(psi psi') T = 1."""
        return whitening(self.instrument_mean)
