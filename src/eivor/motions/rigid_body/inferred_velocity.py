"""Velocity along the body's z axis where none is logged: the specific force, integrated over short periods.

    v_z' = s_z - g cos(tilt)

Bias and tilt that is not known grow in an integral, so that it serves above a frequency only: `FROM_HZ`.
Below a quarter of that nothing of it is left. What is left out are p v_y and q v_x, for which the velocity
across would have to be known. The attitude is the logged one, else that of the integrated rates about a level
that is their mean over some seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eivor.motions.rates.axes import PITCH, ROLL
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.signals.signals import Signals

FORCE = "specific_force_body_z"
#: Lowest frequency at which the integral serves [Hz].
FROM_HZ = 0.2
#: Half of a variation at this frequency is taken out of an integral [Hz].
TAKEN_OUT_HZ = FROM_HZ / 4.0


def inferred_velocity(signals: Signals, runs: Sequence[slice]) -> Float[np.ndarray, " n"] | None:
    """Velocity along z within each run [m/s], zero elsewhere; None without a specific force along z.

    Parameters
    ----------
    signals : Signals
        Of a flight, with its rates.
    runs : sequence of slice
        Stretches to integrate over, each by itself.
    """
    if FORCE not in signals.channels:
        return None
    velocity = np.zeros(signals.sample_count)
    for run in runs:
        excess = signals.channel(FORCE)[run] - GRAVITY * _cos_tilt(signals, run)
        velocity[run] = _integrated(excess - excess.mean(), signals.step_s)
    return velocity


def _cos_tilt(signals: Signals, run: slice) -> Float[np.ndarray, " length"]:
    parts = [f"attitude_{part}" for part in "wxyz"]
    if set(parts) <= set(signals.channels):
        w, x, y, z = (signals.channel(part)[run] for part in parts)
        return np.asarray(1.0 - 2.0 * (x * x + y * y) / np.maximum(w * w + x * x + y * y + z * z, 1e-12))
    roll, pitch = (_integrated(signals.channel(axis.rate)[run], signals.step_s) for axis in (ROLL, PITCH))
    return np.asarray(np.cos(roll) * np.cos(pitch))


def _integrated(rate: Float[np.ndarray, " length"], step_s: float) -> Float[np.ndarray, " length"]:
    """Integral without its slow parts, of Butterworth's shape (second order, once forward and once back)."""
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * step_s
    level = summed - np.linspace(summed[0], summed[-1], summed.size)
    frequency = np.fft.rfftfreq(level.size, step_s)
    kept = np.zeros(frequency.size)
    kept[1:] = 1.0 / (1.0 + (TAKEN_OUT_HZ / frequency[1:]) ** 4)
    return np.asarray(np.fft.irfft(kept * np.fft.rfft(level), level.size))
