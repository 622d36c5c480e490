"""Linear recursions with constant or changing coefficients, solved as banded triangular systems.

LAPACK does it as fast as a filter would, takes coefficients that change with time, and is at hand without
loading SciPy's signal processing.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from eivor.shapes import Float


def autoregression(
    driven: Float[np.ndarray, " n"], coefficients: Float[np.ndarray, "n lags"]
) -> Float[np.ndarray, " n"]:
    """x[k] = driven[k] + sum_i coefficients[k, i] x[k - 1 - i], with zeros before the record.

    Parameters
    ----------
    driven : ndarray, shape (n,)
        Right-hand side.
    coefficients : ndarray, shape (n, lags)
        Row k belongs to x[k].

    Notes
    -----
    Performs no checks. Linear in n times lags; forward substitution, so its error is that of the
    recursion itself.
    """
    count, lags = driven.size, min(coefficients.shape[1], max(driven.size - 1, 0))
    if lags == 0:
        return driven.copy()
    band = np.zeros((lags + 1, count))
    band[0] = 1.0
    for i in range(1, lags + 1):
        band[i, : count - i] = -coefficients[i:, i - 1]
    series: Float[np.ndarray, " n"] = dtbtrs(band, driven[:, None], uplo="L", diag="U")[0][:, 0]
    return series


def constant(coefficients: tuple[float, ...], count: int) -> Float[np.ndarray, "n lags"]:
    """The same coefficients at every sample."""
    return np.broadcast_to(np.array(coefficients, dtype=np.float64), (count, len(coefficients)))


def largest_root(coefficients: Float[np.ndarray, " lags"]) -> float:
    """Modulus of the slowest mode of x[k] = sum_i c[i] x[k - 1 - i]; below one when it dies out."""
    if coefficients.size == 0:
        return 0.0
    return float(np.abs(np.roots(np.concatenate([[1.0], -coefficients]))).max(initial=0.0))


def settling(ratio: float) -> int:
    """Steps in which something that shrinks by `ratio` each falls to a millionth, 100,000 at most."""
    if ratio <= 0.0:
        return 1
    return min(int(np.ceil(np.log(1e-6) / np.log(ratio))), 100_000)
