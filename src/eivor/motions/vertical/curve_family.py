"""Families of thrust curves: maps of one parameter, and what the parameter is for an autopilot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


def share_of_both(family: CurveFamily, value: float, hover: float, in_force: float) -> float:
    """Share of the square of a motor's signal, when commands come before a curve of the share `in_force`.

    Parameters
    ----------
    family : CurveFamily
        Of the curve that was found.
    value : float
        Its parameter: exponent or share, of commands.
    hover : float
        Command at hover, a share of the largest.
    in_force : float
        Share of the autopilot's own curve, whose inverse its commands go through.
    """
    exponent = value
    if family.of_share:
        exponent = (1.0 - value + 2.0 * value * hover) / (1.0 - value + value * hover)
    own = Mixed(min(max(in_force, 0.0), 1.0))
    signal = own.inverse(hover)
    exponent *= signal * own.slope(signal) / hover
    return CurveFamily(True).of_exponent(exponent, signal)
