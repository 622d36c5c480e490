"""A first-order actuator with a delay, driven by commands that are held between samples.

``tau w' + w = c(t - d)`` with ``d = (m + f) h``, ``0 <= f < 1``, has between samples the exact solution

    w[k] = a w[k-1] + (1 - e) c[k-1-m] + (e - a) c[k-2-m],   a = exp(-h/tau), e = exp(-(1-f) h/tau)

so the state at a sample answers the commands *before* it, never the one that starts there.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from eivor.shapes import Float


def actuator_state(
    command: Float[np.ndarray, "n rotors"], *, step_s: float, lag_s: float, delay_s: float
) -> Float[np.ndarray, "n rotors"]:
    """State of each actuator at the samples; it starts at rest at its first command.

    Parameters
    ----------
    command : ndarray, shape (n, rotors)
        Commanded values; ``command[k]`` is held from sample k to sample k+1.
    step_s, lag_s, delay_s : float
        Step of the grid h, time constant tau and delay d [s]. A zero lag gives the delayed command
        itself; with neither lag nor delay `command` is unchanged.

    Notes
    -----
    Performs no checks. Linear in n.
    """
    if lag_s <= 0.0 and delay_s <= 0.0:
        return command
    whole = int(np.floor(delay_s / step_s + 1e-9))
    fraction = max(delay_s / step_s - whole, 0.0)
    decay = np.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
    tail = np.exp(-(1.0 - fraction) * step_s / lag_s) if lag_s > 0.0 else 0.0
    start = command[0]
    delayed = delayed_by(command - start, whole + 1)
    earlier = delayed_by(command - start, whole + 2)
    driven = (1.0 - tail) * delayed + (tail - decay) * earlier
    return _recursion(driven, float(decay)) + start


def _recursion(driven: Float[np.ndarray, "n rotors"], decay: float) -> Float[np.ndarray, "n rotors"]:
    """w[k] = decay w[k-1] + driven[k] from rest, as the bidiagonal triangular system that it is.

    LAPACK solves it as fast as a filter would, and is at hand without loading SciPy's signal processing,
    which takes longer than the whole search for a lag.
    """
    band = np.empty((2, driven.shape[0]))
    band[0], band[1] = 1.0, -decay
    state: Float[np.ndarray, "n rotors"] = dtbtrs(band, driven, uplo="L", diag="U", overwrite_b=True)[0]
    return state


def delayed_by(values: Float[np.ndarray, "n columns"], samples: int) -> Float[np.ndarray, "n columns"]:
    """Values `samples` later, preceded by zeros. Performs no checks."""
    if samples == 0:
        return values
    shifted = np.zeros_like(values)
    shifted[samples:] = values[:-samples]
    return shifted


def shifted_by(
    values: Float[np.ndarray, "n columns"], *, step_s: float, delay_s: float
) -> Float[np.ndarray, "n columns"]:
    """Sampled values so much later; earlier for a negative delay.

    Between samples by the cubic through the four nearest, whose error is of the fourth order in the step;
    beyond the ends the first and the last value are held.

    Parameters
    ----------
    values : ndarray, shape (n, columns)
        A continuous quantity, sampled.
    step_s, delay_s : float
        Step and delay [s].

    Notes
    -----
    Performs no checks.
    """
    whole = int(np.floor(delay_s / step_s))
    f = delay_s / step_s - whole
    # Lagrange's weights for the value between samples 0 and -1, of samples 1, 0, -1, -2 from there
    weights = (
        f * (f - 1.0) * (2.0 - f) / 6.0,
        (1.0 + f) * (1.0 - f) * (2.0 - f) / 2.0,
        f * (1.0 + f) * (2.0 - f) / 2.0,
        f * (1.0 + f) * (f - 1.0) / 6.0,
    )
    index = np.arange(values.shape[0]) - whole
    last = values.shape[0] - 1
    shifted = np.zeros_like(values)
    for weight, offset in zip(weights, (1, 0, -1, -2), strict=True):
        if weight:
            shifted += weight * values[np.clip(index + offset, 0, last)]
    return shifted


def first_order_lag(
    values: Float[np.ndarray, " n"], *, step_s: float, lag_s: float
) -> Float[np.ndarray, " n"]:
    """Held `values` behind a first-order lag that starts at rest at the first one."""
    return actuator_state(values[:, None], step_s=step_s, lag_s=lag_s, delay_s=0.0)[:, 0]
