"""How strongly the instruments move the regressors, robust to autocorrelation, compensated or not.

Notation: T whitens the instruments, T' mean(psi psi') T = 1; a = T'A with A = mean(psi G') - C; first-stage
residual v = G - a'T'psi, whose products with T'psi are T'C on average.

* One column given the others: d takes from column j what the others explain of it, d_j = 1 and
  a_-j' a d = 0; M projects on what is orthogonal to a_-j. The effective F of Montiel Olea and
  Pflueger (2013) is

      F_eff = N |a d|^2 / tr(M S M),   S the long-run covariance of T'(psi v'd - C d)

  which under white errors is the F of Sanderson and Windmeijer (2016).
* All endogenous columns: the smallest eigenvalue of N Phi^-1/2 a'M a Phi^-1/2, M orthogonal to the exogenous
  columns. With Phi the covariance of v times the number of instruments it is the F of Cragg and Donald
  (1993); with Phi_ij = tr(M S_ij M) the generalised statistic of Lewis and Mertens (2022).

In compensated equations the noise that instruments and regressors share would pass for strength: a channel
that is nothing but noise moves itself. It is taken out of A, and the products whose covariance S is are
centred by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.covariances.equal_weighted_cosines import cosine_averages
from eivor.inference.diagnostics.block_cosines import joint_averages
from eivor.inference.diagnostics.diagnostic import Diagnostic, Row, Subject
from eivor.inference.diagnostics.equation_products import EquationProducts
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Conditional first-stage F below which instruments are weak.
STRONG_FIRST_STAGE = 10.0
#: Bias, as a share of its worst case, that critical values are for, and the size of their test.
TOLERATED_BIAS = 0.1
SIZE = 0.05
#: A column is exogenous when no more than this share of its power is left unexplained.
UNEXPLAINED = 1e-10


@dataclass(frozen=True)
class Strength(Diagnostic):
    """Strength of instruments.

    Parameters
    ----------
    conditional : ndarray, shape (n,)
        First-stage F of each column given the others, for white errors (Sanderson and Windmeijer 2016): what
        a verdict holds against ten.
    effective : ndarray, shape (n,)
        The same, robust; infinite when they are all their own instruments.
    critical : ndarray, shape (n,)
        Value that `effective` exceeds with probability .05 when the bias is a tenth of the worst case.
    partial_r_squared : ndarray, shape (n,)
        Share of the column, given the others, that the instruments explain.
    shea_r_squared : ndarray, shape (n,)
        Shea (1997): squared standard error of least squares over that of two-stage least squares.
    cragg_donald : float
        Smallest eigenvalue for white errors; infinite when every column is its own instrument.
    smallest_eigenvalue, smallest_critical : float
        The robust one, and the critical value of the effective F in its direction.
    averages : int
        Cosine averages of the long-run covariance; 0 when there are fewer instruments than columns, which
        have no strength then.
    """

    conditional: Float[np.ndarray, " n"]
    effective: Float[np.ndarray, " n"]
    critical: Float[np.ndarray, " n"]
    partial_r_squared: Float[np.ndarray, " n"]
    shea_r_squared: Float[np.ndarray, " n"]
    cragg_donald: float
    smallest_eigenvalue: float
    smallest_critical: float
    averages: int

    def rows(self, of: Subject, /) -> Iterator[Row]:
        """Every F with what it needs, and the shares of variance."""
        for j, name in enumerate(of.names):
            yield Row("first_stage_F", name, float(self.conditional[j]), STRONG_FIRST_STAGE)
            yield Row("effective_F", name, float(self.effective[j]), float(self.critical[j]))
            yield Row("shea_r_squared", name, float(self.shea_r_squared[j]), None)
        yield Row("smallest_eigenvalue", "", self.smallest_eigenvalue, self.smallest_critical)
        yield Row("cragg_donald", "", self.cragg_donald, None)

    def lines(self, of: Subject, /) -> Iterator[str]:
        """Both F of each parameter, and the smallest eigenvalue."""
        for j, name in enumerate(of.names):
            needed = f"{STRONG_FIRST_STAGE:.0f}"
            yield f"first-stage F        {self.conditional[j]:>10.4g}  {name} (needed: {needed})"
            yield f"effective F          {self.effective[j]:>10.4g}  {name} (needed: {self.critical[j]:.3g})"
        yield f"smallest eigenvalue  {self.smallest_eigenvalue:>10.4g}  needed: {self.smallest_critical:.3g}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """Parameters, or one combination of them, that the instruments hardly move."""
        remedy = "Use stronger or more recent instruments, a longer record, or an input that moves more."
        needed = np.where(np.isfinite(self.critical), self.critical, STRONG_FIRST_STAGE)
        weak = np.flatnonzero(self.effective < needed)
        for j in weak:
            yield Reason(
                Status.WEAK,
                f"The instruments hardly move the regressor of {of.names[j]} once the others are accounted "
                f"for: effective F is {self.effective[j]:.3g}, and {needed[j]:.3g} is needed for "
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
    products: EquationProducts,
    averages: int | None = None,
    conditional: Float[np.ndarray, " n"] | None = None,
) -> Strength:
    """Strength of the instruments behind time products. Performs no checks.

    Parameters
    ----------
    products : EquationProducts
        Of at least as many independent instruments as columns.
    averages : int, optional
        Cosine averages of S. Default: three for each instrument.
    conditional : ndarray, shape (n,), optional
        Conditional first-stage F, where it was made of the rows, which keeps more digits than their products.
    """
    T = products.whitening
    # columns in units of their own rms, so that units cannot pass for strength or collinearity
    scale = unit_scale(np.diag(products.regressor_mean))
    a, shared = T.T @ products.sensitivity * scale, T.T @ products.shared * scale
    R = np.outer(scale, scale) * products.regressor_mean
    rank, count = a.shape
    if rank < count:  # some combination of the columns is not moved at all
        nothing, unknown = np.zeros(count), np.full(count, np.nan)
        return Strength(nothing, nothing, unknown, nothing, nothing, 0.0, 0.0, float("nan"), 0)
    B = joint_averages(rank, products.counts.size) if averages is None else averages
    scores = T.T @ (products.cross * scale - products.instruments @ (T @ a))
    scores = scores - products.counts[:, None, None] * shared
    L = cosine_averages(scores, B) / np.sqrt(B * products.count)
    cross = a.T @ shared
    residual = R - a.T @ a - cross - cross.T
    sizes = (products.count, products.row_count)
    found = np.array([_conditional(j, a, R, residual, L, sizes) for j in range(count)])
    least_squares = np.diag(np.linalg.pinv(R, hermitian=True))
    two_stage = np.diag(np.linalg.pinv(a.T @ a, hermitian=True))
    endogenous = np.diag(residual) > UNEXPLAINED
    return Strength(
        found[:, 2] if conditional is None else conditional,
        found[:, 0],
        found[:, 1],
        found[:, 3],
        least_squares / two_stage,
        *_smallest(a, residual, L, endogenous, sizes),
        B,
    )


def _conditional(
    j: int,
    a: Float[np.ndarray, "q n"],
    R: Float[np.ndarray, "n n"],
    residual: Float[np.ndarray, "n n"],
    L: Float[np.ndarray, "averages q n"],
    sizes: tuple[float, float],
) -> tuple[float, float, float, float]:
    """Effective F, its critical value, white F and partial R2 of column j given the others.

    Means are over the samples, degrees of freedom are counted in rows: `sizes` has both.
    """
    (count, rows), (rank, unknowns) = sizes, a.shape
    direction = np.zeros(unknowns)
    others = np.arange(unknowns) != j
    direction[j] = 1.0
    direction[others] = -np.linalg.lstsq(a[:, others], a[:, j], rcond=None)[0]
    explained = float(np.sum((a @ direction) ** 2))
    total = float(direction @ R @ direction)
    unexplained = float(direction @ residual @ direction)
    freedom = rank - unknowns + 1
    if unexplained <= UNEXPLAINED:
        return float("inf"), float("nan"), float("inf"), 1.0
    white = explained / freedom * max(rows - rank, 1.0) / unexplained
    free = (L @ direction) @ _complement(a[:, others])
    trace = float(np.sum(free**2))
    effective = count * explained / trace if trace > 0.0 else float("inf")
    return effective, critical_value(free.T @ free), white, explained / total


def _smallest(
    a: Float[np.ndarray, "q n"],
    residual: Float[np.ndarray, "n n"],
    L: Float[np.ndarray, "averages q n"],
    endogenous: np.ndarray,
    sizes: tuple[float, float],
) -> tuple[float, float, float]:
    """Cragg and Donald's F, its robust counterpart and the critical value of that; see `_conditional`."""
    count, rows = sizes
    if not endogenous.any():
        return float("inf"), float("inf"), float("nan")
    free = _complement(a[:, ~endogenous])
    signal = free.T @ a[:, endogenous]
    power = count * signal.T @ signal
    noise = residual[np.ix_(endogenous, endogenous)] * count / max(rows - a.shape[0], 1.0)
    white, _ = _least_eigenvalue(power, free.shape[1] * noise)
    L_free = np.einsum("bqe,qf->bfe", L[:, :, endogenous], free)
    robust, direction = _least_eigenvalue(power, np.einsum("bfe,bfg->eg", L_free, L_free))
    worst = L_free @ direction
    return white, robust, critical_value(worst.T @ worst)


def _complement(columns: Float[np.ndarray, "q m"]) -> Float[np.ndarray, "q f"]:
    """Orthonormal basis of what is orthogonal to the columns, which are independent."""
    complete: Float[np.ndarray, "q q"] = np.linalg.qr(columns, mode="complete")[0]
    return complete[:, columns.shape[1] :]


def _least_eigenvalue(
    power: Float[np.ndarray, "n n"], noise: Float[np.ndarray, "n n"]
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Least ratio of two quadratic forms, and where it is taken."""
    values, vectors = np.linalg.eigh(noise)
    root = vectors / np.sqrt(np.maximum(values, np.finfo(np.float64).tiny))
    ratios, directions = np.linalg.eigh(root.T @ power @ root)
    return float(ratios[0]), root @ directions[:, 0]


def critical_value(W: Float[np.ndarray, "q q"], bias: float = TOLERATED_BIAS, size: float = SIZE) -> float:
    """Critical value of the effective F, simplified procedure of Montiel Olea and Pflueger (2013).

    The 1 - `size` quantile of a noncentral chi-square over its degrees of freedom,
    K = tr(W)^2 (1 + 2x) / (tr(W^2) + 2 x tr(W) maxeig(W)), noncentrality x K, x = 1 / `bias`.
    23.1 with one instrument and a tenth of the worst bias.
    """
    x = 1.0 / bias
    eigenvalues = np.linalg.eigvalsh(W)
    trace = float(eigenvalues.sum())
    if not trace > 0.0:
        return float("nan")
    K = trace**2 * (1.0 + 2.0 * x) / (float(eigenvalues @ eigenvalues) + 2.0 * x * trace * eigenvalues[-1])
    return float(special.chndtrix(1.0 - size, K, x * K)) / K
