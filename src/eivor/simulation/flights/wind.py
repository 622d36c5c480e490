"""Wind: a stationary Ornstein-Uhlenbeck process on each axis."""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float


def gusts(
    *, count: int, axes: int, step_s: float, rms: float, correlation_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "count axes"]:
    """Independent wind on each axis, sampled exactly and meant to be held over a step.

    Parameters
    ----------
    count, axes : int
        Samples and axes.
    step_s : float
        Time between samples [s].
    rms : float
        Standard deviation on each axis [m/s].
    correlation_s : float
        Time in which the correlation falls to 1/e [s].
    rng : numpy.random.Generator
        Source of the shocks.
    """
    from scipy.signal import lfilter

    shocks = rng.standard_normal((count, axes))
    decay = np.exp(-step_s / correlation_s)
    shocks[1:] *= np.sqrt(1.0 - decay**2)
    wind: Float[np.ndarray, "count axes"] = rms * lfilter([1.0], [1.0, -decay], shocks, axis=0)
    return wind
