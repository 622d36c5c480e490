"""How a body and its rotors move on over a step in which commands, wind and disturbances are held.

A rotor's speed then has a closed form, which is used: n = command + (n0 - command) exp(-t/lag), with the lag
of the direction in which it goes. Only the body's state is integrated. The attitude is brought back to length
1 after each step.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.coefficients import Coefficients, Value
from eivor.motions.rigid_body.dynamics import Body, Triple, body_derivative, speed_derivative
from eivor.shapes import Float

#: State of the body, and of its rotors.
Moved: TypeAlias = tuple[Body, list[Value]]


@dataclass(frozen=True, slots=True)
class HeldInputs:
    """What acts on a vehicle over a step.

    Parameters
    ----------
    command : sequence of components
        What each rotor goes for, within its limits; as floats, or one array of shape (rotors, flights).
    wind : three components
        Velocity of the air [m/s].
    disturbance : three components
        Torque from outside, on the body's axes [N m].
    """

    command: Sequence[Value]
    wind: Triple = (0.0, 0.0, 0.0)
    disturbance: Triple = (0.0, 0.0, 0.0)


class Integrator(ABC):
    """A way to move on in time."""

    @abstractmethod
    def stepper(self, coefficients: Coefficients, step_s: float) -> Stepper:
        """Return what makes steps of this length [s] for vehicles with these coefficients."""

    @property
    @abstractmethod
    def side_by_side(self) -> bool:
        """Whether several flights may be moved on together without a difference to any of them."""


class Stepper(ABC):
    """What makes the steps of a flight, or of several side by side."""

    @abstractmethod
    def step(self, body: Body, speeds: Sequence[Value], held: HeldInputs) -> Moved:
        """State of body and rotors a step later. Performs no checks."""


@dataclass(frozen=True, slots=True)
class RungeKutta4(Integrator):
    """The classical method of the fourth order, one step at a time."""

    def stepper(self, coefficients: Coefficients, step_s: float) -> Stepper:
        """Return steps of this length [s]."""
        return _FixedStep(coefficients, step_s)

    @property
    def side_by_side(self) -> bool:
        """Every flight is moved on by itself."""
        return True


@dataclass(frozen=True, slots=True)
class AdaptiveSteps(Integrator):
    """SciPy's integrators, which divide each step by the error that they estimate; some thirty times slower.

    Parameters
    ----------
    rtol, atol : float
        Relative and absolute tolerance of every component.
    method : str
        Of `scipy.integrate.solve_ivp`.

    Raises
    ------
    ParameterError
        When a tolerance is not above zero, or the method is unknown.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    method: str = "DOP853"

    def __post_init__(self) -> None:
        if not (0.0 < self.rtol < 1.0 and 0.0 < self.atol < math.inf):
            raise ParameterError(
                "tolerances above zero, the relative one below one",
                f"rtol={self.rtol}, atol={self.atol}",
                "Correct the integrator.",
            )
        methods = ("RK45", "DOP853", "Radau", "BDF", "LSODA")
        if self.method not in methods:
            raise ParameterError(f"a method out of {', '.join(methods)}", f"{self.method!r}", "Choose one.")

    def stepper(self, coefficients: Coefficients, step_s: float) -> Stepper:
        """Return steps of this length [s], of a single flight."""
        return _DividedStep(coefficients, step_s, self)

    @property
    def side_by_side(self) -> bool:
        """Flights would share their steps."""
        return False


class _FixedStep(Stepper):
    """Runge and Kutta's four slopes."""

    def __init__(self, coefficients: Coefficients, step_s: float) -> None:
        self._coefficients = coefficients
        self._step_s = step_s
        self._half = RotorCourse(coefficients, step_s / 2.0)

    def step(self, body: Body, speeds: Sequence[Value], held: HeldInputs) -> Moved:
        c, h = self._coefficients, self._step_s
        command, wind, disturbance = held.command, held.wind, held.disturbance
        middle = self._half.after(speeds, command)
        end = self._half.after(middle, command)
        change = self._spin_up(middle, command)
        k1 = body_derivative(c, body, speeds, self._spin_up(speeds, command), wind, disturbance)
        k2 = body_derivative(c, _ahead(body, k1, h / 2.0), middle, change, wind, disturbance)
        k3 = body_derivative(c, _ahead(body, k2, h / 2.0), middle, change, wind, disturbance)
        k4 = body_derivative(c, _ahead(body, k3, h), end, self._spin_up(end, command), wind, disturbance)
        slope = _weighted(k1, k2, k3, k4)
        return unit_attitude(_ahead(body, slope, h / 6.0)), end

    def _spin_up(self, speeds: Sequence[Value], command: Sequence[Value]) -> Sequence[Value]:
        """Derivatives of the speeds, where they matter."""
        c = self._coefficients
        return speed_derivative(c, speeds, command) if c.gyroscopic else ()


class _DividedStep(Stepper):
    """SciPy's steps within a step."""

    def __init__(self, coefficients: Coefficients, step_s: float, options: AdaptiveSteps) -> None:
        self._coefficients, self._step_s, self._options = coefficients, step_s, options

    def step(self, body: Body, speeds: Sequence[Value], held: HeldInputs) -> Moved:
        from scipy.integrate import solve_ivp

        coefficients, command = self._coefficients, held.command

        def slope(time: float, state: Float[np.ndarray, " 13"]) -> list[Value]:
            now = RotorCourse(coefficients, time).after(speeds, command)
            change = speed_derivative(coefficients, now, command)
            return body_derivative(coefficients, state.tolist(), now, change, held.wind, held.disturbance)

        options = self._options
        # A first step that is given, not guessed: most of these steps need no other.
        first = 1.0 / max(1.0 / self._step_s, coefficients.rate_up, coefficients.rate_down)
        solved = solve_ivp(
            slope,
            (0.0, self._step_s),
            np.array(body),
            method=options.method,
            rtol=options.rtol,
            atol=options.atol,
            first_step=first,
        )
        end = RotorCourse(coefficients, self._step_s).after(speeds, command)
        return unit_attitude(solved.y[:, -1].tolist()), end


class RotorCourse:
    """Speeds of rotors a fixed time later, under a held command: the closed form.

    Parameters
    ----------
    coefficients : Coefficients
        With the rotors' time constants.
    time_s : float
        How much later [s].
    """

    def __init__(self, coefficients: Coefficients, time_s: float) -> None:
        self._down = _decay(time_s * coefficients.rate_down)
        self._difference = _decay(time_s * coefficients.rate_up) - self._down

    def after(self, speeds: Sequence[Value], command: Sequence[Value]) -> list[Value]:
        """Speeds that much later."""
        return [
            asked + (speed - asked) * (self._down + self._difference * (asked > speed))
            for speed, asked in zip(speeds, command, strict=True)
        ]


def _decay(lags: Value) -> Value:
    return math.exp(-lags) if isinstance(lags, float) else np.exp(-lags)


def _ahead(state: Body, slope: Sequence[Value], time_s: float) -> Body:
    if isinstance(state, np.ndarray):
        return state + time_s * np.array(slope)
    return [x + time_s * k for x, k in zip(state, slope, strict=True)]


def _weighted(k1: list[Value], k2: list[Value], k3: list[Value], k4: list[Value]) -> list[Value]:
    """Six times the mean slope."""
    return [a + 2.0 * (b + c) + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]


def unit_attitude(body: Body) -> Body:
    """State with an attitude of length 1."""
    w, x, y, z = body[6:10]
    short = (w * w + x * x + y * y + z * z) ** -0.5
    if isinstance(body, np.ndarray):
        body[6:10] *= short
    else:
        body[6:10] = [w * short, x * short, y * short, z * short]
    return body
