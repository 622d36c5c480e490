"""Regions that invert the Anderson-Rubin test: they hold however weak the instruments are.

At the true parameters the moment equations have mean zero, whether or not the instruments move the
regressors. The test of that, inverted, gives a region that covers with its level in every case, and that
is unbounded when the data do not tell the parameters (Anderson and Rubin 1949; Stock and Wright 2000).

Notation: x = (1; -theta), Z = [y Phi], G x = sum psi_t (y_t - phi_t' theta) + rows (C theta - c).

* `RobustShape`: AR = (G x)' V(x)^-1 (G x), V(x) = 1/B sum_j L_j(x) L_j(x)' the equal-weighted cosine
  covariance of the sum of the scores, which are linear in x. The cosine averages are normal, independent
  of each other and of the sum, in large samples, however autocorrelated the errors are, so that AR is
  Hotelling's statistic and AR (B - p + 1)/(p B) has the distribution F(p, B - p + 1) (Sun 2013; Lazarus,
  Lewis, Stock and Watson 2018).
* `HomoskedasticShape`: AR = (x'Z'P Z x / p) / (x'Z'(I - P)Z x / (rows - p)), F(p, rows - p): exact with
  normal white errors independent of the instruments. A quadratic inequality in theta, so that every set
  is known in closed form (Dufour and Taamouti 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy import special

from eivor.errors import CollinearError, TooFewSamplesError
from eivor.inference.sets.confidence_region import (
    ConfidenceRegion,
    Points,
    RegionFrame,
    RegionShape,
    scanned_shadow,
)
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.inference.sets.ellipse import hotelling_quantile
from eivor.shapes import Float

#: Cosine averages B = RATE rows^(2/3) (Lazarus et al. 2018), and at least so many for each equation.
AVERAGES_RATE = 0.4
AVERAGES_PER_EQUATION = 2
#: Eigenvalues count as real up to this share of their size: they only propose ends, membership decides.
REAL_SHARE = 1e-3
#: Variances below this share of all equations' together are lost in rounding, and are taken as this large.
SMALLEST_SHARE = 1e-13


@dataclass(frozen=True)
class LinearScores:
    """Sums and cosine averages of scores that are linear in (1; -theta).

    Parameters
    ----------
    total : ndarray, shape (p, n + 1)
        G: sums over the rows, the constants of compensated equations among them.
    cosines : ndarray, shape (B, p, n + 1)
        L_j = sqrt(2 samples) times the mean of the scores times cos(pi j (t - 1/2) / samples): their
        mean square estimates the covariance of the sum.
    """

    total: Float[np.ndarray, "p n_plus_1"]
    cosines: Float[np.ndarray, "averages p n_plus_1"]

    def changed(
        self, equations: Float[np.ndarray, "q p"], unknowns: Float[np.ndarray, "n_plus_1 m"]
    ) -> LinearScores:
        """Equations recombined from the left, columns from the right."""
        return LinearScores(equations @ self.total @ unknowns, equations @ self.cosines @ unknowns)


def averages_for(samples: int, equations: int) -> int:
    """Number of cosine averages B for so many samples and equations.

    Raises
    ------
    TooFewSamplesError
        When there are fewer than four samples for each average.
    """
    averages = max(round(AVERAGES_RATE * samples ** (2.0 / 3.0)), AVERAGES_PER_EQUATION * equations)
    if 4 * averages > samples:
        raise TooFewSamplesError(
            f"at least {4 * averages} samples for {equations} moment equations",
            f"{samples}",
            "Give a longer record, or fewer instruments.",
        )
    return averages


@dataclass(frozen=True)
class RobustShape(RegionShape):
    """Region of the autocorrelation-robust test, in coordinates in which V is the identity at the pivot.

    Parameters
    ----------
    scores : LinearScores
        In these coordinates; signs such that (1; theta) multiplies it.
    critical : float
        Value that AR must not exceed.
    """

    scores: LinearScores
    critical: float

    @property
    def unknowns(self) -> int:
        """Number of parameters."""
        return self.scores.total.shape[1] - 1

    @cached_property
    def _covariances(self) -> Float[np.ndarray, "n_plus_1 n_plus_1 p p"]:
        """V_ab with V(x) = sum_ab x_a x_b V_ab."""
        L = self.scores.cosines
        found: Float[np.ndarray, "n_plus_1 n_plus_1 p p"] = np.einsum("jpa,jqb->abpq", L, L) / L.shape[0]
        return found

    def excess(self, points: Points) -> Float[np.ndarray, " k"]:
        """AR over its critical value; O(p^2 n^2 + p^3) for each point."""
        g = points @ self.scores.total.T
        V = np.tensordot(points[:, :, None] * points[:, None, :], self._covariances, axes=2)
        # Scores of an exact regressor hardly vary far out: AR grows there, and must not be rounding.
        floor = SMALLEST_SHARE * np.trace(V, axis1=1, axis2=2)
        V += np.where(floor > 0.0, floor, 1.0)[:, None, None] * np.eye(V.shape[1])
        solved = np.linalg.solve(V, g[:, :, None])[:, :, 0]
        return np.einsum("kp,kp->k", g, solved) / self.critical

    def along(
        self, base: Float[np.ndarray, " n_plus_1"], step: Float[np.ndarray, " n_plus_1"]
    ) -> ConfidenceSet:
        """Members on a line: AR = c where the matrix polynomial c V(s) - g(s) g(s)' is singular.

        Its 2p eigenvalues hold every end there is; between them one point each decides.
        """
        b, d = self.scores.total @ base, self.scores.total @ step
        c = self.critical
        M0 = c * self._between(base, base) - np.outer(b, b)
        M1 = 2.0 * c * self._between(base, step) - np.outer(b, d) - np.outer(d, b)
        M2 = c * self._between(step, step) - np.outer(d, d)
        ends = _real_eigenvalues(M0, M1, M2)
        return ConfidenceSet.from_membership(
            lambda values: self.excess(base + values[:, None] * step) <= 1.0, ends
        )

    def shadow(self, axis: int) -> ConfidenceSet:
        """Scanned; see `scanned_shadow`."""
        return scanned_shadow(self, axis)

    def _between(
        self, one: Float[np.ndarray, " n_plus_1"], other: Float[np.ndarray, " n_plus_1"]
    ) -> Float[np.ndarray, "p p"]:
        V = np.einsum("a,b,abpq->pq", one, other, self._covariances)
        return 0.5 * (V + V.T)


@dataclass(frozen=True)
class HomoskedasticShape(RegionShape):
    """Region of the classical test, a quadratic inequality.

    Parameters
    ----------
    explained, unexplained : ndarray, shape (n + 1, n + 1)
        Z'P Z and Z'(I - P)Z in coordinates in which (1; theta) multiplies them.
    critical : float
        Ratio that they must not exceed for the joint region.
    shadow_critical : float
        The same for one parameter with the others concentrated out.
    """

    explained: Float[np.ndarray, "m m"]
    unexplained: Float[np.ndarray, "m m"]
    critical: float
    shadow_critical: float

    @property
    def unknowns(self) -> int:
        """Number of parameters."""
        return self.explained.shape[0] - 1

    def excess(self, points: Points) -> Float[np.ndarray, " k"]:
        """AR over its critical value."""
        above = np.einsum("ka,ab,kb->k", points, self.explained, points)
        below = np.einsum("ka,ab,kb->k", points, self.unexplained, points)
        return above / (self.critical * below)

    def along(
        self, base: Float[np.ndarray, " n_plus_1"], step: Float[np.ndarray, " n_plus_1"]
    ) -> ConfidenceSet:
        """Members on a line, in closed form."""
        Q = self.explained - self.critical * self.unexplained
        return ConfidenceSet.from_quadratic(
            float(step @ Q @ step), float(2.0 * (base @ Q @ step)), float(base @ Q @ base)
        )

    def shadow(self, axis: int) -> ConfidenceSet:
        """Values that some x of the other parameters passes the test with, in closed form."""
        Q = self.explained - self.shadow_critical * self.unexplained
        others = [i for i in range(1, Q.shape[0]) if i != axis]
        kept = [0, axis]
        S = Q[np.ix_(kept, kept)]
        if others:
            inner = Q[np.ix_(others, others)]
            if np.linalg.eigvalsh(inner)[0] <= 0.0:
                # The others can go to infinity at no cost, whatever this one is.
                return ConfidenceSet.whole_line()
            cross = Q[np.ix_(others, kept)]
            S = S - cross.T @ np.linalg.solve(inner, cross)
        return ConfidenceSet.from_quadratic(float(S[1, 1]), float(2.0 * S[0, 1]), float(S[0, 0]))


def robust_region(names: tuple[str, ...], scores: LinearScores, level: float) -> ConfidenceRegion:
    """Autocorrelation-robust region.

    Parameters
    ----------
    names : tuple of str
        Parameters.
    scores : LinearScores
        Of (1; -theta); the equations must be independent.
    level : float
        Confidence level.

    Raises
    ------
    CollinearError
        When the errors do not vary, or the scores of some equations are always the same.
    """
    p, averages = scores.total.shape[0], scores.cosines.shape[0]
    pivot = _weighted_solution(scores.total, np.eye(p))
    root = np.eye(p)
    for _ in range(2):
        at_pivot = scores.cosines @ np.concatenate([[1.0], -pivot])
        root = _triangular_root(at_pivot / np.sqrt(averages))
        pivot = _weighted_solution(scores.total, root)
    frame = RegionFrame(pivot, _standard_errors(scores.total, root))
    whitening = scipy.linalg.solve_triangular(root, np.eye(p), lower=True)
    shape = RobustShape(
        scores.changed(whitening, _to_frame(frame)), hotelling_quantile(level, p, float(averages))
    )
    return ConfidenceRegion(names, frame, shape)


def homoskedastic_region(
    names: tuple[str, ...],
    instruments: Float[np.ndarray, "rows p"],
    columns: Float[np.ndarray, "rows n_plus_1"],
    level: float,
    partialled: int = 0,
) -> ConfidenceRegion:
    """Classical region.

    Parameters
    ----------
    names : tuple of str
        Parameters.
    instruments : ndarray, shape (rows, p)
        Independent columns.
    columns : ndarray, shape (rows, n + 1)
        [y Phi].
    level : float
        Confidence level.
    partialled : int
        Number of exogenous regressors that instruments and columns were freed of.

    Notes
    -----
    One parameter among n has p - n + 1 numerator degrees of freedom instead of p: with the others
    concentrated out the statistic is no larger than in the strongly identified case (Guggenberger,
    Kleibergen, Mavroeidis and Chen 2012; in large samples).

    Raises
    ------
    TooFewSamplesError
        When there are no more rows than instruments.
    CollinearError
        When nothing is left unexplained.
    """
    rows, p = instruments.shape
    n = columns.shape[1] - 1
    Q = np.linalg.qr(instruments)[0]
    inside = Q.T @ columns
    pivot = np.linalg.lstsq(inside[:, 1:], inside[:, 0], rcond=None)[0]
    residual = columns @ np.concatenate([[1.0], -pivot])
    left = residual - Q @ (Q.T @ residual)
    degrees = rows - p - partialled
    if degrees < 1:
        raise TooFewSamplesError(
            f"more than {p + partialled} rows for as many instruments",
            f"{rows}",
            "Give a longer record.",
        )
    variance = float(left @ left) / degrees
    if not variance > np.finfo(np.float64).eps ** 2 * float(columns[:, 0] @ columns[:, 0]):
        raise _no_error()
    scale = np.sqrt(variance) * _standard_errors(inside, np.eye(p))
    frame = RegionFrame(pivot, scale)
    change = _to_frame(frame)
    moved = columns @ change
    inside = Q.T @ moved
    outside = moved - Q @ inside
    shape = HomoskedasticShape(
        inside.T @ inside / variance,
        outside.T @ outside / variance,
        p / degrees * float(special.fdtri(p, degrees, level)),
        (p - n + 1) / degrees * float(special.fdtri(p - n + 1, degrees, level)),
    )
    return ConfidenceRegion(names, frame, shape)


def _to_frame(frame: RegionFrame) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
    """Matrix that takes (1; scaled theta) to (1; -theta)."""
    n = frame.pivot.size
    change = np.zeros((n + 1, n + 1))
    change[0, 0] = 1.0
    change[1:, 0] = -frame.pivot
    change[1:, 1:] = -np.diag(frame.scale)
    return change


def _weighted_solution(
    total: Float[np.ndarray, "p n_plus_1"], root: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, " n"]:
    weighted = scipy.linalg.solve_triangular(root, total, lower=True)
    lengths = np.linalg.norm(weighted[:, 1:], axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    solution: Float[np.ndarray, " n"] = np.linalg.lstsq(
        weighted[:, 1:] / lengths, weighted[:, 0], rcond=None
    )[0]
    return solution / lengths


def _standard_errors(
    total: Float[np.ndarray, "p n_plus_1"], root: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, " n"]:
    """Standard error of each parameter at the pivot; with the others held where they cannot be told apart."""
    A = scipy.linalg.solve_triangular(root, total[:, 1:], lower=True)
    lengths = np.linalg.norm(A, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    singular, V = np.linalg.svd(A / lengths, full_matrices=False)[1:]
    kept = singular > 1e-8 * singular[0] if singular[0] > 0.0 else np.zeros(singular.size, dtype=np.bool_)
    variance = ((V[kept] / singular[kept, None]) ** 2).sum(axis=0)
    return np.sqrt(np.where(variance > 0.0, variance, 1.0)) / lengths


def _triangular_root(rows: Float[np.ndarray, "averages p"]) -> Float[np.ndarray, "p p"]:
    """Lower triangular L with L L' = rows' rows, by QR.

    Raises
    ------
    CollinearError
        When there is none of full rank.
    """
    root: Float[np.ndarray, "p p"] = np.asarray(np.linalg.qr(rows, mode="r")).T
    lengths = np.linalg.norm(root, axis=1)
    if not lengths.all() or (np.abs(np.diag(root)) < 1e-10 * lengths).any():
        raise _no_error()
    return root


def _real_eigenvalues(
    M0: Float[np.ndarray, "p p"], M1: Float[np.ndarray, "p p"], M2: Float[np.ndarray, "p p"]
) -> list[float]:
    """Real numbers at which M0 + s M1 + s^2 M2 is singular, by its companion pencil, s scaled to size one."""
    p = M0.shape[0]
    one, other = float(np.linalg.norm(M0)), float(np.linalg.norm(M2))
    gamma = np.sqrt(one / other) if one > 0.0 and other > 0.0 else 1.0
    M0, M1, M2 = (M / (one or 1.0) for M in (M0, gamma * M1, gamma**2 * M2))
    eye, zero = np.eye(p), np.zeros((p, p))
    values = scipy.linalg.eigvals(
        np.block([[zero, eye], [-M0, -M1]]), np.block([[eye, zero], [zero, M2]]), check_finite=False
    )
    values = values[np.isfinite(values)]
    real = np.abs(values.imag) <= REAL_SHARE * np.abs(values)
    return [float(value) for value in gamma * values.real[real]]


def _no_error() -> CollinearError:
    return CollinearError(
        "errors that vary, and independent moment equations",
        "equations that hold without any error, or of which one is a combination of others",
        "Leave out instruments that repeat others; data without any error need no confidence set.",
    )
