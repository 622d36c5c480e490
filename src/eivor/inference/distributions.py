"""Quantiles and ordered choices."""

from __future__ import annotations

import math

import scipy

from eivor import checks
from eivor.errors import UsageError

# -- Quantiles --


def check_level(level: float) -> None:
    """Refuse a confidence level that is none."""
    checks.number("level", level)
    if not 0.0 < level < 1.0:
        raise UsageError("a confidence level between 0 and 1", f"{level}", "Use 0.95, for example.")


def normal_quantile(level: float) -> float:
    """Half-width, in standard errors, of a two-sided normal interval of confidence `level`."""
    return float(scipy.special.ndtri(0.5 + 0.5 * level))


def t_quantile(level: float, degrees: float | int) -> float:
    """Half-width, in standard errors, of a two-sided t interval; infinite without degrees of freedom."""
    if math.isinf(degrees):
        return normal_quantile(level)
    return float(scipy.special.stdtrit(degrees, 0.5 + 0.5 * level)) if degrees > 0 else math.inf


def chi_square_quantile(level: float, degrees: float = 1) -> float:
    """Value that a chi-square variable stays below with probability `level`."""
    return float(scipy.special.chdtri(degrees, 1.0 - level))


def chi_square_tail(value: float, degrees: float) -> float:
    """Probability that a chi-square variable exceeds `value`."""
    return float(scipy.special.chdtrc(degrees, value))


def t_tail(value: float, degrees: float | int) -> float:
    """Probability that a t variable is further from zero than `value`, to either side."""
    return float(2.0 * scipy.special.stdtr(degrees, -abs(value)))
