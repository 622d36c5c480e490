"""Families of thrust curves: maps of one parameter, and what the parameter is for an autopilot.

PX4's THR_MDL_FAC and ArduPilot's MOT_THST_EXPO are both the share f of the square in

    T = C_f(s) = (1 - f) s + f s^2,

T a motor's thrust and s its signal, as shares of their largest. The autopilot inverts the curve with the
value f_0 that is in force: of a setpoint u of thrust it makes the signal

    s = C_f0^-1(u) = 2 u / ((1 - f_0) + sqrt((1 - f_0)^2 + 4 f_0 u)).

A flight tells the exponent p = d ln T / d ln w of thrust over its command w at hover, w_h. Of an exponent map
it is the map's parameter, of ``mixed:c`` it is (1 - c + 2 c w_h) / (1 - c + c w_h).

* A command behind the curve is the signal, w = s. The vehicle's own curve has that exponent at s_h = w_h:

      r = (1 - f + 2 f s_h) / (1 - f + f s_h) = p,   f = (r - 1) / ((r - 1) + (2 - r) s_h).

  The value in force does not enter.
* A command before the curve is the setpoint, w = u. The signal at hover is s_h = C_f0^-1(w_h), and the
  exponent of thrust over the signal is that over the setpoint times that of the setpoint over the signal:

      r = p s_h C_f0'(s_h) / w_h,

  with f as above. Thrust that is proportional to the setpoint, p = 1, leaves f = f_0.

The autopilot's share of thrust at hover, with a curve f in force, is C_f(s_h). ArduPilot divides the signal
by the battery's voltage ratio where MOT_BAT_VOLT_MAX is set, and the setpoint by the ratio of the air's
density; both ratios are taken as one here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from eivor.shapes import Float
from eivor.signals.input_map import InputMap, Mixed, Power

#: Grids of parameters for curvature, and what parameters are possible.
EXPONENTS, SHARES = np.linspace(0.5, 3.5, 9), np.linspace(0.0, 1.0, 6)
#: Commands at hover are not below it.
LEAST_COMMAND = 1e-6
#: A value and its 95 % interval.
Interval = tuple[float, tuple[float, float]]


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
        return max(share_of(exponent, hover), float(self.grid[0]))

    def exponent(self, value: float, hover: float) -> float:
        """Exponent near hover of the map of a parameter; infinite where its thrust there is not positive."""
        if not self.of_share or math.isinf(value):
            return value
        thrust = 1.0 - value + value * hover
        return (thrust + value * hover) / thrust if thrust > 0.0 else math.inf


def family_of(start: InputMap) -> CurveFamily:
    """Maps that are tried in place of one: shares for thrust commands, exponents for commands of rotors."""
    return CurveFamily(isinstance(start, Mixed) or start == Power(1.0))


def family_of_fitted(chosen: InputMap) -> CurveFamily:
    """Family of a map that was fitted: an exponent of one is ``linear``, and a share of zero ``mixed:0``."""
    return CurveFamily(isinstance(chosen, Mixed))


@dataclass(frozen=True, slots=True)
class AutopilotParameter:
    """One parameter of an autopilot.

    Parameters
    ----------
    name, autopilot : str
        As the autopilot calls it, and the autopilot.
    lowest, highest : float
        What the autopilot takes.
    """

    name: str
    autopilot: str
    lowest: float
    highest: float

    def takes(self, value: float) -> bool:
        """Whether the autopilot takes a value."""
        return self.lowest <= value <= self.highest

    def beyond(self, told: Interval) -> str:
        """Why a value is not proposed, without the value; empty where the autopilot takes it."""
        value, (low, high) = told
        if self.takes(value):
            return ""
        side = "above" if value > self.highest else "below"
        reaches = low < self.highest if value > self.highest else high > self.lowest
        inside = " Its 95 % interval reaches into that range." if reaches else ""
        return (
            f"what was found lies {side} the range of {self.lowest:g} to {self.highest:g} that "
            f"{self.autopilot} takes.{inside}"
        )


#: The parameters of thrust curves.
THR_MDL_FAC = AutopilotParameter("THR_MDL_FAC", "PX4", 0.0, 1.0)
MOT_THST_EXPO = AutopilotParameter("MOT_THST_EXPO", "ArduPilot", -1.0, 1.0)
CURVE_PARAMETERS = (THR_MDL_FAC, MOT_THST_EXPO)
#: What to do where a log does not say on which side of the curve its command is.
DECLARE = 'Of a table, declare curve_side = "before" or "behind" of the command in its channel map (--map).'


def curve_in_force(logged: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Parameters of thrust curves that logs have in common, of the parameters of each."""
    names = [one.name for one in CURVE_PARAMETERS]
    values = {name: {one.get(name, math.nan) for one in logged} for name in names}
    return {
        name: min(found) for name, found in values.items() if len(found) == 1 and math.isfinite(min(found))
    }


def share_of(exponent: float, signal: float) -> float:
    """Share f whose curve has an exponent at a signal, see the module; infinite where none has."""
    if exponent in {math.inf, -math.inf}:
        return exponent
    whole = (exponent - 1.0) + (2.0 - exponent) * signal
    return (exponent - 1.0) / whole if exponent > 0.0 and whole > 0.0 else -math.inf


def thrust_of(share: float, signal: float) -> float:
    """C_f(s), see the module."""
    return (1.0 - share) * signal + share * signal**2


def motor_signal(command: float, in_force: float | None) -> float:
    """Signal at a command, before the curve `in_force` or, for None, behind any."""
    if in_force is None:
        return command
    linear = 1.0 - in_force
    return 2.0 * command / (linear + math.sqrt(linear**2 + 4.0 * in_force * command))


def plant_share(family: CurveFamily, value: float, hover: float, in_force: float | None) -> float:
    """Share f of the vehicle's own curve, see the module; infinite where no share has its exponent.

    Parameters
    ----------
    family : CurveFamily
        Of the curve that was found.
    value : float
        Its parameter: exponent or share, of the command.
    hover : float
        Command at hover, a share of the largest above zero.
    in_force : float or None
        Share of the autopilot's own curve, of a command before it; None of a command behind it.
    """
    if family.of_share and in_force is None:
        return value
    exponent = family.exponent(value, hover)
    signal = motor_signal(hover, in_force)
    if in_force is not None:
        exponent *= signal * (1.0 - in_force + 2.0 * in_force * signal) / hover
    return share_of(exponent, signal)


def proposed(
    parameter: AutopilotParameter,
    family: CurveFamily,
    curve: Interval,
    hover: Interval,
    in_force: float | None,
) -> tuple[Interval, Interval]:
    """Parameter of a thrust curve, and share of thrust at hover with it in force.

    Parameters
    ----------
    parameter : AutopilotParameter
        To be proposed. Ends of intervals are cut to its range, the value is not.
    family : CurveFamily
        Of the curve that was found.
    curve, hover : tuple
        Value and interval of its parameter, and of the command at hover.
    in_force : float or None
        See `plant_share`.

    Returns
    -------
    share, thrust : tuple
        Each a value and an interval, which holds whatever curve and command are within theirs.
    """
    commands = [min(max(one, LEAST_COMMAND), 1.0) for one in (hover[0], *hover[1])]
    corners = [
        (plant_share(family, value, command, in_force), motor_signal(command, in_force))
        for value, command in product((curve[0], *curve[1]), commands)
    ]
    shares = [min(max(share, parameter.lowest), parameter.highest) for share, _ in corners]
    thrusts = [thrust_of(share, signal) for share, (_, signal) in zip(shares, corners, strict=True)]
    return (corners[0][0], (min(shares), max(shares))), (thrusts[0], (min(thrusts), max(thrusts)))
