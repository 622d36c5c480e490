"""Covariance of columns that live in few rows: slow ones among bins of spectra, such as a battery's voltage.

Cosine averages of the scores make a column in the lowest bins too certain, as half of what is beside it lies
below the band; and the power that whitens the rows is smoothed over more bins than such a column has. Here
every row has its own variance, as the residual tells it, corrected for what the fit took from it (HC3,
MacKinnon and White 1985):

    V = sum_t p_t p_t' e_t^2 / (1 - h_t)^2,   h_t = p_t' (P'P)^-1 p_t.

The variance of a parameter with the influences w_t = (M^-1 p_t)_j is told by nu = (sum w^2)^2 / sum w^4 rows,
and its intervals are those of Student's t on nu degrees of freedom. These differ from parameter to parameter:
their ratio to normal ones, at the level .95, stands in the matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from eivor.inference.covariances.covariance import CovariancePart, sandwich
from eivor.inference.covariances.estimators import FLIGHT_DEFAULT, CovarianceEstimator, Widest
from eivor.inference.estimating_equation import EstimatingEquation
from eivor.inference.quantiles import normal_quantile, t_quantile

#: Leverages above this count as this.
LARGEST_LEVERAGE = 0.9
#: Level at which quantiles of Student's t are held against normal ones.
LEVEL = 0.95


@final
@dataclass(frozen=True, slots=True)
class ByRow(CovarianceEstimator):
    """V = sum p_t p_t' e_t^2 / (1 - h_t)^2 over rows, bins of spectra among them, with t on few rows."""

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """One part; O(rows n^2)."""
        P, e = equation.rows.test_functions, equation.rows.residual
        leverage = np.einsum("tj,jt->t", P, np.linalg.lstsq(P.T @ P, P.T, rcond=None)[0])
        own = P * (e / (1.0 - np.minimum(leverage, LARGEST_LEVERAGE)))[:, None]
        matrix = sandwich(equation.slope, own.T @ own + equation.prior_covariance)
        weights = np.linalg.lstsq(equation.slope, P.T, rcond=None)[0] ** 2
        fourth = (weights**2).sum(axis=1)
        rows = np.divide(weights.sum(axis=1) ** 2, fourth, out=np.ones(fourth.size), where=fourth > 0.0)
        wider = np.array([t_quantile(LEVEL, nu) for nu in rows.tolist()]) / normal_quantile(LEVEL)
        return (CovariancePart("by_row", matrix * np.outer(wider, wider)),)


#: Of a flight with columns that live in few bins: as that of others, and never narrower than row by row.
FEW_ROWS_DEFAULT = Widest((*FLIGHT_DEFAULT.estimators, ByRow()))
