"""Sign-perturbed sums: regions whose coverage is exact in every finite sample.

When the errors are symmetric about zero and independent, of each other and of the instruments, then at
the true theta the sums S_0 = mean(psi_t e_t) and S_i = mean(a_it psi_t e_t), with random signs a_it = +-1,
i = 1..m-1, are exchangeable, whatever the errors' distributions: these may differ from row to row and
need not have moments. So the rank of |S_0| among them is uniform, and

    { theta : |S_0(theta)| is not among the q largest }

covers with probability exactly 1 - q/m (Csaji, Campi and Weyer 2015; with instruments Volpe, Csaji and
Weyer 2015). Lengths are taken after the shaping matrix mean(psi psi')^(-1/2), which makes the region
unchanged by a recombination of the instruments. Ties are broken by a random order of the m sums.

Notation: x = (1; theta) in homogeneous coordinates; every S_i is linear in x.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.linalg

from eivor.errors import CollinearError, ParameterError
from eivor.inference.sets.confidence_region import (
    ConfidenceRegion,
    Points,
    RegionFrame,
    RegionShape,
    scanned_shadow,
)
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.shapes import Float, Int

#: Rows whose signs are drawn at a time; the signs depend on it, so it is part of what a seed means.
SIGN_ROWS = 4096
#: Points ranked at a time.
RANKED_POINTS = 256
#: Squared lengths count as equal within this share, and below what rounding leaves of cancelled sums.
TIE_SHARE = 1e-10
ROUNDING = 1e-13


@dataclass(frozen=True)
class SignPerturbedShape(RegionShape):
    """Region of the rank of the unperturbed sum.

    Parameters
    ----------
    sums : ndarray, shape (m, p, n + 1)
        S_i as matrices that multiply x, shaped; the first one has no signs.
    excluded : int
        q.
    order : ndarray of int, shape (m,)
        Random order by which ties are broken: of equal lengths the one with the larger number is longer.
    """

    sums: Float[np.ndarray, "m p n_plus_1"]
    excluded: int
    order: Int[np.ndarray, " m"]

    @property
    def unknowns(self) -> int:
        """Number of parameters."""
        return self.sums.shape[2] - 1

    @cached_property
    def _differences(self) -> Float[np.ndarray, "m_less_1 n_plus_1 n_plus_1"]:
        """|S_0 x|^2 - |S_i x|^2 as quadratic forms."""
        forms = np.einsum("ipa,ipb->iab", self.sums, self.sums)
        return forms[0] - forms[1:]

    @cached_property
    def _largest(self) -> float:
        """Largest squared length of a sum's columns."""
        return float(np.einsum("ipa,ipa->ia", self.sums, self.sums).max())

    def excess(self, points: Points) -> Float[np.ndarray, " k"]:
        """|S_0|^2 over the q-th largest of the others, nudged off one where a tie decides."""
        found = np.empty(points.shape[0])
        for start in range(0, points.shape[0], RANKED_POINTS):
            here = slice(start, start + RANKED_POINTS)
            S = np.einsum("ipa,ka->kip", self.sums, points[here])
            lengths = np.einsum("kip,kip->ki", S, S)
            size = np.einsum("ka,ka->k", points[here], points[here])
            found[here] = self._ratios(lengths, ROUNDING**2 * self._largest * size)
        return found

    def _ratios(
        self, lengths: Float[np.ndarray, "k m"], rounding: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, " k"]:
        own, others = lengths[:, :1], lengths[:, 1:]
        behind = self.order[1:] < self.order[0]
        tied = np.abs(others - own) <= TIE_SHARE * np.maximum(own, others) + rounding[:, None]
        shorter = np.where(tied, behind, others < own).sum(axis=1)
        inside = shorter < lengths.shape[1] - self.excluded
        bound = np.partition(others, others.shape[1] - self.excluded, axis=1)[:, -self.excluded]
        ratio = np.divide(own[:, 0], bound, out=np.full(bound.size, np.inf), where=bound > 0.0)
        above = np.nextafter(1.0, 2.0)
        return np.where(inside, np.minimum(ratio, 1.0), np.maximum(ratio, above))

    def along(
        self, base: Float[np.ndarray, " n_plus_1"], step: Float[np.ndarray, " n_plus_1"]
    ) -> ConfidenceSet:
        """Members on a line: a rival is shorter where a quadratic is positive, whose roots are the ends."""
        D = self._differences
        a, b, c = (
            np.einsum("a,iab,b->i", step, D, step),
            2.0 * np.einsum("a,iab,b->i", base, D, step),
            np.einsum("a,iab,b->i", base, D, base),
        )
        ends = np.sort(_real_roots(a, b, c))
        if ends.size == 0:
            inside = bool(self.excess(base[None, :])[0] <= 1.0)
            return ConfidenceSet.whole_line() if inside else ConfidenceSet.empty()
        reach = max(1.0, float(np.abs(ends).max()))
        probes = np.concatenate([[ends[0] - reach], 0.5 * (ends[:-1] + ends[1:]), [ends[-1] + reach]])
        members = self.excess(base + probes[:, None] * step) <= 1.0
        edges = np.concatenate([[-np.inf], ends, [np.inf]])
        return ConfidenceSet.union((float(edges[i]), float(edges[i + 1])) for i in np.flatnonzero(members))

    def shadow(self, axis: int) -> ConfidenceSet:
        """Scanned; see `scanned_shadow`."""
        return scanned_shadow(self, axis)


def excluded_sums(level: float, sums: int) -> int:
    """Return q such that 1 - q/m is the level.

    Raises
    ------
    ParameterError
        When no whole number is: the coverage would not be the level.
    """
    excluded = (1 - Fraction(level).limit_denominator(10**6)) * sums
    if not (0.0 < level < 1.0 and excluded.denominator == 1 and 1 <= excluded < sums):
        raise ParameterError(
            "a level between 0 and 1 of which (1 - level) times the number of sums is a whole number",
            f"level={level}, sums={sums}",
            "Use level=0.95 with sums=100, or 0.99 with 200, for example.",
        )
    return int(excluded)


def sign_perturbed_region(
    names: tuple[str, ...],
    instruments: Float[np.ndarray, "rows p"],
    columns: Float[np.ndarray, "rows n_plus_1"],
    rng: np.random.Generator,
    *,
    level: float,
    sums: int,
) -> ConfidenceRegion:
    """Region by sign perturbation.

    Parameters
    ----------
    names : tuple of str
        Parameters.
    instruments : ndarray, shape (rows, p)
        Independent columns.
    columns : ndarray, shape (rows, n + 1)
        [y Phi].
    rng : numpy.random.Generator
        Draws signs and the order of ties.
    level : float
        Coverage.
    sums : int
        m.

    Raises
    ------
    CollinearError
        When an instrument is a combination of others.
    ParameterError
        When level and number of sums do not fit.

    Notes
    -----
    O(rows m p n) once; a point then costs O(m p n), a line O(m^2 p n).
    """
    excluded = excluded_sums(level, sums)
    rows, p = instruments.shape
    root = np.asarray(np.linalg.qr(instruments, mode="r")).T
    lengths = np.linalg.norm(root, axis=1)
    if not lengths.all() or (np.abs(np.diag(root)) < 1e-10 * lengths).any():
        raise CollinearError(
            "independent instruments", "one that is a combination of others", "Leave it out."
        )
    order = rng.permutation(sums)
    frame = _frame(columns, scipy.linalg.solve_triangular(root, instruments.T @ columns, lower=True))
    change = np.zeros((columns.shape[1], columns.shape[1]))
    change[0, 0] = 1.0
    change[1:, 0], change[1:, 1:] = -frame.pivot, -np.diag(frame.scale)
    moved = columns @ change
    total = np.zeros((sums, p * moved.shape[1]))
    for start in range(0, rows, SIGN_ROWS):
        psi, z = instruments[start : start + SIGN_ROWS], moved[start : start + SIGN_ROWS]
        products = (psi[:, :, None] * z[:, None, :]).reshape(psi.shape[0], -1)
        signs = np.ones((sums, psi.shape[0]))
        signs[1:] -= 2.0 * rng.integers(0, 2, size=(sums - 1, psi.shape[0]), dtype=np.int8)
        total += signs @ products
    shaped = scipy.linalg.solve_triangular(root, _by_equation(total, p), lower=True)
    stacked = shaped.reshape(p, sums, -1).transpose(1, 0, 2)
    return ConfidenceRegion(names, frame, SignPerturbedShape(np.ascontiguousarray(stacked), excluded, order))


def _by_equation(total: Float[np.ndarray, "m products"], p: int) -> Float[np.ndarray, "p m_columns"]:
    return total.reshape(total.shape[0], p, -1).transpose(1, 0, 2).reshape(p, -1)


def _frame(
    columns: Float[np.ndarray, "rows n_plus_1"], shaped: Float[np.ndarray, "p n_plus_1"]
) -> RegionFrame:
    """Two-stage estimate, and sizes of parameters that change S_0 by the usual length of an S_i."""
    lengths = np.linalg.norm(shaped[:, 1:], axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    solution = np.linalg.lstsq(shaped[:, 1:] / lengths, shaped[:, 0], rcond=None)[0] / lengths
    residual = columns[:, 0] - columns[:, 1:] @ solution
    usual = float(np.sqrt(residual @ residual / residual.size))
    return RegionFrame(solution, (usual or 1.0) / lengths)


def _real_roots(
    a: Float[np.ndarray, " k"], b: Float[np.ndarray, " k"], c: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " roots"]:
    """Real roots of all a s^2 + b s + c, without cancellation."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inner = b * b - 4.0 * a * c
        q = -0.5 * (b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(inner))
        roots = np.concatenate([q / a, c / q])
    return roots[np.isfinite(roots)]
