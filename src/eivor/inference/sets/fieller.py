"""Confidence sets of ratios, whatever the denominator (Fieller 1954).

A ratio r = p/q of two estimates is tested through p - r q, which is linear: the set holds every r with

    (p - r q)^2 <= t^2 (V_pp - 2 r V_pq + r^2 V_qq).

When q cannot be told from zero the set has no bound, as it must; the delta method would not notice.
"""

from __future__ import annotations

import numpy as np

from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.shapes import Float


def fieller_set(
    pair: Float[np.ndarray, "2"], covariance: Float[np.ndarray, "2 2"], half_widths: float
) -> ConfidenceSet:
    """Values of the ratio that the estimates do not rule out.

    Parameters
    ----------
    pair : ndarray, shape (2,)
        Numerator p and denominator q.
    covariance : ndarray, shape (2, 2)
        V; a row and column of zeros for a number that is exact.
    half_widths : float
        t, half-width of an interval in standard errors.

    Notes
    -----
    Scaled by the estimates' sizes, so that units do not matter. Performs no checks.
    """
    size = np.maximum(np.abs(pair), np.sqrt(np.diag(covariance)) * half_widths)
    size = np.where(size > 0.0, size, 1.0)
    p, q = pair / size
    V = covariance * half_widths**2 / np.outer(size, size)
    found = ConfidenceSet.from_quadratic(
        float(q * q - V[1, 1]), float(-2.0 * (p * q - V[0, 1])), float(p * p - V[0, 0])
    )
    return found.scaled(float(size[0] / size[1]))
