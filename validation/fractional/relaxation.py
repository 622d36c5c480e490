"""Analytic truth of x + tau^alpha D^alpha x = u: Mittag-Leffler's function as an integral of relaxations.

For 0 < alpha < 1, 1 - E_alpha(-t^alpha) is the integral over rates r of K(r) (1 - e^(-rt)) with
K(r) = sin(alpha pi)/pi r^(alpha-1) / (r^(2 alpha) + 2 r^alpha cos(alpha pi) + 1), and its integral by t the
response to a ramp. The integrands are analytic in log r, so that the trapezoidal rule is exact to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eivor.signals.filters import filtered
from eivor.tools import Float

Series = Float[np.ndarray, " n"]

#: Spacing and reach of log r: the integrand falls as r^alpha on both sides.
SPACING, REACH = 0.05, 40.0


def _rates(alpha: float) -> tuple[Series, Series]:
    log_rate = np.arange(-REACH / alpha, REACH / alpha, SPACING)
    rate = np.exp(log_rate)
    power = rate**alpha
    weight = np.sin(alpha * np.pi) / np.pi * power / (power**2 + 2.0 * power * np.cos(alpha * np.pi) + 1.0)
    return rate, SPACING * weight


def step_response(time: Sequence[float] | Series, alpha: float) -> Series:
    """1 - E_alpha(-t^alpha)."""
    rate, weight = _rates(alpha)
    return np.array([float(weight @ -np.expm1(-rate * t)) for t in time])


def ramp_response(time: Sequence[float] | Series, alpha: float) -> Series:
    """T (1 - E_{alpha,2}(-t^alpha))."""
    rate, weight = _rates(alpha)

    def at(t: float) -> float:
        late = t + np.expm1(-rate * t) / rate
        return float(weight @ np.where(rate * t < 1e-4, rate * t**2 / 2.0, late))

    return np.array([at(t) for t in time])


def driven(current: Float[np.ndarray, " k"], ramp: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Response at the samples to an input that is a line between them, zero at first."""
    bends = np.diff(current, n=2, prepend=[0.0, 0.0])
    # The line bends at a sample and is felt after it.
    return filtered(np.append(bends[1:], 0.0), ramp)
