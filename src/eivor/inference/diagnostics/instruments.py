"""Diagnostics of instruments: strength, endogeneity and over-identification."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from eivor.inference.covariance import cosine_averages, cosine_covariance, unit_scale
from eivor.inference.diagnostics import record
from eivor.inference.distributions import chi_square_tail
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import orthogonal_factors, symmetric_eigen
from eivor.tools import Float

#: Directions in which P differs from its projection on the columns by less than this share are no test.
NO_DIFFERENCE = 1e-9
#: Bias of least squares, in standard errors of the estimate, that is worth a word.
NOTABLE_BIAS = 0.5


@dataclass(frozen=True)
class Endogeneity(record.Diagnostic):
    """Least squares, or another direct estimate, against the estimate."""

    difference: Float[np.ndarray, " n"]  # Estimate minus least squares, to first order
    degrees: int  # Endogenous directions that are tested
    statistic: float
    p_value: float
    durbin: float
    durbin_p_value: float
    wu: float
    wu_p_value: float

    def notable(self, bias: float) -> bool:
        """Whether a bias of least squares, in standard errors of the estimate, is worth a word."""
        return bool(self.p_value < record.SIGNIFICANT and abs(bias) > NOTABLE_BIAS)

    def rows(self, subject: record.Subject, /) -> Iterator[record.Row]:
        line = f"endogeneity          {self.statistic:>10.4g}  p-value {self.p_value:.3g}"
        yield record.Row("endogeneity", "", self.statistic, self.p_value, line)
        for name, value in zip(subject.names, self.difference, strict=True):
            yield record.Row("less_least_squares", name, float(value), None)

    def reasons(self, subject: record.Subject, /) -> Iterator[Reason]:
        separated = -self.difference / subject.std_errors
        j = int(np.argmax(np.abs(separated)))
        if self.notable(separated[j]):
            yield Reason(
                Status.IDENTIFIED,
                f"Least squares would be biased here: {subject.names[j]} by {separated[j]:+.1f} standard "
                f"errors (p-value {self.p_value:.1g}).",
                "Keep the instruments.",
            )


@dataclass(frozen=True, slots=True)
class DirectScores:
    """Scores G e + v e^2 + k of a direct estimate, which sum to zero at it."""

    difference: Float[np.ndarray, " n"]
    pull: Float[np.ndarray, " n"]
    constant: Float[np.ndarray, " n"]
    sensitivity: Float[np.ndarray, "n n"]  # H, minus the derivative of the scores' sum


def endogeneity(
    products: record.EquationProducts, weights: Float[np.ndarray, "p n"], direct: DirectScores | None = None
) -> Endogeneity | None:
    """Test of a direct estimate, by default of least squares, against an instrumental one; no checks."""
    GG = products.count * products.regressor_mean
    scale = unit_scale(GG.diagonal())
    square = scale[:, None] * scale
    GG = square * GG  # columns of unit length: gamma and M are in their units
    if direct is None:
        total = products.count * products.mean[products.tested : -1, -1]
        gamma = np.linalg.lstsq(GG, scale * total, rcond=None)[0]
        zero = np.zeros(gamma.size)
        direct = DirectScores(gamma * scale, zero, zero, GG / square)
    gamma, H = direct.difference / scale, square * direct.sensitivity
    weights = weights * unit_scale((weights * (products.instrument_mean @ weights)).sum(axis=0))
    M = products.count * weights.T @ products.sensitivity * scale
    D = np.linalg.lstsq(H.T, M.T, rcond=None)[0]
    residual = np.append(-direct.difference, 1.0)  # of the direct estimate, as a combination of [G e]
    h = (products.equations @ residual) @ weights
    h += products.counts[:, None] * ((products.constant + products.shared @ direct.difference) @ weights)
    columns = products.columns @ residual
    power = columns @ residual
    s = columns[:, :-1] + power[:, None] * direct.pull + products.counts[:, None] * direct.constant
    h -= (scale * s) @ D
    PG = (products.count * weights.T @ products.mean[: products.tested, products.tested : -1]) * scale
    spread = products.count * weights.T @ products.instrument_mean @ weights
    spread += D.T @ GG @ D - PG @ D - (PG @ D).T
    values, vectors = symmetric_eigen(spread / products.count)
    U = vectors[:, values > NO_DIFFERENCE]
    degrees = U.shape[1]
    if not degrees:
        return None
    B = record.joint_averages(degrees, products.counts.size)
    h = h @ U
    total = h.sum(axis=0)
    statistic = record.quadratic_form(total, cosine_covariance([h], len(h), B))
    rows = products.rows
    durbin = record.quadratic_form(total, float(power.sum()) / rows * (U.T @ spread @ U))
    freedom = rows - gamma.size - degrees
    wu = durbin / (rows - durbin) * freedom / degrees if durbin < rows else float("inf")
    return Endogeneity(
        -scale * gamma,
        degrees,
        statistic,
        record.hotelling_p_value(statistic, degrees, B),
        durbin,
        chi_square_tail(durbin, degrees),
        wu,
        float(scipy.special.fdtrc(degrees, freedom, wu)),
    )


@dataclass(frozen=True)
class OverIdentification(record.Diagnostic):
    """Hansen's J."""

    J: float
    degrees: float  # Equations that are left over; unknowns that are determined in part count in part
    p_value: float

    @property
    def outcome(self) -> str:
        return record.outcome_word(self.p_value, ("agree", "may disagree", "disagree"))

    def rows(self, _subject: record.Subject, /) -> Iterator[record.Row]:
        on = f"Hansen's J on {self.degrees:.3g} degrees, p-value {self.p_value:.3g}"
        line = f"over-identification  {self.J:>10.4g}  {on}"
        yield record.Row("over_identification_J", "", self.J, self.p_value, line)

    def reasons(self, _subject: record.Subject, /) -> Iterator[Reason]:
        if self.p_value < record.SIGNIFICANT:
            yield Reason(
                Status.WEAK,
                f"The instruments {self.outcome} about the parameters (J {self.J:.3g} on {self.degrees:.3g} "
                f"degrees, p-value {self.p_value:.1g}): one of them is not exogenous, a declared noise is "
                "wrong, or the model lacks a term.",
                "Leave out the most recent lags, check the declared noise, or add the term.",
            )


def hansen_j(
    equations: Float[np.ndarray, " p"],
    sensitivity: Float[np.ndarray, "p n"],
    covariance: Float[np.ndarray, "p p"],
    count: int | float,
    averages: int | None = None,
) -> OverIdentification:
    """J of equations with any weight. Performs no checks."""
    scale = unit_scale(covariance.diagonal())
    unknowns = sensitivity.shape[1]
    free = np.linalg.qr(scale[:, None] * sensitivity, mode="complete")[0][:, unknowns:]
    degrees = free.shape[1]
    if not degrees:
        return OverIdentification(0.0, 0, 1.0)
    residual = free.T @ (scale * equations)
    S = free.T @ (scale[:, None] * covariance * scale) @ free
    J = count * record.quadratic_form(residual, S)
    return OverIdentification(J, degrees, record.hotelling_p_value(J, degrees, averages))


def robust_over_identification(products: record.EquationProducts) -> OverIdentification:
    """J with a weight that allows for autocorrelation, from the products at an estimate."""
    T, sums = products.whitening, products.equation_sums
    degrees = max(T.shape[1] - products.sensitivity.shape[1], 0)
    B = record.joint_averages(degrees, products.counts.size)
    S = cosine_covariance([sums @ T], len(sums), B) / products.count
    mean = T.T @ (sums.sum(axis=0) / products.count)
    return hansen_j(mean, T.T @ products.sensitivity, S, products.count, B)


#: Conditional first-stage F below which instruments are weak.
STRONG_FIRST_STAGE = 10.0
#: Bias, as a share of its worst case, that critical values are for, and the size of their test.
TOLERATED_BIAS = 0.1
SIZE = 0.05
#: A column is exogenous when no more than this share of its power is left unexplained.
UNEXPLAINED = 1e-10


@dataclass(frozen=True)
class FirstStageTest(record.Diagnostic):
    """Strength of instruments."""

    conditional: Float[np.ndarray, " n"]
    effective: Float[np.ndarray, " n"]  # The same, robust
    critical: Float[np.ndarray, " n"]
    partial_r_squared: Float[np.ndarray, " n"]
    shea_r_squared: Float[np.ndarray, " n"]
    cragg_donald: float  # Smallest eigenvalue for white errors
    smallest_eigenvalue: float
    smallest_critical: float

    def rows(self, subject: record.Subject, /) -> Iterator[record.Row]:
        for j, name in enumerate(subject.names):
            F, effective, critical = (
                float(values[j]) for values in (self.conditional, self.effective, self.critical)
            )
            line = f"first-stage F        {F:>10.4g}  {name} (needed: {STRONG_FIRST_STAGE:.0f})"
            yield record.Row("first_stage_F", name, F, STRONG_FIRST_STAGE, line)
            line = f"effective F          {effective:>10.4g}  {name} (needed: {critical:.3g})"
            yield record.Row("effective_F", name, effective, critical, line)
            yield record.Row("shea_r_squared", name, float(self.shea_r_squared[j]), None)
        smallest, needed = self.smallest_eigenvalue, self.smallest_critical
        line = f"smallest eigenvalue  {smallest:>10.4g}  needed: {needed:.3g}"
        yield record.Row("smallest_eigenvalue", "", smallest, needed, line)
        yield record.Row("cragg_donald", "", self.cragg_donald, None)

    def reasons(self, subject: record.Subject, /) -> Iterator[Reason]:
        remedy = "Use stronger or more recent instruments, a longer record, or an input that moves more."
        needed = np.where(np.isfinite(self.critical), self.critical, STRONG_FIRST_STAGE)
        weak = np.flatnonzero(self.effective < needed)
        for j in weak:
            yield Reason(
                Status.WEAK,
                f"The instruments hardly move the regressor of {subject.names[j]} once the others are "
                f"accounted for. Effective F is {self.effective[j]:.3g}, and {needed[j]:.3g} is needed for "
                "a bias below a tenth of its worst.",
                remedy,
            )
        if not weak.size and self.smallest_eigenvalue < self.smallest_critical:
            yield Reason(
                Status.WEAK,
                "The instruments move each regressor, but one combination of them hardly: the smallest "
                f"eigenvalue is {self.smallest_eigenvalue:.3g}, {self.smallest_critical:.3g} is needed.",
                remedy,
            )


def strength(
    products: record.EquationProducts, conditional: Float[np.ndarray, " n"] | None = None
) -> FirstStageTest:
    """Strength of the instruments behind time products. Performs no checks."""
    T = products.whitening
    # columns in units of their own rms, so that units cannot pass for strength or collinearity
    scale = unit_scale(products.regressor_mean.diagonal())
    a, shared = T.T @ products.sensitivity * scale, T.T @ products.shared * scale
    R = scale[:, None] * products.regressor_mean * scale
    rank, count = a.shape
    if rank < count:  # some combination of the columns is not moved at all
        zero, unknown = np.zeros(count), np.full(count, np.nan)
        return FirstStageTest(zero, zero, unknown, zero, zero, 0.0, 0.0, float("nan"))
    B = record.joint_averages(rank, products.counts.size)
    # psi (phi - a' T' psi)' of each block, as combinations of the columns of its products
    unexplained = np.vstack([-(T @ a), np.diag(scale), np.zeros(count)])
    blocks, width, _ = products.sums.shape
    scores = (products.sums.reshape(-1, width) @ unexplained).reshape(blocks, width, count)
    scores = scores[:, : products.tested] - products.counts[:, None, None] * (products.shared * scale)
    L = cosine_averages(scores, B).transpose(2, 0, 1) @ (T / np.sqrt(B * products.count))
    cross = a.T @ shared
    residual = R - a.T @ a - cross - cross.T
    directions = record.partial_directions(a)
    projected = directions @ a.T
    explained = (projected * projected).sum(axis=1)
    total, unexplained = (((directions @ matrix) * directions).sum(axis=1) for matrix in (R, residual))
    tested = unexplained > UNEXPLAINED
    white, partial, effective = (np.full(count, x) for x in (np.inf, 1.0, np.inf))
    freedom = (rank - count + 1) / max(products.rows - rank, 1.0)
    np.divide(explained, freedom * unexplained, out=white, where=tested)
    np.divide(explained, total, out=partial, where=tested)
    # each direction of the scores, partialled of the other columns
    basis, projected = orthogonal_factors(a)[0], (projected * unit_scale(explained)[:, None])[:, :, None]
    partial_scores = (directions @ L.reshape(count, -1)).reshape(L.shape)
    partial_scores += partial_scores @ projected @ projected.swapaxes(1, 2) - partial_scores @ basis @ basis.T
    endogenous, sizes = residual.diagonal() > UNEXPLAINED, (products.count, products.rows)
    smallest, robust, worst = _smallest(a, residual, L, endogenous, sizes)
    partial_scores = np.concatenate([partial_scores, worst[None]])
    spreads, critical = critical_values(partial_scores.swapaxes(1, 2) @ partial_scores)
    np.divide(products.count * explained, spreads[:-1], out=effective, where=tested & (spreads[:-1] > 0.0))
    values, vectors = symmetric_eigen(R)
    inverse_diagonal = vectors**2 @ (1.0 / np.maximum(values, np.finfo(np.float64).eps * values[-1]))
    needed = np.where(tested, critical[:-1], np.nan)
    leading = white if conditional is None else conditional, effective, needed, partial
    return FirstStageTest(*leading, inverse_diagonal * explained, smallest, robust, float(critical[-1]))


def _smallest(
    a: Float[np.ndarray, "q n"],
    residual: Float[np.ndarray, "n n"],
    L: Float[np.ndarray, "n averages q"],
    endogenous: np.ndarray,
    sizes: tuple[float, float],
) -> tuple[float, float, Float[np.ndarray, "averages q"]]:
    """Cragg and Donald's F, its robust counterpart, and scores of the combination that hardly moves."""
    (count, rows), rank = sizes, a.shape[0]
    if not endogenous.any():
        return float("inf"), float("inf"), np.zeros(L.shape[1:])
    noise = residual * (count / max(rows - rank, 1.0))
    if not endogenous.all():
        basis, rank = orthogonal_factors(a[:, ~endogenous])[0], rank - int((~endogenous).sum())
        a, L, noise = a[:, endogenous], L[endogenous], noise[endogenous][:, endogenous]
        a, L = a - basis @ (basis.T @ a), L - L @ basis @ basis.T
    power, scores = count * a.T @ a, L.reshape(len(L), -1)
    white, _ = _smallest_eigenvalue(power, rank * noise)
    robust, direction = _smallest_eigenvalue(power, scores @ scores.T)
    return white, robust, (direction @ scores).reshape(L.shape[1:])


def _smallest_eigenvalue(
    power: Float[np.ndarray, "n n"], noise: Float[np.ndarray, "n n"]
) -> tuple[float, Float[np.ndarray, " n"]]:
    values, vectors = symmetric_eigen(noise)
    root = vectors / np.sqrt(np.maximum(values, np.finfo(np.float64).tiny))
    ratios, directions = symmetric_eigen(root.T @ power @ root)
    return float(ratios[0]), root @ directions[:, 0]


def critical_values(
    W: Float[np.ndarray, "some q q"], bias: float = TOLERATED_BIAS, size: float = SIZE
) -> tuple[Float[np.ndarray, " some"], Float[np.ndarray, " some"]]:
    """Trace of W, and the critical value of the effective F, which is NaN where that is no number.

    Simplified procedure of Montiel Olea and Pflueger (2013).
    """
    x, trace = 1.0 / bias, W.trace(axis1=1, axis2=2)
    known, critical = (trace > 0.0) & (trace < np.inf), np.full(len(W), np.nan)
    shares = np.linalg.eigvalsh(W[known] / trace[known, None, None])
    K = (1.0 + 2.0 * x) / ((shares * shares).sum(axis=1) + 2.0 * x * shares[:, -1])
    critical[known] = scipy.special.chndtrix(1.0 - size, K, x * K) / K
    return trace, critical
