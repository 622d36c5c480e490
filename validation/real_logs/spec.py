"""Specification of a flight and of the logger that records it: everything that both are functions of."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from eivor.errors import UsageError
from eivor.simulation.environment import SensorNoise
from eivor.simulation.vertical import AltitudeController

#: Step of the simulation [s]; controllers and delays are whole steps.
STEP_S = 0.002
#: The velocity loop is never quicker than this [1/s].
LARGEST_VELOCITY_GAIN = 5.0


class Reference(StrEnum):
    """What the altitude reference does; the first three as `eivor.simulation` has them."""

    STEPS = "steps"
    MULTISINE = "multisine"
    CHIRP = "chirp"
    RAMPS = "ramps"
    SINE = "sine"


class Jitter(StrEnum):
    """What is irregular in a log: nothing, the stamps that it writes, or the instants that it samples."""

    NONE = "none"
    STAMPS = "stamps"
    INSTANTS = "instants"


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """A vehicle, its surroundings and its controller; unlisted units are SI."""

    viscous_friction: float = 0.4  # K [1/s] and the coefficient of v|v| [1/m]
    quadratic_drag: float = 0.0
    hover_input: float = 0.5  # Command at which it hovers, a share of full command
    thrust_share: float = 1.0  # Thrust goes as (1 - s) w + s w^p with the rotor state w
    thrust_power: float = 2.0
    actuator_lag: float = 0.04  # Time constant of the rotor upwards, and delay of its command [s]
    delay: float = 0.0
    slower_down: float = 1.0  # Time constant downwards over that upwards
    load_sag: float = 0.0  # c in the speed w (1 - c (x^3 - 1)) with x = w over its value at hover
    voltage_sag: float = 0.0  # Share of the voltage that is lost over the flight; speed follows it
    # Thrust gains 1 / (1 - (R / 4 z)^2) above a ground that is `least_height` below the lowest reference; no
    # ground for a radius of zero
    rotor_radius: float = 0.0
    least_height: float = 2.0
    # Largest speed of the horizontal flight [m/s], and the friction along the body's x [1/s]
    horizontal_speed: float = 0.0
    horizontal_friction: float = 0.3
    # Share of the horizontal speed that goes along with the climbs, from 0 to 1; the rest goes back and forth
    # by itself
    diagonal: float = 0.0
    gust_rms: float = 0.0  # Vertical wind: its standard deviation and correlation time, and its mean
    gust_correlation: float = 1.0
    updraft: float = 0.0
    tilt_rms: float = 0.03  # Standard deviation of roll and pitch [rad], before they are smoothed
    controller_hz: float = 100.0  # Rate of the controller
    quickness: float = 0.35  # As in `eivor.simulation.vertical`
    position_share: float = 0.3
    integral_share: float = 0.05

    @property
    def gains(self) -> AltitudeController:
        """Gains that suit the actuator and the controller's rate."""
        late = self.actuator_lag + self.delay + 0.5 / self.controller_hz
        velocity = min(self.quickness / late, LARGEST_VELOCITY_GAIN)
        return AltitudeController(self.position_share * velocity, velocity, self.integral_share * velocity**2)

    @property
    def controller_steps(self) -> int:
        """Steps of the simulation in one of the controller."""
        return round(1.0 / (self.controller_hz * STEP_S))


@dataclass(frozen=True, slots=True)
class LoggerSpec:
    """Sensors and the logger."""

    command_hz: float = 100.0  # Rates; commands are never logged faster than the controller gives them
    reference_hz: float = 100.0
    velocity_hz: float = 100.0
    acceleration_hz: float = 100.0
    attitude_hz: float = 100.0
    jitter: Jitter = Jitter.NONE  # What is irregular
    jitter_s: float = 0.0  # Its standard deviation [s], at most `LARGEST_JITTER` of a channel's period
    dropouts: float = 0.0  # Times a minute at which the logger loses all channels, for up to half a second
    duplicates: float = 0.0  # Share of the samples that are written twice
    # Of accelerometer, velocity, position and attitude
    noise: SensorNoise = field(default_factory=SensorNoise)
    accelerometer_bias: float = 0.0  # Constant error along the body's z [m/s^2]
    velocity_delay: float = 0.0  # Pure delays and time constants of low-pass filters [s]
    velocity_filter: float = 0.0
    acceleration_delay: float = 0.0
    acceleration_filter: float = 0.0
    velocity_scale: float = 1.0  # What a true value of one is measured as
    acceleration_scale: float = 1.0
    tilt_error: float = 0.0  # Error of the pitch that attitude and accelerometer share [rad]
    voltage_logged: bool = False  # Whether the battery's voltage is in the log
    # Velocity and acceleration come from an estimator that learns the accelerometer's bias with this time
    # constant and fuses a velocity that is so late [s]; none when the time constant is zero
    bias_time: float = 0.0
    fused_late: float = 0.0


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """One flight."""

    vehicle: VehicleSpec = field(default_factory=VehicleSpec)  # What flies
    logger: LoggerSpec = field(default_factory=LoggerSpec)  # What records it
    reference: Reference = Reference.MULTISINE  # The altitude's
    frequency: float = 0.3  # Of a reference that is one sine [Hz]
    vigour: float = 0.8  # Share of the speed and acceleration that an excitation may reach
    duration: float = 60.0  # [s]
    seed: int = 0  # Of all random streams
    # Name of a vehicle of RotorPy, which then flies in place of the own simulator's; empty for none
    multirotor: str = ""

    def __post_init__(self) -> None:
        for what, seconds in (("period", 1.0 / self.vehicle.controller_hz), ("delay", self.vehicle.delay)):
            steps = seconds / STEP_S
            if abs(steps - round(steps)) > 1e-6:
                raise UsageError(
                    f"a {what} of whole steps of {STEP_S} s", f"{seconds:g} s", "Choose another one."
                )
        if not self.duration >= 2.0:
            raise UsageError("a flight of two seconds or more", f"{self.duration:g} s", "Fly longer.")

    @property
    def steps(self) -> int:
        """Steps of the simulation."""
        return round(self.duration / STEP_S)
