"""Anderson-Rubin and sign-perturbed confidence sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
import scipy

from eivor.errors import CollinearError, ParameterError, TooFewSamplesError
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.covariance import column_scale, unit_scale
from eivor.inference.regions import ConfidenceRegion, Points, RegionFrame, RegionShape, hotelling_quantile
from eivor.tools import Bool, Float, Int

Point = Float[np.ndarray, " n_plus_1"]
Equations = Float[np.ndarray, "p n_plus_1"]
Square = Float[np.ndarray, "p p"]
PerPoint = Float[np.ndarray, " k"]
Vector = Float[np.ndarray, " n"]


#: Cosine averages B = RATE rows^(2/3) (Lazarus et al. 2018), and at least so many for each equation.
AVERAGES_RATE = 0.4
AVERAGES_PER_EQUATION = 2
#: Eigenvalues count as real up to this share of their size: they only propose ends, membership decides.
REAL_SHARE = 1e-3
#: Variances below this share of all equations' together are lost in rounding, and are taken as this large.
SMALLEST_SHARE = 1e-13


@dataclass(frozen=True)
class LinearScores:
    """Sums and cosine averages of scores that are linear in (1; -theta)."""

    total: Equations
    cosines: Float[np.ndarray, "averages p n_plus_1"]


def averages_for(samples: int, equations: int) -> int:
    """Number of cosine averages B for so many samples and equations."""
    averages = max(round(AVERAGES_RATE * samples ** (2.0 / 3.0)), AVERAGES_PER_EQUATION * equations)
    if 4 * averages > samples:
        expected = f"at least {4 * averages} samples for {equations} moment equations"
        raise TooFewSamplesError(expected, f"{samples}", "Give a longer record, or fewer instruments.")
    return averages


@dataclass(frozen=True)
class RobustShape(RegionShape):
    """Region of the autocorrelation-robust test, in coordinates in which V is the identity at the pivot."""

    scores: LinearScores
    critical: float  # Value that AR must not exceed

    @cached_property
    def _covariances(self) -> Float[np.ndarray, "n_plus_1 n_plus_1 p p"]:
        """V_ab with V(x) = sum_ab x_a x_b V_ab."""
        L = self.scores.cosines
        return np.asarray(np.einsum("jpa,jqb->abpq", L, L) / L.shape[0])

    def excess(self, points: Points) -> PerPoint:
        g = points @ self.scores.total.T
        V = np.tensordot(points[:, :, None] * points[:, None, :], self._covariances, axes=2)
        # Scores of an exact regressor hardly vary far out: AR grows there, and must not be rounding.
        floor = SMALLEST_SHARE * np.trace(V, axis1=1, axis2=2)
        V += np.where(floor > 0.0, floor, 1.0)[:, None, None] * np.eye(V.shape[1])
        solved = np.linalg.solve(V, g[:, :, None])[:, :, 0]
        return np.einsum("kp,kp->k", g, solved) / self.critical

    def along(self, base: Point, step: Point) -> ConfidenceSet:
        """Members on a line: AR = c where the matrix polynomial c V(s) - g(s) g(s)' is singular."""
        b, d = self.scores.total @ base, self.scores.total @ step
        c = self.critical
        M0 = c * self._bilinear(base, base) - np.outer(b, b)
        M1 = 2.0 * c * self._bilinear(base, step) - np.outer(b, d) - np.outer(d, b)
        M2 = c * self._bilinear(step, step) - np.outer(d, d)
        return self.members(base, step, _real_eigenvalues(M0, M1, M2))

    def _bilinear(self, first: Point, second: Point) -> Square:
        V = np.einsum("a,b,abpq->pq", first, second, self._covariances)
        return 0.5 * (V + V.T)


def robust_region(names: tuple[str, ...], scores: LinearScores, level: float) -> ConfidenceRegion:
    """Autocorrelation-robust region."""
    p, averages = scores.total.shape[0], scores.cosines.shape[0]
    pivot = _solution(scores.total)[0]
    root = np.eye(p)
    error = CollinearError(
        "errors that vary, and independent moment equations",
        "equations that hold without any error, or of which one is a combination of others",
        "Leave out instruments that repeat others; data without any error need no confidence set.",
    )
    for _ in range(2):
        pivot_cosines = scores.cosines @ np.concatenate([[1.0], -pivot])
        root = _triangular_root(pivot_cosines / np.sqrt(averages), error)
        pivot = _solution(scipy.linalg.solve_triangular(root, scores.total, lower=True))[0]
    A = scipy.linalg.solve_triangular(root, scores.total[:, 1:], lower=True)
    scale = column_scale(A)
    singular, V = np.linalg.svd(A * scale, full_matrices=False)[1:]
    large = singular > 1e-8 * singular[0]
    frame = RegionFrame(pivot, scale / unit_scale(((V[large] / singular[large, None]) ** 2).sum(axis=0)))
    whitening = scipy.linalg.solve_triangular(root, np.eye(p), lower=True)
    critical = hotelling_quantile(level, p, float(averages))
    change = _to_frame(frame)
    framed = LinearScores(whitening @ scores.total @ change, whitening @ scores.cosines @ change)
    return ConfidenceRegion(names, frame, RobustShape(framed, critical))


def _to_frame(frame: RegionFrame) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
    n = frame.pivot.size
    change = np.zeros((n + 1, n + 1))
    change[0, 0] = 1.0
    change[1:, 0] = -frame.pivot
    change[1:, 1:] = -np.diag(frame.scale)
    return change


def _solution(equations: Equations) -> tuple[Vector, Vector]:
    """Least squares of the first column on the others, and the scales of these to unit length."""
    scale = column_scale(equations[:, 1:])
    solution = np.linalg.lstsq(equations[:, 1:] * scale, equations[:, 0], rcond=None)[0]
    return solution * scale, scale


def _triangular_root(rows: Float[np.ndarray, "rows p"], error: CollinearError) -> Square:
    """Lower triangular L with L L' = rows' rows, by QR; an error where columns are combinations of others."""
    root: Square = np.asarray(np.linalg.qr(rows, mode="r")).T
    lengths = np.linalg.norm(root, axis=1)
    if not lengths.all() or (np.abs(np.diag(root)) < 1e-10 * lengths).any():
        raise error
    return root


def _real_eigenvalues(M0: Square, M1: Square, M2: Square) -> list[float]:
    """Real numbers at which M0 + s M1 + s^2 M2 is singular, by its companion pencil, s scaled to size one."""
    p = M0.shape[0]
    constant, quadratic = float(np.linalg.norm(M0)), float(np.linalg.norm(M2))
    gamma = np.sqrt(constant / quadratic) if constant > 0.0 and quadratic > 0.0 else 1.0
    M0, M1, M2 = (M / (constant or 1.0) for M in (M0, gamma * M1, gamma**2 * M2))
    eye, zero = np.eye(p), np.zeros((p, p))
    values = scipy.linalg.eigvals(
        np.block([[zero, eye], [-M0, -M1]]), np.block([[eye, zero], [zero, M2]]), check_finite=False
    )
    values = values[np.isfinite(values)]
    real = np.abs(values.imag) <= REAL_SHARE * np.abs(values)
    return [float(value) for value in gamma * values.real[real]]


def minimum_ratio(N: Float[np.ndarray, "k m m"], D: Float[np.ndarray, "k m m"]) -> PerPoint:
    """Least J over all parameters."""
    root = np.linalg.cholesky(D)
    half = np.linalg.solve(root, N)
    return np.asarray(np.linalg.eigvalsh(np.linalg.solve(root, half.transpose(0, 2, 1)))[:, 0])


def concentrated(
    Q: Float[np.ndarray, "*k m m"], variables: Sequence[int]
) -> tuple[Float[np.ndarray, "*k c c"], Bool[np.ndarray, "*k"]]:
    """Quadratic forms of some variables, least over the others; and where these go to infinity at no cost."""
    others = [i for i in range(Q.shape[-1]) if i not in variables]
    S = Q[..., variables, :][..., variables]
    if not others:
        return S, np.zeros(Q.shape[:-2], dtype=np.bool_)
    inner, cross = Q[..., others, :][..., others], Q[..., others, :][..., variables]
    free = np.asarray(np.linalg.eigvalsh(inner)[..., 0] <= 0.0)
    inner = np.where(free[..., None, None], np.eye(len(others)), inner)
    return S - np.swapaxes(cross, -1, -2) @ np.linalg.solve(inner, cross), free


@dataclass(frozen=True)
class Allowed:
    """For each pair of forms the values that stay below its bound."""

    low: PerPoint
    high: PerPoint
    outside: Bool[np.ndarray, " k"]

    def pieces(self) -> list[tuple[float, float]]:
        """Union over pairs that follow one another closely, whose bounded intervals join to one."""
        inside = self._bounded
        result = [(-inf, inf)] if np.isinf(self.low).any() else []
        if inside.any():
            result.append((float(self.low[inside].min()), float(self.high[inside].max())))
        if self.outside.any():
            result.append((-inf, float(self.low[self.outside].max())))
            result.append((float(self.high[self.outside].min()), inf))
        return result

    def continued(self) -> list[tuple[float, float]]:
        """Union where pairs would go on after the last: without a bound on the side they move to."""
        inside = np.flatnonzero(self._bounded)
        if not inside.size:
            return self.pieces()
        first, last = (self.low[index] + self.high[index] for index in inside[[0, -1]])
        ends = float(self.low[inside].min()), float(self.high[inside].max())
        moving = (ends[0], inf) if last >= first else (-inf, ends[1])
        return [moving if piece == ends else piece for piece in self.pieces()]

    @property
    def _bounded(self) -> Bool[np.ndarray, " k"]:
        return np.isfinite(self.low) & np.isfinite(self.high) & ~self.outside


def allowed(Q: Float[np.ndarray, "k m m"], position: int) -> Allowed:
    """Values of one variable, the first being one, at which a form is at most zero, least over the others."""
    S, free = concentrated(Q, [0, position])
    a, half, c = S[:, 1, 1], S[:, 0, 1], S[:, 0, 0]
    square = half**2 - a * c
    free |= (a <= 0.0) & (square <= 0.0)
    none = ~free & (square < 0.0)
    # the root that does not cancel, and the other one by their product
    larger = half + np.where(half < 0.0, -1.0, 1.0) * np.sqrt(np.maximum(square, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([larger / a, np.where(larger != 0.0, c / larger, 0.0)])
    low, high = roots.min(axis=0), roots.max(axis=0)
    low, high = np.where(free, -inf, low), np.where(free, inf, high)
    outside = (a < 0.0) & ~free
    return Allowed(np.where(none, np.nan, low), np.where(none, np.nan, high), outside)


#: Rows whose signs are drawn at a time; the signs depend on it, so it is part of what a seed means.
SIGN_ROWS = 4096
#: Points ranked at a time.
RANKED_POINTS = 256
#: Squared lengths count as equal within this share, and below what rounding leaves of cancelled sums.
TIE_SHARE = 1e-10
ROUNDING = 1e-13


@dataclass(frozen=True)
class SignPerturbedShape(RegionShape):
    """Region of the rank of the unperturbed sum."""

    sums: Float[np.ndarray, "m p n_plus_1"]  # S_i as matrices that multiply x, shaped
    excluded: int
    order: Int[np.ndarray, " m"]  # Random order by which ties are broken

    @cached_property
    def _differences(self) -> Float[np.ndarray, "m_less_1 n_plus_1 n_plus_1"]:
        """|S_0 x|^2 - |S_i x|^2 as quadratic forms."""
        forms = np.einsum("ipa,ipb->iab", self.sums, self.sums)
        return forms[0] - forms[1:]

    @cached_property
    def _largest(self) -> float:
        return float(np.einsum("ipa,ipa->ia", self.sums, self.sums).max())

    def excess(self, points: Points) -> PerPoint:
        """|S_0|^2 over the q-th largest of the others, nudged off one where a tie decides."""
        result = np.empty(points.shape[0])
        for start in range(0, points.shape[0], RANKED_POINTS):
            block = slice(start, start + RANKED_POINTS)
            S = np.einsum("ipa,ka->kip", self.sums, points[block])
            lengths = np.einsum("kip,kip->ki", S, S)
            size = np.einsum("ka,ka->k", points[block], points[block])
            rounding = ROUNDING**2 * self._largest * size[:, None]
            length, others = lengths[:, :1], lengths[:, 1:]
            tied = np.abs(others - length) <= TIE_SHARE * np.maximum(length, others) + rounding
            shorter = np.where(tied, self.order[1:] < self.order[0], others < length).sum(axis=1)
            inside = shorter < lengths.shape[1] - self.excluded
            bound = np.partition(others, others.shape[1] - self.excluded, axis=1)[:, -self.excluded]
            ratio = np.divide(length[:, 0], bound, out=np.full(bound.size, np.inf), where=bound > 0.0)
            above = np.nextafter(1.0, 2.0)
            result[block] = np.where(inside, np.minimum(ratio, 1.0), np.maximum(ratio, above))
        return result

    def along(self, base: Point, step: Point) -> ConfidenceSet:
        """Members on a line: a rival is shorter where a quadratic is positive, whose roots are the ends."""
        D = self._differences
        a, b, c = (np.einsum("a,iab,b->i", u, D, v) for u, v in ((step, step), (base, step), (base, base)))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # without cancellation
            larger = -(b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(b * b - a * c))
            roots = np.concatenate([larger / a, c / larger])
        return self.members(base, step, roots)


def excluded_sums(level: float, sums: int) -> int:
    """Return q such that 1 - q/m is the level."""
    from fractions import Fraction  # late: few sets are counted

    excluded = (1 - Fraction(level).limit_denominator(10**6)) * sums
    if not (0.0 < level < 1.0 and excluded.denominator == 1 and 1 <= excluded < sums):
        expected = "a level between 0 and 1 of which (1 - level) times the number of sums is a whole number"
        remedy = "Use level=0.95 with sums=100, or 0.99 with 200, for example."
        raise ParameterError(expected, f"level={level}, sums={sums}", remedy)
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
    """Region by sign perturbation."""
    excluded = excluded_sums(level, sums)
    rows, p = instruments.shape
    collinear = CollinearError(
        "independent instruments", "one that is a combination of others", "Leave it out."
    )
    root = _triangular_root(instruments, collinear)
    order = rng.permutation(sums)
    solution, scale = _solution(scipy.linalg.solve_triangular(root, instruments.T @ columns, lower=True))
    residual = columns[:, 0] - columns[:, 1:] @ solution
    std = float(np.sqrt(residual @ residual / residual.size))
    frame = RegionFrame(solution, (std or 1.0) * scale)
    framed = columns @ _to_frame(frame)
    total = np.zeros((sums, p * framed.shape[1]))
    for start in range(0, rows, SIGN_ROWS):
        psi, z = instruments[start : start + SIGN_ROWS], framed[start : start + SIGN_ROWS]
        products = (psi[:, :, None] * z[:, None, :]).reshape(psi.shape[0], -1)
        signs = np.ones((sums, psi.shape[0]))
        signs[1:] -= 2.0 * rng.integers(0, 2, size=(sums - 1, psi.shape[0]), dtype=np.int8)
        total += signs @ products
    by_equation = total.reshape(sums, p, -1).transpose(1, 0, 2).reshape(p, -1)
    shaped = scipy.linalg.solve_triangular(root, by_equation, lower=True)
    stacked = shaped.reshape(p, sums, -1).transpose(1, 0, 2)
    return ConfidenceRegion(names, frame, SignPerturbedShape(np.ascontiguousarray(stacked), excluded, order))
