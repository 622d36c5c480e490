"""Power of noise that rises with the square of frequency, as that of differences does, over a level.

At the lower end of a band a mean over neighbouring bins is one over a window as wide as the frequencies are
high: noise that rises with f^2 is told many times too large there, and what a flight tells in these bins
counts too little. So power is divided by its coarse shape before means are taken, and multiplied by it
afterwards.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float

#: Fits, each weighted by the one before; and the least share of the mean power that a weight is made of.
FITS, LEAST_SHARE = 8, 1e-6


def rising_power(
    frequency_hz: Float[np.ndarray, " bins"], power: Float[np.ndarray, " bins"]
) -> Float[np.ndarray, " bins"]:
    """Shape a + b f^2 of a power spectrum, neither of them below zero; ones where there is no power.

    Of bins whose powers are exponentially distributed about it, the most likely one: least squares of the
    powers, each divided by the shape there, over and over.

    Parameters
    ----------
    frequency_hz : ndarray, shape (bins,)
        Frequencies [Hz].
    power : ndarray, shape (bins,)
        Power at each.
    """
    from scipy.optimize import nnls  # late: it brings much, which few ask for

    mean = float(power.mean()) if power.size else 0.0
    if not mean > 0.0:
        return np.ones_like(power)
    columns = np.column_stack([np.ones_like(frequency_hz), (frequency_hz / frequency_hz[-1]) ** 2])
    shape = np.full_like(power, mean)
    for _ in range(FITS):
        levels, _ = nnls(columns / shape[:, None], power / shape)
        shape = np.maximum(columns @ levels, LEAST_SHARE * mean)
    return shape
