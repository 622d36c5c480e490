"""Fractional differences and sums of a record.

One boundary convention for every order, integer ones included: the record is zero before it starts
(type II), and the output is as long as the input,

    Delta^order x (k) = sum_{j=0..k} a_j x(k-j),   a_0 = 1,   a_j = a_{j-1} (j - 1 - order) / j

so an order of -1 is the running sum, and a negative order gives memory.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from eivor.shapes import Complex, Float

#: Longest record whose weights' spectrum is kept for the next one: studies draw many of one length.
KEPT = 1 << 16


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


def order_slope(order: float, count: int) -> Float[np.ndarray, " count"]:
    """Derivatives of a_0 ... a_{count-1} by the order: the weights of log(1 - z) Delta^order.

    Those of log(1 - z) are 0, -1, -1/2, -1/3, ...; O(n log n). Performs no checks.
    """
    logarithm = np.zeros((count, 1))
    logarithm[1:, 0] = -1.0 / np.arange(1.0, count)
    return fractional_difference(logarithm, order)[:, 0]


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
    Convolution by FFT, O(n log n), 1e6 samples within half a second; the error is of the order of
    rounding times the largest output.
    Performs no checks.
    """
    count = values.shape[0]
    length = padded_length(count)
    response = _kept_response(order, count) if count <= KEPT else _response(order, count)
    spectrum = np.fft.rfft(values, length, axis=0)
    spectrum *= response.reshape(-1, *[1] * (values.ndim - 1))
    series: Float[np.ndarray, "n *columns"] = np.fft.irfft(spectrum, length, axis=0)[:count]
    return series


def padded_length(count: int) -> int:
    """Length without large prime factors at which a convolution of records that long does not wrap around."""
    needed = 2 * count
    fast = (factor << max(needed.bit_length() - 4, 0) for factor in (8, 9, 10, 12, 15, 16))
    return next(length for length in fast if length >= needed)


def _response(order: float, count: int) -> Complex[np.ndarray, " bins"]:
    """Spectrum of the weights on the padded length."""
    response = np.fft.rfft(fractional_weights(order, count), padded_length(count))
    response.flags.writeable = False
    return response


_kept_response = lru_cache(maxsize=16)(_response)
