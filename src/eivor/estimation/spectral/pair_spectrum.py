"""Spectra of two residuals: a Hermitian 2 x 2 matrix for each bin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.shapes import Complex, Float

Pair = Complex[np.ndarray, "2 bins"]
Pairs = Complex[np.ndarray, "*shape 2 bins"]


@dataclass(frozen=True)
class PairSpectrum:
    """C of each bin, by its entries; of several matrices a bin where these have more axes.

    Parameters
    ----------
    first, second : ndarray, shape (..., bins)
        On the diagonal.
    cross : ndarray, shape (..., bins)
        First row, second column; its conjugate is the other.
    """

    first: Float[np.ndarray, "*shape bins"]
    second: Float[np.ndarray, "*shape bins"]
    cross: Complex[np.ndarray, "*shape bins"]

    def __add__(self, other: PairSpectrum) -> PairSpectrum:
        return PairSpectrum(self.first + other.first, self.second + other.second, self.cross + other.cross)

    def __mul__(self, factor: float | Float[np.ndarray, "*shape bins"]) -> PairSpectrum:
        return PairSpectrum(self.first * factor, self.second * factor, self.cross * factor)

    @cached_property
    def determinant(self) -> Float[np.ndarray, "*shape bins"]:
        """Of each bin."""
        return self.first * self.second - (self.cross.real**2 + self.cross.imag**2)

    @cached_property
    def _inverse(
        self,
    ) -> tuple[
        Float[np.ndarray, "*shape bins"], Float[np.ndarray, "*shape bins"], Complex[np.ndarray, "*shape bins"]
    ]:
        """C^-1: both of its diagonal, first row and second column."""
        determinant = self.determinant
        return self.second / determinant, self.first / determinant, self.cross / -determinant

    def solved(self, pairs: Pairs) -> Pairs:
        """C^-1 x, of one pair or of several."""
        first, second, cross = self._inverse
        found = np.empty(pairs.shape, dtype=np.complex128)
        found[..., 0, :] = first * pairs[..., 0, :] + cross * pairs[..., 1, :]
        found[..., 1, :] = cross.conj() * pairs[..., 0, :] + second * pairs[..., 1, :]
        return found

    def between(self, other: PairSpectrum) -> PairSpectrum:
        """other^-1 C other^-1."""
        a, b, c = other._inverse
        twice, size = 2.0 * (c.conj() * self.cross).real, c.real**2 + c.imag**2
        return PairSpectrum(
            a * a * self.first + a * twice + size * self.second,
            b * b * self.second + b * twice + size * self.first,
            c * (a * self.first + b * self.second + c * self.cross.conj()) + a * b * self.cross,
        )

    @cached_property
    def root(
        self,
    ) -> tuple[
        Float[np.ndarray, "*shape bins"], Complex[np.ndarray, "*shape bins"], Float[np.ndarray, "*shape bins"]
    ]:
        """Lower Cholesky factor: its first diagonal, what stands below, its second diagonal."""
        top = np.sqrt(self.first)
        below = self.cross.conj() / top
        return top, below, np.sqrt(self.determinant / self.first)

    def whitened(self, pairs: Pairs) -> Pairs:
        """L^-1 x with C = L L^H, of one pair or of several."""
        top, below, bottom = self.root
        found = np.empty(pairs.shape, dtype=np.complex128)
        found[..., 0, :] = pairs[..., 0, :] / top
        found[..., 1, :] = (pairs[..., 1, :] - below * found[..., 0, :]) / bottom
        return found


def inner(left: Pair, right: Pair) -> Complex[np.ndarray, " bins"]:
    """x^H y of each bin."""
    found: Complex[np.ndarray, " bins"] = (left.conj() * right).sum(axis=0)
    return found
