r"""Covariance of sums of products of two series that remember long, as fractional noise does.

Autocovariances of a noise of order -.4 fall like |tau|^-.2, so that those at hundreds of lags count together.
The sum is over lags up to a quarter of the record, with Bartlett's weights, by Fourier transforms.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float

#: Largest lag: the record over this.
RECORD_OVER_LAG = 4


def long_memory_covariance(
    influence: Float[np.ndarray, "rows k"], error: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, "k k"]:
    """Covariance of the sums of g e, of normal series g (influence) and e (error).

    sum over tau of r_g(tau) r_e(tau) + r_ge(tau) r_ge(-tau)', autocovariances as sums over the rows.

    Notes
    -----
    O(rows log(rows) k^2).
    """
    count = error.size
    length = 1 << (2 * count - 1).bit_length()
    lags = np.arange(length)
    lags = np.minimum(lags, length - lags)
    weights = np.clip(1.0 - lags / (count // RECORD_OVER_LAG + 1.0), 0.0, None) / count

    def sums(spectrum: np.ndarray) -> Float[np.ndarray, "lags *k"]:
        found: Float[np.ndarray, "lags *k"] = np.fft.irfft(spectrum, length, axis=0)
        return found

    of_error, own = np.fft.rfft(error, length), np.fft.rfft(influence, length, axis=0)
    by_error = weights * sums(np.abs(of_error) ** 2)
    across = sums(own * of_error.conj()[:, None])
    backwards = np.roll(across[::-1], 1, axis=0)
    found = across.T @ (weights[:, None] * backwards)
    for number in range(influence.shape[1]):
        found[number] += by_error @ sums(own[:, [number]] * own.conj())
    symmetric: Float[np.ndarray, "k k"] = 0.5 * (found + found.T)
    return symmetric
