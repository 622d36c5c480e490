"""Vertical motion: z'' + g = K_u u - K z' + b, the paper's (5) with its signs put right.

The response is the specific force of a level vehicle, `specific_force_z` = z'' + g. Parameters: viscous
friction K [1/s] and input gain K_u [m/s^2 per unit of mapped input]; the intercept b [m/s^2] takes up the
accelerometer's bias. Signals without a specific force have `acceleration_z` = z'' for their response: the
same equation for an `input` that is a deviation from hover, and otherwise with g in its intercept.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from eivor import checks
from eivor.models.column import Column, check_columns
from eivor.models.equation import Equation, Parameter
from eivor.models.signal_regression import SignalModel, SignalRegression
from eivor.signals.input_map import InputMap, Power
from eivor.signals.signals import Signals

#: Standard acceleration of gravity [m/s^2].
GRAVITY = 9.80665

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
        checks.kind(
            "input_map", self.input_map, InputMap, "an input map", "Leave it out, or give Power(2.0)."
        )
        checks.flag("intercept", self.intercept)

    @property
    def parameters(self) -> tuple[Parameter, Parameter]:
        """Viscous friction and input gain."""
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
            Its rows are cut when they are asked for.
        """
        checks.kind("signals", signals, Signals, "Signals", "Make them: ev.Signals(rate_hz, channels).")
        check_columns("instruments", instruments)
        own = (Column(""),) if instruments and self.intercept else ()
        about_hover = "specific_force_z" not in signals.channels and "acceleration_z" in signals.channels
        equation = self.equation("acceleration_z" if about_hover else "specific_force_z")
        return SignalRegression(signals, equation, (*instruments, *own))

    def regression_lag(self, instruments: tuple[Column, ...] = ()) -> int:
        """Samples that a row reaches back."""
        return max((column.lag for column in instruments), default=0)
