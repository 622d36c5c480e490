"""A curve of thrust against command that was found out: its family of maps, its parameter, its neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.shapes import Float
from eivor.signals.input_map import InputMap, Mixed, Power

#: Grids of parameters for curvature, and what parameters are possible.
EXPONENTS, SHARES = np.linspace(0.5, 3.5, 9), np.linspace(0.0, 1.0, 6)


@dataclass(frozen=True, slots=True)
class CurveFamily:
    """Maps of one parameter.

    Parameters
    ----------
    of_share : bool
        ``mixed:SHARE``, else ``power:EXPONENT``.
    """

    of_share: bool

    @property
    def grid(self) -> Float[np.ndarray, " values"]:
        """Parameters from the least possible to the largest."""
        return SHARES if self.of_share else EXPONENTS

    def possible(self, value: float) -> float:
        """The parameter to four decimals, which no flight tells more closely, or the nearest possible one."""
        return round(float(np.clip(value, self.grid[0], self.grid[-1])), 4)

    def map(self, value: float) -> InputMap:
        """Input map of a parameter."""
        return Mixed(value) if self.of_share else Power(value)

    def of_exponent(self, exponent: float, hover: float) -> float:
        """Parameter of the map that has an exponent near hover; the least share where no share has it."""
        if not self.of_share:
            return exponent
        # (1 - s) u + s u^2 has the exponent r at u for s = (r - 1) / ((r - 1) + (2 - r) u)
        whole = (exponent - 1.0) + (2.0 - exponent) * hover
        return (exponent - 1.0) / whole if whole > 0.0 else float(self.grid[0])


def family_of(start: InputMap) -> CurveFamily:
    """Maps that are tried in place of one: shares for thrust commands, exponents for commands of rotors."""
    return CurveFamily(isinstance(start, Mixed) or start == Power(1.0))


@dataclass(frozen=True)
class FittedCurve:
    """A map that was found out, and estimates with maps to either side.

    Parameters
    ----------
    family : CurveFamily
        Of which maps.
    value : float
        Its parameter.
    bias_std : float
        Standard deviation of the accelerometer's bias that was assumed; infinite for none [m/s^2].
    below, above : tuple of (float, Estimate)
        Parameter and estimate to either side.
    curvature_error : float
        Standard error by curvature alone, where no bias is assumed; infinite where it cannot tell.
    """

    family: CurveFamily
    value: float
    bias_std: float
    below: tuple[float, Estimate]
    above: tuple[float, Estimate]
    curvature_error: float = math.inf
