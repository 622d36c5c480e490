"""What an onboard low-pass makes of a series, on any grid.

``y'' / w^2 + sqrt(2) y' / w + y = x`` with ``w = 2 pi cutoff``: of second order, with Butterworth's damping.
The series is taken as straight between its samples, for which the recursion is exact, so that a cutoff may
lie beyond half the grid's rate.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from eivor.shapes import Float


def low_passed(
    values: Float[np.ndarray, "n columns"], *, step_s: float, cutoff_hz: float
) -> Float[np.ndarray, "n columns"]:
    """Columns behind the filter, which has seen their first values for ever.

    Parameters
    ----------
    values : ndarray, shape (n, columns)
        Sampled; between samples it is the line.
    step_s : float
        Step of the grid [s].
    cutoff_hz : float
        At which the power is halved [Hz].

    Notes
    -----
    Performs no checks. Linear in n. Late by sqrt(2) / w far below the cutoff. With s = w / sqrt(2) the answer
    to a ramp t is ``t - (1 - exp(-s t) cos(s t)) / s``; its second difference over the step, behind the
    recursion's denominator, is the numerator.
    """
    s = np.sqrt(2.0) * np.pi * cutoff_hz
    t = step_s * np.arange(1, 4)
    ramp = t - (1.0 - np.exp(-s * t) * np.cos(s * t)) / s
    first, second = -2.0 * np.exp(-s * step_s) * np.cos(s * step_s), np.exp(-2.0 * s * step_s)
    bends = np.diff([0.0, 0.0, *ramp], 2) / step_s
    start = values[0]
    moved = values - start
    driven = np.zeros_like(moved)
    for late, weight in enumerate(np.convolve([1.0, first, second], bends)[:3]):
        driven[late:] += weight * moved[: moved.shape[0] - late]
    band = np.empty((3, values.shape[0]))
    band[0], band[1], band[2] = 1.0, first, second
    filtered: Float[np.ndarray, "n columns"] = dtbtrs(band, driven, uplo="L", diag="U")[0]
    return filtered + start
