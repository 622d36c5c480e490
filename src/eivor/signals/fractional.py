"""Fractional differences and sums of a record.

One boundary convention for every order, integer ones included: the record is zero before it starts
(type II), and the output is as long as the input,

    Delta^order x (k) = sum_{j=0..k} a_j x(k-j),   a_0 = 1,   a_j = a_{j-1} (j - 1 - order) / j

so an order of -1 is the running sum, and a negative order gives memory.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def fractional_weights(order: float, count: int) -> Float[np.ndarray, " count"]:
    """Return a_0 ... a_{count-1}. Performs no checks.

    Parameters
    ----------
    order : float
        Any real number; negative orders sum, positive ones take differences.
    count : int
        Number of weights, one or more.
    """
    lags = np.arange(1.0, count)
    return np.concatenate([[1.0], np.cumprod((lags - 1.0 - order) / lags)])


def fractional_difference(
    values: Float[np.ndarray, "n *columns"], order: float
) -> Float[np.ndarray, "n *columns"]:
    """Fractional difference of each column along the first axis.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        Record, zero before it starts.
    order : float
        Any real number.

    Returns
    -------
    ndarray, shape (n, ...)
        Same unit as `values`: the step of the record is not in it.

    Notes
    -----
    Convolution by FFT, O(n log n); the error is of the order of rounding times the largest output.
    Performs no checks.
    """
    count = values.shape[0]
    weights = fractional_weights(order, count).reshape(-1, *[1] * (values.ndim - 1))
    spectrum = np.fft.rfft(weights, 2 * count, axis=0) * np.fft.rfft(values, 2 * count, axis=0)
    series: Float[np.ndarray, "n *columns"] = np.fft.irfft(spectrum, 2 * count, axis=0)[:count]
    return series
