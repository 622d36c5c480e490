"""Long-run covariance from block sums, and how many averages a joint test takes.

The cosines are constant over each block: L_j = sqrt(2/K) sum_k S_k cos(pi j (k - 1/2) / K), j = 1..B, with
S_k the sum of the scores in block k of K. They are orthonormal (a discrete cosine transform) and a
constant drops out, as with the cosines of `long_run_sum_covariance`, which is their limit for many blocks.

A quadratic form of q sums, weighted by the inverse of that covariance, is on B averages

    (B - q + 1) / (B q) W ~ F(q, B - q + 1)

whatever the autocorrelation (Hotelling; Sun 2014). It needs more averages than a single interval does.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from eivor.inference.covariances.covariance import unit_scale
from eivor.inference.covariances.equal_weighted_cosines import cosine_averages
from eivor.inference.quantiles import chi_square_tail
from eivor.shapes import Float

#: Fewest averages, and how many there are for each equation that is tested.
LEAST_AVERAGES = 8
AVERAGES_PER_EQUATION = 3


def joint_averages(equations: int, blocks: int) -> int:
    """Averages for a joint test of `equations`: three for each and at least eight, as blocks permit."""
    return min(max(LEAST_AVERAGES, AVERAGES_PER_EQUATION * equations), blocks // 2)


def covariance_of_total(sums: Float[np.ndarray, "K n"], averages: int) -> Float[np.ndarray, "n n"]:
    """Covariance of the sum over all blocks."""
    L = cosine_averages(sums, averages)
    return L.T @ L / averages


def quadratic_form(total: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> float:
    """Total' covariance^-1 total, without the directions in which a singular covariance says nothing."""
    scale = unit_scale(np.diag(covariance))
    correlation = np.outer(scale, scale) * covariance
    return float((scale * total) @ np.linalg.lstsq(correlation, scale * total, rcond=None)[0])


def hotelling_p_value(W: float, equations: int, averages: int | None) -> float:
    """P-value of a quadratic form on `averages` cosine averages, or with a known weight when None."""
    if equations < 1:
        return 1.0
    if averages is None:
        return chi_square_tail(W, equations)
    degrees = averages - equations + 1
    if degrees < 1:
        return float("nan")
    return float(special.fdtrc(equations, degrees, W * degrees / (averages * equations)))
