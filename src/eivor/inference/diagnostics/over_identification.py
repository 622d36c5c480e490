"""Hansen's J: whether the equations agree about the parameters.

Whatever n combinations of the p equations an estimate solves, what is left over is told by the
combinations B that the parameters do not move, B'A = 0:

    J = N (B'g)' (B'S B)^-1 (B'g),   g = mean(psi e) + C theta - c

with S the long-run covariance of the equations' scores. B'g does not depend on theta, so J is the same for
every estimator; it is what two-step GMM weighted by S^-1 attains at its minimum (Hansen 1982), without
that estimate having to be made. Compensated equations enter with the noises' part in g and in the scores.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.inference.diagnostics.block_cosines import (
    covariance_of_total,
    hotelling_p_value,
    joint_averages,
    quadratic_form,
    unit_scale,
)
from eivor.inference.diagnostics.time_products import TimeProducts


@dataclass(frozen=True)
class OverIdentification:
    """Hansen's J.

    Parameters
    ----------
    J : float
        Statistic; 0 with as many equations as unknowns.
    degrees : int
        Equations that are left over.
    p_value : float
        From F(q, B - q + 1) for B cosine averages, from chi-square for other weights; NaN when there are
        too few averages.
    averages : int or None
        B.
    """

    J: float
    degrees: int
    p_value: float
    averages: int | None


def hansen_j(
    equations: Float[np.ndarray, " p"],
    sensitivity: Float[np.ndarray, "p n"],
    covariance: Float[np.ndarray, "p p"],
    count: int,
    averages: int | None = None,
) -> OverIdentification:
    """J of equations with any weight. Performs no checks.

    Parameters
    ----------
    equations : ndarray, shape (p,)
        g, means over the record at an estimate.
    sensitivity : ndarray, shape (p, n)
        A, minus the derivative of g.
    covariance : ndarray, shape (p, p)
        S, long-run covariance of the scores of one sample.
    count : int
        N.
    averages : int, optional
        Cosine averages behind S; None for a weight that is taken as known.
    """
    scale = unit_scale(np.diag(covariance))
    unknowns = sensitivity.shape[1]
    free = np.linalg.qr(scale[:, None] * sensitivity, mode="complete")[0][:, unknowns:]
    degrees = free.shape[1]
    if not degrees:
        return OverIdentification(0.0, 0, 1.0, averages)
    left = free.T @ (scale * equations)
    S = free.T @ (np.outer(scale, scale) * covariance) @ free
    J = count * quadratic_form(left, S)
    return OverIdentification(J, degrees, hotelling_p_value(J, degrees, averages), averages)


def robust_over_identification(products: TimeProducts, averages: int | None = None) -> OverIdentification:
    """J with a weight that allows for autocorrelation, from time products. Performs no checks.

    Parameters
    ----------
    products : TimeProducts
        At the estimate.
    averages : int, optional
        Cosine averages. Default: three for each equation that is left over, at least eight.
    """
    T = products.whitening
    degrees = max(T.shape[1] - products.sensitivity.shape[1], 0)
    B = joint_averages(degrees, products.counts.size) if averages is None else averages
    S = covariance_of_total(products.equation_sums @ T, B) / products.count
    return hansen_j(T.T @ products.equations, T.T @ products.sensitivity, S, products.count, B)
