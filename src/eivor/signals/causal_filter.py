"""Causal filters with a memory as long as the record: applied, put in a row, and inverted by FFT.

A filter is its weights w_0 ... w_{n-1}; the record is zero before it starts. Weights multiply like power
series in the backward shift, and nothing here costs more than O(n log n).
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float
from eivor.signals.fractional import padded_length

#: Weights that are found one by one before the number of them is doubled.
FIRST_WEIGHTS = 32


def filtered(weights: Float[np.ndarray, " m"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """sum_j w_j x(k - j) for each k, as long as the values; weights left out are zero. Performs no checks."""
    count = values.size
    if weights.size == 1:
        return weights[0] * values
    length = padded_length(max(count, weights.size))
    spectrum = np.fft.rfft(weights[:count], length) * np.fft.rfft(values, length)
    series: Float[np.ndarray, " n"] = np.fft.irfft(spectrum, length)[:count]
    return series


def in_a_row(one: Float[np.ndarray, " m"], other: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
    """Weights of two filters in a row, as many as the longer one has. Performs no checks."""
    longer, shorter = (one, other) if one.size >= other.size else (other, one)
    return filtered(shorter, longer)


def reciprocal(weights: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Weights of the inverse filter: those that make 1, 0, 0, ... of the filter's own.

    Parameters
    ----------
    weights : ndarray, shape (n,)
        The first one is not zero.

    Notes
    -----
    Newton's iteration r <- r (2 - w r), which doubles the number of right weights (Sieveking 1972); the
    error is of the order of rounding times the largest weight. Performs no checks.
    """
    found = _first_weights(weights[:FIRST_WEIGHTS])
    while found.size < weights.size:
        count = min(2 * found.size, weights.size)
        padded = np.zeros(count)
        padded[: found.size] = found
        left = -filtered(weights[:count], padded)
        left[: found.size] = 0.0  # right but for rounding: 1, 0, 0, ...
        found = padded + filtered(padded, left)
    return found


def _first_weights(weights: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Inverse filter weight by weight: quadratic, for a few of them."""
    inverse = np.zeros(weights.size)
    inverse[0] = 1.0 / weights[0]
    for k in range(1, weights.size):
        inverse[k] = -(weights[1 : k + 1] @ inverse[k - 1 :: -1]) / weights[0]
    return inverse
