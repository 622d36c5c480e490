"""Fractional differences and integrals of any real order.

Delta^alpha x (k) = sum_{j=0..k} a_j x(k-j), with a_0 = 1 and a_j = a_{j-1} (j - 1 - alpha) / j, so
a_j = Gamma(j - alpha) / (Gamma(-alpha) Gamma(j + 1)). A negative order integrates: its noise has long
memory. The output is as long as the input and everything before the record is zero, for every order.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eivor.errors import NonFiniteError


def fractional_weights(order: float, count: int) -> Float[np.ndarray, " count"]:
    """First `count` weights a_j of the operator of that order.

    Raises
    ------
    NonFiniteError
        When the order is not finite.
    """
    if not np.isfinite(order):
        raise NonFiniteError("a finite order", f"{order}", "Give the exponent of the difference operator.")
    j = np.arange(1, count)
    weights: Float[np.ndarray, " count"] = np.cumprod(np.concatenate([[1.0], (j - 1 - order) / j]))[:count]
    return weights


def fractional_difference(
    x: Float[np.ndarray, "*columns n"], order: float
) -> Float[np.ndarray, "*columns n"]:
    """Delta^order of `x` along its last axis, by FFT in O(n log n).

    Parameters
    ----------
    x : ndarray, shape (..., n)
        Record that starts at rest.
    order : float
        Positive differentiates, negative integrates.

    Raises
    ------
    NonFiniteError
        When the order is not finite.
    """
    count = x.shape[-1]
    weights = fractional_weights(order, count)
    size = 1 << max(2 * count - 1, 1).bit_length()
    spectrum = np.fft.rfft(x, size) * np.fft.rfft(weights, size)
    difference: Float[np.ndarray, "*columns n"] = np.fft.irfft(spectrum, size)[..., :count]
    return difference
