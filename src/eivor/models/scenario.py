"""A scenario: everything that a simulated record of vertical motion depends on, as data.

The record's randomness comes from one generator, out of which every source draws its own stream, so that
changing one source leaves the others' realisations as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from eivor.signals.disturbance import Disturbance
from eivor.signals.excitation import Excitation, PaperInput
from eivor.signals.noise import MeasurementNoise
from eivor.signals.signals import Signals


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
        channel over the record; the noise given is the shape (its own std is replaced).
    disturbance : Disturbance, optional
        Of the equation of motion [m/s^2].
    disturbance_to_signal : float, optional
        Scales the disturbance to this share of the standard deviation of z''.
    route : Route
        Where the disturbance enters.
    intersample : Intersample
        Of the input.
    velocity_gain, velocity_integral_gain : float
        PI control of the measured velocity; both zero for open loop.
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
