"""Quantiles and ordered choices."""

from __future__ import annotations

import math

import numpy as np
import scipy

#: Angles over which the distribution of a conditional likelihood ratio is integrated.
ANGLES = 200
#: A larger strength leaves no more than a normal variable has.
MUCH = 1e6


def normal_quantile(level: float) -> float:
    """Half-width, in standard errors, of a two-sided normal interval of confidence `level`."""
    return float(scipy.special.ndtri(0.5 + 0.5 * level))


def t_quantile(level: float, degrees: float | int) -> float:
    """Half-width, in standard errors, of a two-sided t interval; infinite without degrees of freedom."""
    if math.isinf(degrees):
        return normal_quantile(level)
    return float(scipy.special.stdtrit(degrees, 0.5 + 0.5 * level)) if degrees > 0 else math.inf


def t_ratio(level: float, errors: float) -> float:
    """Half-width of a t interval over that of level 0.95, which is so many standard errors wide."""
    heavy = normal_quantile(0.95) < errors < math.inf
    degrees = float(scipy.special.stdtridf(0.975, errors)) if heavy else math.inf
    return t_quantile(level, degrees) / t_quantile(0.95, degrees)


def t_tail(value: float, degrees: float | int) -> float:
    """Probability that a t variable is further from zero than `value`; 1 without degrees of freedom."""
    if math.isinf(degrees):
        return float(2.0 * scipy.special.ndtr(-abs(value)))
    return float(2.0 * scipy.special.stdtr(degrees, -abs(value))) if degrees > 0 else 1.0


def chi_square_quantile(level: float, degrees: float = 1) -> float:
    """Value that a chi-square variable stays below with probability `level`."""
    return float(scipy.special.chdtri(degrees, 1.0 - level))


def chi_square_tail(value: float, degrees: float) -> float:
    """Probability that a chi-square variable exceeds `value`."""
    return float(scipy.special.chdtrc(degrees, value))


def conditional_ratio_quantile(level: float, degrees: float, strength: float) -> float:
    """Value that a likelihood ratio of one parameter stays below, given the strength (Moreira 2003)."""
    # the angle's sine is the variable of the integral of Andrews, Moreira and Stock (2007)
    if degrees <= 1.0 or not strength < MUCH:
        return chi_square_quantile(level, 1)
    angles = (np.arange(ANGLES) + 0.5) * (0.5 * np.pi / ANGLES)
    weights = np.cos(angles) ** (degrees - 2.0)
    sizes = np.sin(angles) ** 2

    def excess(value: float) -> float:
        below = scipy.special.chdtr(degrees, (strength + value) / (1.0 + strength * sizes / value))
        return float(weights @ below / weights.sum()) - level

    low, high = chi_square_quantile(level, 1), chi_square_quantile(level, degrees)
    if not excess(low) < 0.0 < excess(high):  # by rounding: both ends are near where a degree is left over
        return low if excess(low) >= 0.0 else high
    return float(scipy.optimize.brentq(excess, low, high))
