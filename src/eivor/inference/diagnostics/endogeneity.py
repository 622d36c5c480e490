"""Whether least squares would have done: Durbin, Wu and Hausman's test, robust to autocorrelation.

Least squares is theta_LS = theta + gamma, gamma = (sum G G')^-1 sum G e. There the equations have the scores

    h_t = P_t e_LS,t + k - M (sum G G')^-1 G_t e_LS,t,   sum_t h_t = M (theta - theta_LS)

where P = psi W A, M = N A'W A, k what the compensation adds, and the last term is what the estimation of
theta_LS does: h_t is M times the difference of both estimates' influence functions. When both are consistent
its sum is zero but for chance, and its long-run covariance is that of the difference. For two-stage least
squares and white errors the statistic is Durbin's (1954), from which Wu's F follows.

Another direct estimate, such as total least squares, has scores s_t of its own and minus their derivative H.
H^-1 s_t then takes the place of (sum G G')^-1 G_t e_LS,t.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.diagnostics.block_cosines import (
    covariance_of_total,
    hotelling_p_value,
    joint_averages,
    quadratic_form,
)
from eivor.inference.diagnostics.diagnostic import SIGNIFICANT, Diagnostic, Row, Subject
from eivor.inference.diagnostics.equation_products import EquationProducts
from eivor.inference.quantiles import chi_square_tail
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Directions in which P differs from its projection on the columns by less than this share are no test.
NO_DIFFERENCE = 1e-9
#: Bias of least squares, in standard errors of the estimate, that is worth a word.
NOTABLE_BIAS = 0.5


@dataclass(frozen=True)
class Endogeneity(Diagnostic):
    """Least squares, or another direct estimate, against the estimate.

    Parameters
    ----------
    difference : ndarray, shape (n,)
        Estimate minus least squares, to first order.
    degrees : int
        Endogenous directions that are tested.
    statistic, p_value : float
        Robust: the quadratic form of the difference, and its tail by Hotelling's F.
    durbin, durbin_p_value : float
        For white errors, chi-square.
    wu, wu_p_value : float
        The same as an F.
    averages : int
        Cosine averages of the long-run covariance.
    """

    difference: Float[np.ndarray, " n"]
    degrees: int
    statistic: float
    p_value: float
    durbin: float
    durbin_p_value: float
    wu: float
    wu_p_value: float
    averages: int

    def notable(self, bias: float) -> bool:
        """Whether a bias of least squares, in standard errors of the estimate, is worth a word."""
        return bool(self.p_value < SIGNIFICANT and abs(bias) > NOTABLE_BIAS)

    def rows(self, of: Subject, /) -> Iterator[Row]:
        """The statistic, and the estimate less least squares."""
        yield Row("endogeneity", "", self.statistic, self.p_value)
        for name, value in zip(of.names, self.difference, strict=True):
            yield Row("less_least_squares", name, float(value), None)

    def lines(self, _of: Subject, /) -> Iterator[str]:
        """The statistic and its p-value."""
        yield f"endogeneity          {self.statistic:>10.4g}  p-value {self.p_value:.3g}"

    def reasons(self, of: Subject, /) -> Iterator[Reason]:
        """Least squares that would be biased."""
        apart = -self.difference / of.std_errors
        j = int(np.argmax(np.abs(apart)))
        if self.notable(apart[j]):
            yield Reason(
                Status.IDENTIFIED,
                f"Least squares would be biased here: {of.names[j]} by {apart[j]:+.1f} standard errors "
                f"(p-value {self.p_value:.1g}).",
                "Keep the instruments.",
            )


@dataclass(frozen=True, slots=True)
class DirectScores:
    """Scores G e + v e^2 + k of a direct estimate, which sum to zero at it.

    Parameters
    ----------
    difference : ndarray, shape (n,)
        Direct estimate minus the instrumental one.
    pull : ndarray, shape (n,)
        v.
    constant : ndarray, shape (n,)
        k of one sample.
    sensitivity : ndarray, shape (n, n)
        H, minus the derivative of the scores' sum.
    """

    difference: Float[np.ndarray, " n"]
    pull: Float[np.ndarray, " n"]
    constant: Float[np.ndarray, " n"]
    sensitivity: Float[np.ndarray, "n n"]


def endogeneity(
    products: EquationProducts,
    weights: Float[np.ndarray, "p n"],
    averages: int | None = None,
    direct: DirectScores | None = None,
) -> Endogeneity | None:
    """Test of a direct estimate against an instrumental one. Performs no checks.

    Parameters
    ----------
    products : EquationProducts
        At the estimate.
    weights : ndarray, shape (p, n)
        W A: the combinations of the equations that the estimate solves.
    averages : int, optional
        Cosine averages. Default: three for each endogenous direction, at least eight.
    direct : DirectScores, optional
        The direct estimate that is tested. Default: least squares. Durbin's and Wu's statistics are of that.

    Returns
    -------
    Endogeneity or None
        None when the test functions are combinations of the columns: the estimate is least squares, or
        differs from it by the compensation alone.
    """
    GG = np.asarray(products.regressors.sum(axis=0))
    scale = unit_scale(np.diag(GG))
    GG = np.outer(scale, scale) * GG  # columns of unit length: gamma and M are in their units
    if direct is None:
        gamma = np.linalg.lstsq(GG, scale * products.regressor_residual.sum(axis=0), rcond=None)[0]
        H = GG
    else:
        gamma = direct.difference / scale
        H = np.outer(scale, scale) * direct.sensitivity
    weights = weights * unit_scale(np.einsum("pj,pq,qj->j", weights, products.instrument_mean, weights))
    M = products.count * weights.T @ products.sensitivity * scale
    D = np.linalg.lstsq(H.T, M.T, rcond=None)[0]
    cross, shared = products.cross * scale, products.shared * scale
    h = (products.residual - cross @ gamma) @ weights
    h += products.counts[:, None] * ((products.constant + shared @ gamma) @ weights)
    regressors = products.regressors * np.outer(scale, scale)
    s = products.regressor_residual * scale - regressors @ gamma
    left = float(products.power.sum()) - float(gamma @ GG @ gamma)  # of least squares
    if direct is not None:
        power = products.power - 2.0 * (products.regressor_residual * scale) @ gamma
        power += np.einsum("i,kij,j->k", gamma, regressors, gamma)
        left = float(power.sum())
        s += scale * (power[:, None] * direct.pull + products.counts[:, None] * direct.constant)
    h -= s @ D
    PG = weights.T @ cross.sum(axis=0)
    spread = weights.T @ products.instruments.sum(axis=0) @ weights - PG @ D - (PG @ D).T + D.T @ GG @ D
    values, vectors = np.linalg.eigh(spread / products.count)
    U = vectors[:, values > NO_DIFFERENCE]
    degrees = U.shape[1]
    if not degrees:
        return None
    B = joint_averages(degrees, products.counts.size) if averages is None else averages
    h = h @ U
    total = h.sum(axis=0)
    statistic = quadratic_form(total, covariance_of_total(h, B))
    rows = products.row_count
    durbin = quadratic_form(total, left / rows * (U.T @ spread @ U))
    freedom = rows - gamma.size - degrees
    wu = durbin / (rows - durbin) * freedom / degrees if durbin < rows else float("inf")
    return Endogeneity(
        -scale * gamma,
        degrees,
        statistic,
        hotelling_p_value(statistic, degrees, B),
        durbin,
        chi_square_tail(durbin, degrees),
        wu,
        float(special.fdtrc(degrees, freedom, wu)),
        B,
    )
