"""A scenario: everything that a simulated record of vertical motion depends on, as data.

The record's randomness comes from one generator, out of which every source draws its own stream, so that
changing one source leaves the others' realisations as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from eivor.errors import ParameterError
from eivor.signals.disturbance import Disturbance
from eivor.signals.excitation import Excitation, PaperInput
from eivor.signals.noise import MeasurementNoise
from eivor.signals.signals import Signals

#: Channels that are measured with noise.
NOISY_CHANNELS = ("velocity_z", "specific_force_z", "input")
#: Fewest samples of a record.
LEAST_SAMPLES = 2


class Route(Enum):
    """Where a disturbance enters; the two differ."""

    EQUATION = "equation"
    """Only the measured response is shifted: the paper's simulation."""
    DYNAMICS = "dynamics"
    """It moves the vehicle, so that the velocity responds: a gust."""


class Intersample(Enum):
    """What the input does between samples."""

    HOLD = "hold"
    LINEAR = "linear"


@dataclass(frozen=True)
class Scenario:
    """What to simulate.

    Parameters
    ----------
    viscous_friction, input_gain : float
        K [1/s] and K_u [m/s^2 per unit of input].
    rate_hz : float
        Samples per second [Hz].
    samples : int
        Length of the record.
    excitation : Excitation
        The input in open loop, the velocity reference under control.
    noise : mapping of str to MeasurementNoise
        Measurement noise of `velocity_z`, `specific_force_z` and `input`, in their units.
    noise_to_signal : mapping of str to float
        For channels named here the noise's std is this ratio times the standard deviation of the noise-free
        channel over the record; the noise given is the shape (its own std is replaced), white when none is.
    disturbance : Disturbance, optional
        Of the equation of motion [m/s^2].
    disturbance_to_signal : float, optional
        Scales the disturbance to this share of the standard deviation of z''.
    route : Route
        Where the disturbance enters.
    intersample : Intersample
        Of the input.
    velocity_gain, velocity_integral_gain : float
        PI control of the measured velocity [input per m/s, and per m]; both zero for open loop.

    Raises
    ------
    ParameterError
        When a number is outside its range, a channel is none of `NOISY_CHANNELS`, a disturbance is to be
        scaled that is not there, the control loop is unstable, or a controller is to change its output
        between samples.
    """

    viscous_friction: float
    input_gain: float
    rate_hz: float = 5.0
    samples: int = 4000
    excitation: Excitation = field(default_factory=PaperInput)
    noise: Mapping[str, MeasurementNoise] = field(default_factory=dict)
    noise_to_signal: Mapping[str, float] = field(default_factory=dict)
    disturbance: Disturbance | None = None
    disturbance_to_signal: float | None = None
    route: Route = Route.EQUATION
    intersample: Intersample = Intersample.HOLD
    velocity_gain: float = 0.0
    velocity_integral_gain: float = 0.0

    def __post_init__(self) -> None:
        _check(self.viscous_friction >= 0.0, "viscous_friction of zero or more", self.viscous_friction)
        _check(True, "a finite input_gain", self.input_gain)
        _check(self.rate_hz > 0.0, "rate_hz above zero", self.rate_hz)
        _check(self.samples >= LEAST_SAMPLES, f"samples of {LEAST_SAMPLES} or more", self.samples)
        _check(True, "a finite velocity_gain", self.velocity_gain)
        _check(True, "a finite velocity_integral_gain", self.velocity_integral_gain)
        for name, ratio in self.noise_to_signal.items():
            _check(ratio >= 0.0, f"noise_to_signal of zero or more for {name}", ratio)
        for name in (*self.noise, *self.noise_to_signal):
            if name not in NOISY_CHANNELS:
                raise ParameterError(
                    f"noise of {', '.join(NOISY_CHANNELS)}",
                    f"noise of '{name}'",
                    "Name one of these channels.",
                )
        if self.disturbance_to_signal is not None:
            ratio = self.disturbance_to_signal
            _check(ratio >= 0.0, "disturbance_to_signal of zero or more", ratio)
            if self.disturbance is None:
                raise ParameterError(
                    "a disturbance to scale", "disturbance_to_signal alone", "Give the disturbance as well."
                )
        if self.controlled:
            self._check_control()

    @property
    def step_s(self) -> float:
        """Time between samples [s]."""
        return 1.0 / self.rate_hz

    @property
    def controlled(self) -> bool:
        """Whether the velocity is under control; then the excitation is its reference."""
        return self.velocity_gain != 0.0 or self.velocity_integral_gain != 0.0

    def _check_control(self) -> None:
        if self.intersample is not Intersample.HOLD:
            raise ParameterError(
                "an input that is held between samples, as a sampled controller gives it",
                f"intersample '{self.intersample.value}' under control",
                "Use hold, or set both gains to zero.",
            )
        # Velocity and summed error, one step on: the determinant and the trace of the loop's matrix.
        x = self.viscous_friction * self.step_s
        effect = self.input_gain * self.step_s * (1.0 if x == 0.0 else -float(np.expm1(-x)) / x)
        kept = float(np.exp(-x)) - effect * self.velocity_gain
        summed = effect * self.velocity_integral_gain * self.step_s
        trace, determinant = kept + 1.0 - summed, kept
        # Jury's conditions, the first of which an integrator that is not used meets with equality.
        slow = summed > 0.0 or self.velocity_integral_gain == 0.0
        if not (slow and abs(determinant) < 1.0 and 1.0 + trace + determinant > 0.0):
            raise ParameterError(
                "gains with which the control loop is stable",
                f"velocity_gain={self.velocity_gain}, velocity_integral_gain={self.velocity_integral_gain}"
                f" at input_gain={self.input_gain} and {self.rate_hz} Hz",
                "Make the gains smaller, or of the sign of input_gain.",
            )


@dataclass(frozen=True)
class SimulatedRecord:
    """A simulated record and its truth.

    Parameters
    ----------
    signals : Signals
        As measured, with the noises that were really added declared (their true std), and under control
        the reference as `reference_velocity_z`.
    truth : Signals
        The same channels without measurement noise; `disturbance` beside them.
    parameters : mapping of str to float
        viscous_friction and input_gain.
    """

    signals: Signals
    truth: Signals
    parameters: Mapping[str, float]


def _check(in_range: bool, expected: str, value: float | int) -> None:
    if not (in_range and np.isfinite(value)):
        raise ParameterError(expected, f"{value}", "Correct the scenario.")
