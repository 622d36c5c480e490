"""Vertical model: equation, parameters and families of thrust curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import msgspec
import numpy as np

from eivor import checks
from eivor.models.regression import Column, Equation, Parameter, check_columns
from eivor.models.signal_regression import SignalModel, SignalRegression
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import InputMap, Mixed, Power

#: Parameters that are possible, from the least to the largest.
EXPONENTS, SHARES = (0.5, 3.5), (0.0, 1.0)
#: Commands at hover are not below it.
LEAST_COMMAND = 1e-6
#: A value and its 95 % interval.
Interval = tuple[float, tuple[float, float]]


class CurveFamily(msgspec.Struct, frozen=True):
    """Maps of one parameter."""

    of_share: bool  # ``mixed:SHARE``, else ``power:EXPONENT``

    def possible(self, value: float) -> float:
        """The parameter to four decimals, which no flight carries more information closely."""
        return round(float(np.clip(value, *(SHARES if self.of_share else EXPONENTS))), 4)

    def map(self, value: float) -> InputMap:
        return Mixed(value) if self.of_share else Power(value)

    def exponent(self, value: float, hover: float) -> float:
        """Exponent near hover of the map of a parameter; infinite where its thrust there is not positive."""
        if not self.of_share or math.isinf(value):
            return value
        thrust = 1.0 - value + value * hover
        return (thrust + value * hover) / thrust if thrust > 0.0 else math.inf


def family_of(curve: InputMap, *, fitted: bool = True) -> CurveFamily:
    """Family of a map that was fitted; of others shares for thrust, exponents for commands of rotors."""
    return CurveFamily(isinstance(curve, Mixed) or (not fitted and curve == Power(1.0)))


class AutopilotParameter(msgspec.Struct, frozen=True):
    """One parameter of an autopilot."""

    name: str
    autopilot: str
    lowest: float
    highest: float
    words: str = "thrust curve"  # What it is

    def takes(self, value: float) -> bool:
        return self.lowest <= value <= self.highest

    def beyond(self, record: Interval) -> str:
        """Reason why a value is not proposed; empty where the autopilot accepts it."""
        value, (low, high) = record
        if self.takes(value):
            return ""
        side = "above" if value > self.highest else "below"
        reaches = low < self.highest if value > self.highest else high > self.lowest
        inside = ", and its 95 % interval reaches into it" if reaches else ""
        return (
            f"what was found lies {side} the range of {self.lowest:g} to {self.highest:g} that "
            f"{self.autopilot} takes{inside}."
        )


THR_MDL_FAC = AutopilotParameter("THR_MDL_FAC", "PX4", 0.0, 1.0)
MOT_THST_EXPO = AutopilotParameter("MOT_THST_EXPO", "ArduPilot", -1.0, 1.0)
CURVE_PARAMETERS = (THR_MDL_FAC, MOT_THST_EXPO)
#: What to do where a log does not say on which side of the curve its command is.
DECLARE = 'Of a table, declare curve_side = "before" or "behind" of the command in its channel map (--map).'


def in_common(logged: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Parameters that logs have in common, of the parameters of each."""
    first, *others = logged
    return {
        name: value
        for name, value in first.items()
        if math.isfinite(value) and all(item.get(name) == value for item in others)
    }


def curve_in_force(logged: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Those of them that are thrust curves."""
    common = in_common(logged)
    return {item.name: common[item.name] for item in CURVE_PARAMETERS if item.name in common}


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
    """Share f of the vehicle's own curve, see the module; infinite where no share has its exponent."""
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
    """Parameter of a thrust curve, and share of thrust at hover with it in force."""
    commands = [min(max(item, LEAST_COMMAND), 1.0) for item in (hover[0], *hover[1])]
    corners = [
        (plant_share(family, value, command, in_force), motor_signal(command, in_force))
        for value, command in product((curve[0], *curve[1]), commands)
    ]
    shares = [min(max(share, parameter.lowest), parameter.highest) for share, _ in corners]
    thrusts = [thrust_of(share, signal) for share, (_, signal) in zip(shares, corners, strict=True)]
    return (corners[0][0], (min(shares), max(shares))), (thrusts[0], (min(thrusts), max(thrusts)))


VISCOUS_FRICTION = Parameter("viscous_friction", "1/s")
INPUT_GAIN = Parameter("input_gain", "m/s^2")
INTERCEPT = Parameter("intercept", "m/s^2")


@dataclass(frozen=True, slots=True)
class VerticalMotion(SignalModel):
    """The model of vertical motion.

    Parameters
    ----------
    input_map : InputMap
        Applied to each actuator's state.
    intercept : bool
        Estimate an intercept (one for each run when a flight is cut into runs).
    """

    input_map: InputMap = field(default_factory=Power)
    intercept: bool = True

    def __post_init__(self) -> None:
        remedy = "Leave it out, or give Power(2.0)."
        checks.kind("input_map", self.input_map, (Power, Mixed), "an input map", remedy)
        checks.flag("intercept", self.intercept)

    @property
    def parameters(self) -> tuple[Parameter, Parameter]:
        return VISCOUS_FRICTION, INPUT_GAIN

    def equation(self, response: str = "specific_force_z") -> Equation:
        """The equation for signals whose `input` is mapped, lagged and multiplied by the tilt already."""
        terms = [(VISCOUS_FRICTION, Column("velocity_z", gain=-1.0)), (INPUT_GAIN, Column("input"))]
        if self.intercept:
            terms.append((INTERCEPT, Column("")))
        return Equation(Column(response), tuple(terms), derivative_of="velocity_z")

    def regression(self, signals: Signals, instruments: tuple[Column, ...] = ()) -> SignalRegression:
        """Rows (-z', u, 1) and z'' + g of `signals`, or z'' where that is what they have.

        Parameters
        ----------
        signals : Signals
            With `velocity_z`, `input`, and `specific_force_z` or else `acceleration_z`.
        instruments : tuple of Column
            Such as ``lags("input", 1, 10)``. The intercept, where there is one, instruments itself.

        Returns
        -------
        SignalRegression
            Its rows are cut when they are requested.
        """
        checks.kind("signals", signals, Signals, "Signals", "Make them: ev.Signals(rate_hz, channels).")
        check_columns("instruments", instruments)
        constant = (Column(""),) if instruments and self.intercept else ()
        about_hover = "specific_force_z" not in signals.channels and "acceleration_z" in signals.channels
        equation = self.equation("acceleration_z" if about_hover else "specific_force_z")
        return SignalRegression(signals, equation, (*instruments, *constant))

    def regression_lag(self, instruments: tuple[Column, ...] = ()) -> int:
        """Samples that a row reaches back."""
        return max((column.lag for column in instruments), default=0)
