"""Kernel estimates of the covariance of autocorrelated scores."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def bartlett_covariance(scores: Float[np.ndarray, "n p"], bandwidth: int) -> Float[np.ndarray, "p p"]:
    """Long-run covariance sum_l (1 - |l|/(bandwidth + 1)) mean(s_t s_{t-l}') (Newey and West 1987).

    Scores are not centred; bandwidth 0 is the heteroskedasticity-robust covariance. O(n p^2 bandwidth).
    """
    count = scores.shape[0]
    covariance: Float[np.ndarray, "p p"] = scores.T @ scores / count
    for lag in range(1, min(bandwidth, count - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag] / count
        covariance += (1.0 - lag / (bandwidth + 1.0)) * (cross + cross.T)
    return covariance


def newey_west_bandwidth(count: int) -> int:
    """Rule of thumb for the number of lags, 4 (n/100)^(2/9)."""
    return int(4.0 * (count / 100.0) ** (2.0 / 9.0))
