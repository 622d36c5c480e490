"""A scenario: everything that a simulated record of vertical motion depends on, as data.

The record's randomness comes from one generator, out of which every source draws its own stream, so that
changing one source leaves the others' realisations as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.signals.noise import MeasurementNoise
from eivor.signals.signals import Signals
from eivor.simulation.records.control import AltitudeControl, Control, OpenLoop
from eivor.simulation.records.sampled_loop import check_stable
from eivor.simulation.records.sampled_vehicle import SampledVehicle, sampled_vehicle
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.excitation import Excitation, PaperInput

#: Channels that are measured with noise in every record.
ALWAYS_MEASURED = ("velocity_z", "acceleration_z", "input")
#: All that are measured with noise; the altitude under altitude control only.
NOISY_CHANNELS = (*ALWAYS_MEASURED, "position_z")
#: Fewest samples of a record.
LEAST_SAMPLES = 2
#: What to say to those who name the response of a recording.
ABOUT_HOVER = "A scenario moves about hover, without gravity: its response is acceleration_z, which is z''."


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
        The input in open loop, the reference under control.
    noise : mapping of str to MeasurementNoise
        Measurement noise of `velocity_z`, `acceleration_z` and `input`, and under altitude control of
        `position_z`, in their units.
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
    control : Control
        What makes the input: open loop, or a controller of velocity or altitude.

    Raises
    ------
    ParameterError
        When a number is outside its range, a channel is not measured, a disturbance is to be
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
    control: Control = field(default_factory=OpenLoop)

    def __post_init__(self) -> None:
        self._check_types()
        _check(self.viscous_friction >= 0.0, "viscous_friction of zero or more", self.viscous_friction)
        _check(True, "a finite input_gain", self.input_gain)
        _check(self.rate_hz > 0.0, "rate_hz above zero", self.rate_hz)
        _check(self.samples >= LEAST_SAMPLES, f"samples of {LEAST_SAMPLES} or more", self.samples)
        for name, ratio in self.noise_to_signal.items():
            _check(ratio >= 0.0, f"noise_to_signal of zero or more for {name}", ratio)
        for name in (*self.noise, *self.noise_to_signal):
            if name not in self.measured:
                raise ParameterError(
                    f"noise of {', '.join(self.measured)}",
                    f"noise of '{name}'",
                    _REMEDIES.get(name, "Name one of these channels."),
                )
        if self.disturbance_to_signal is not None:
            ratio = self.disturbance_to_signal
            _check(ratio >= 0.0, "disturbance_to_signal of zero or more", ratio)
            if self.disturbance is None:
                raise ParameterError(
                    "a disturbance to scale", "disturbance_to_signal alone", "Give the disturbance as well."
                )
        if self.controlled and self.intersample is not Intersample.HOLD:
            raise ParameterError(
                "an input that is held between samples, as a sampled controller gives it",
                f"intersample '{self.intersample.value}' under control",
                "Use hold, or leave the control out.",
            )
        check_stable(self.vehicle, self.control)

    def _check_types(self) -> None:
        for name in ("viscous_friction", "input_gain", "rate_hz"):
            checks.number(name, getattr(self, name))
        checks.whole("samples", self.samples)
        checks.kind("excitation", self.excitation, Excitation, "an excitation")
        checks.mapping("noise", self.noise, MeasurementNoise, "noises")
        checks.mapping("noise_to_signal", self.noise_to_signal, checks.NUMBERS, "numbers")
        if self.disturbance is not None:
            checks.kind("disturbance", self.disturbance, Disturbance, "a disturbance")
        if self.disturbance_to_signal is not None:
            checks.number("disturbance_to_signal", self.disturbance_to_signal)
        checks.kind("route", self.route, Route, "a Route", "Give Route.EQUATION or Route.DYNAMICS.")
        checks.kind("intersample", self.intersample, Intersample, "an Intersample", "Give Intersample.HOLD.")
        checks.kind("control", self.control, Control, "a control")

    @property
    def step_s(self) -> float:
        """Time between samples [s]."""
        return 1.0 / self.rate_hz

    @property
    def vehicle(self) -> SampledVehicle:
        """The vehicle from one sample to the next."""
        return sampled_vehicle(self.viscous_friction, self.input_gain, self.step_s)

    @property
    def controlled(self) -> bool:
        """Whether a controller makes the input; then the excitation is its reference."""
        return self.control.feedback is not None

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels of the record that are measured."""
        return NOISY_CHANNELS if isinstance(self.control, AltitudeControl) else ALWAYS_MEASURED

    @property
    def references(self) -> tuple[str, ...]:
        """Channels of the record that are known without error: the reference under control."""
        return (self.control.reference,) if self.controlled else ()


@dataclass(frozen=True)
class SimulatedRecord:
    """A simulated record and its truth.

    Parameters
    ----------
    signals : Signals
        As measured, with the noises that were really added declared (their true std), and under control
        the reference as `reference_velocity_z` or `reference_position_z`.
    truth : Signals
        The same channels without measurement noise; `disturbance` beside them.
    parameters : mapping of str to float
        viscous_friction and input_gain.
    """

    signals: Signals
    truth: Signals
    parameters: Mapping[str, float]


#: For channels that a scenario does not measure, or not always.
_REMEDIES = {
    "position_z": "The altitude is measured under altitude control only.",
    "specific_force_z": ABOUT_HOVER,
}


def _check(in_range: bool, expected: str, value: float | int) -> None:
    if not (in_range and np.isfinite(value)):
        raise ParameterError(expected, f"{value}", "Correct the scenario.")
