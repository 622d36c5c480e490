"""Controllers of vertical motion: what the excitation is, and how the input follows from measurements.

Both close the same inner loop, which flight controllers have: with the error d = velocity setpoint less
*measured* velocity,

    u[k] = velocity_gain d[k] + velocity_integral_gain T (d[0] + ... + d[k])

The setpoint is the reference itself, or altitude_gain (reference altitude - *measured* altitude). Since
the controller sees what is measured, the noise of these channels moves the vehicle.

The altitude controller of `simulation.flights` is another one: it asks for an acceleration, fed forward from
the trajectory, and inverts and limits the thrust. That is not linear, while the law here is a row of the
loop's matrix; they have the two gains in common and no computation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from eivor.errors import ParameterError
from eivor.simulation.sources.parameter_checks import finite, positive


@dataclass(frozen=True, slots=True)
class Feedback:
    """A controller's law, u = proportional d + integral T sum(d).

    Here d = reference_gain reference - measured velocity - altitude_gain measured altitude.

    Parameters
    ----------
    reference_gain : float
        Velocity setpoint per unit of the reference.
    altitude_gain : float
        Velocity setpoint per altitude missing [1/s].
    proportional, integral : float
        Input per velocity missing [input per m/s], and per metre that it adds up to.
    """

    reference_gain: float
    altitude_gain: float
    proportional: float
    integral: float


class Control(ABC):
    """Where the input comes from."""

    @property
    @abstractmethod
    def reference(self) -> str:
        """Channel that the excitation is: `input`, or the reference of a controller."""

    @property
    @abstractmethod
    def feedback(self) -> Feedback | None:
        """The law, None in open loop."""


@dataclass(frozen=True, slots=True)
class OpenLoop(Control):
    """No control: the excitation is the input."""

    @property
    def reference(self) -> str:
        """The input."""
        return "input"

    @property
    def feedback(self) -> Feedback | None:
        """None."""
        return None


@dataclass(frozen=True, slots=True)
class VelocityControl(Control):
    """PI control of the measured velocity: the excitation is its reference [m/s].

    Parameters
    ----------
    velocity_gain : float
        Input per velocity missing [input per m/s].
    velocity_integral_gain : float
        Input per metre that the missing velocity adds up to.

    Raises
    ------
    ParameterError
        When a gain is not finite, or both are zero.
    """

    velocity_gain: float
    velocity_integral_gain: float = 0.0

    def __post_init__(self) -> None:
        _check_velocity_gains(self.velocity_gain, self.velocity_integral_gain)

    @property
    def reference(self) -> str:
        """Velocity."""
        return "reference_velocity_z"

    @property
    def feedback(self) -> Feedback | None:
        """The reference is the setpoint."""
        return Feedback(1.0, 0.0, self.velocity_gain, self.velocity_integral_gain)


@dataclass(frozen=True, slots=True)
class AltitudeControl(Control):
    """Proportional control of the measured altitude over PI control of the measured velocity.

    The excitation is the reference altitude [m].

    Parameters
    ----------
    altitude_gain : float
        Velocity setpoint per altitude missing [1/s].
    velocity_gain, velocity_integral_gain : float
        Input per velocity missing [input per m/s], and per metre that it adds up to.

    Raises
    ------
    ParameterError
        When a gain is not finite, the altitude's is not above zero, or both of the velocity are zero.
    """

    altitude_gain: float
    velocity_gain: float
    velocity_integral_gain: float = 0.0

    def __post_init__(self) -> None:
        positive("altitude_gain", self.altitude_gain)
        _check_velocity_gains(self.velocity_gain, self.velocity_integral_gain)

    @property
    def reference(self) -> str:
        """Altitude."""
        return "reference_position_z"

    @property
    def feedback(self) -> Feedback | None:
        """The setpoint is the altitude that is missing, times the gain."""
        gain = self.altitude_gain
        return Feedback(gain, gain, self.velocity_gain, self.velocity_integral_gain)


def _check_velocity_gains(proportional: float, integral: float) -> None:
    finite("velocity_gain", proportional)
    finite("velocity_integral_gain", integral)
    if proportional == 0.0 and integral == 0.0:
        raise ParameterError(
            "a controller with a velocity_gain or a velocity_integral_gain",
            "both zero",
            "Give one of them, or leave the control out for open loop.",
        )
