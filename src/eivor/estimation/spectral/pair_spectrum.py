"""Spectra of two residuals: a Hermitian 2 x 2 matrix for each bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Complex, Float

Pair = Complex[np.ndarray, "2 bins"]


@dataclass(frozen=True, slots=True)
class PairSpectrum:
    """C of each bin, by its entries.

    Parameters
    ----------
    first, second : ndarray, shape (bins,)
        On the diagonal.
    cross : ndarray, shape (bins,)
        First row, second column; its conjugate is the other.
    """

    first: Float[np.ndarray, " bins"]
    second: Float[np.ndarray, " bins"]
    cross: Complex[np.ndarray, " bins"]

    def __add__(self, other: PairSpectrum) -> PairSpectrum:
        return PairSpectrum(self.first + other.first, self.second + other.second, self.cross + other.cross)

    def __mul__(self, factor: float | Float[np.ndarray, " bins"]) -> PairSpectrum:
        return PairSpectrum(self.first * factor, self.second * factor, self.cross * factor)

    @property
    def determinant(self) -> Float[np.ndarray, " bins"]:
        """Of each bin."""
        return self.first * self.second - np.abs(self.cross) ** 2

    def solved(self, pair: Pair) -> Pair:
        """C^-1 x."""
        determinant = self.determinant
        return np.stack(
            [
                (self.second * pair[0] - self.cross * pair[1]) / determinant,
                (self.first * pair[1] - self.cross.conj() * pair[0]) / determinant,
            ]
        )

    def traces_over(self, other: PairSpectrum) -> Float[np.ndarray, " bins"]:
        """tr(other^-1 C), a real number for Hermitian matrices."""
        cross = (other.cross.conj() * self.cross).real
        found: Float[np.ndarray, " bins"] = (
            other.second * self.first + other.first * self.second - 2.0 * cross
        ) / other.determinant
        return found

    def trace_with(self, other: PairSpectrum) -> Float[np.ndarray, " bins"]:
        """tr(other C)."""
        found: Float[np.ndarray, " bins"] = (
            other.first * self.first
            + other.second * self.second
            + 2.0 * (other.cross.conj() * self.cross).real
        )
        return found

    def between(self, other: PairSpectrum) -> PairSpectrum:
        """other^-1 C other^-1."""
        a, b, c = other.second, other.first, -other.cross
        squared = other.determinant**2
        crossed = c.conj() * self.cross
        return PairSpectrum(
            (a * a * self.first + 2.0 * a * crossed.real + np.abs(c) ** 2 * self.second) / squared,
            (b * b * self.second + 2.0 * b * crossed.real + np.abs(c) ** 2 * self.first) / squared,
            (a * c * self.first + a * b * self.cross + c * c * self.cross.conj() + b * c * self.second)
            / squared,
        )

    def root(
        self,
    ) -> tuple[Float[np.ndarray, " bins"], Complex[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
        """Lower Cholesky factor: its first diagonal, what stands below, its second diagonal."""
        top = np.sqrt(self.first)
        below = self.cross.conj() / top
        return top, below, np.sqrt(self.determinant / self.first)

    def whitened(self, pair: Pair) -> Pair:
        """L^-1 x with C = L L^H."""
        top, below, bottom = self.root()
        one = pair[0] / top
        return np.stack([one, (pair[1] - below * one) / bottom])


def inner(left: Pair, right: Pair) -> Complex[np.ndarray, " bins"]:
    """x^H y of each bin."""
    found: Complex[np.ndarray, " bins"] = (left.conj() * right).sum(axis=0)
    return found
