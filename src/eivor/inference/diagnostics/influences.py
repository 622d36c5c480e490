"""Influences: what the scores of a stretch of a record add to each parameter, M^-1 s, to first order."""

from __future__ import annotations

import numpy as np

from eivor.inference.covariances.covariance import unit_scale
from eivor.shapes import Float


def influences(
    sums: Float[np.ndarray, "K n"], sensitivity: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "K n"]:
    """What each block adds to each parameter. Performs no checks.

    Parameters
    ----------
    sums : ndarray, shape (K, n)
        Sums of the scores over each block.
    sensitivity : ndarray, shape (n, n)
        M, of the whole record.
    """
    scale = unit_scale(np.abs(np.diag(sensitivity)))
    scaled = np.outer(scale, scale) * sensitivity
    found: Float[np.ndarray, "n K"] = np.linalg.lstsq(scaled, scale[:, None] * sums.T, rcond=None)[0]
    return scale * found.T
