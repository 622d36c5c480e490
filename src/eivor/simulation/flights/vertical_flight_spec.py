"""Specifications of flights of the own simulator of vertical motion.

One rotor stands for all. Its state is a share of full command, thrust goes with its square, and K_u is g
over the squared hover command. Friction is linear, so that K and K_u are the same at every speed. K_u may
change during the flight: at once, as with a damaged propeller, or slowly, as with a battery that sags.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eivor.errors import UsageError
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.simulation.flights.closed_loop import SUBSTEPS, AltitudeController
from eivor.simulation.flights.sensor_noise import SensorNoise
from eivor.simulation.flights.trajectories import TrajectoryKind

#: Step of the controller and of the log [s].
STEP_S = 0.01
#: The velocity loop is never quicker than this [1/s].
LARGEST_VELOCITY_GAIN = 5.0


@dataclass(frozen=True, slots=True)
class VerticalFlightSpec:
    """Everything that a flight is a function of.

    Parameters
    ----------
    viscous_friction : float
        K [1/s].
    hover_input : float
        Command at which it hovers, a share of full command.
    actuator_lag, delay : float
        Time constant of the rotor and delay of its command [s]; the delay a multiple of 0.002.
    gust_rms, gust_correlation : float
        Standard deviation [m/s] and correlation time [s] of the vertical wind.
    noise : SensorNoise
        Of accelerometer, velocity, position and attitude.
    accelerometer_bias : float
        Constant error of the specific force [m/s^2].
    tilt_rms : float
        Standard deviation of roll and of pitch [rad], before they are smoothed.
    gain_after : float
        What K_u is multiplied by in the end; its controller does not know.
    gain_changes_at, gain_changes_over : float
        When it begins to change [s], and how long it takes [s]: zero for at once.
    trajectory : TrajectoryKind
        The altitude reference.
    vigour : float
        Share of the speed and acceleration that an excitation may reach.
    quickness : float
        Gain of the velocity loop times the sum of lag, delay and half a control step.
    position_share, integral_share : float
        Gain of the position loop over that of the velocity loop, and of the integrator over the square of
        the latter.
    seed : int
        Of the random streams.
    duration : float
        Of the flight [s], a multiple of 0.01.

    Raises
    ------
    UsageError
        When a value is out of its range.
    """

    viscous_friction: float = 0.4
    hover_input: float = 0.5
    actuator_lag: float = 0.04
    delay: float = 0.0
    gust_rms: float = 0.0
    gust_correlation: float = 1.0
    noise: SensorNoise = field(default_factory=SensorNoise)
    accelerometer_bias: float = 0.0
    tilt_rms: float = 0.05
    gain_after: float = 1.0
    gain_changes_at: float = 30.0
    gain_changes_over: float = 0.0
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE
    vigour: float = 1.0
    quickness: float = 0.35
    position_share: float = 0.3
    integral_share: float = 0.05
    seed: int = 0
    duration: float = 60.0

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(
                    f"{name} between {low:g} and {high:g}", f"{value}", "Correct the flight's specification."
                )
        substeps = self.delay / STEP_S * SUBSTEPS
        if abs(substeps - round(substeps)) > 1e-6:
            raise UsageError(
                f"a delay that is a multiple of {STEP_S / SUBSTEPS:g} s",
                f"{self.delay}",
                "The simulator delays whole substeps.",
            )

    @property
    def count(self) -> int:
        """Number of stamps."""
        return round(self.duration / STEP_S)

    @property
    def input_gain(self) -> float:
        """K_u at the beginning [m/s^2 per squared share of full command]."""
        return GRAVITY / self.hover_input**2

    @property
    def gain_share(self) -> Float[np.ndarray, " samples"]:
        """K_u at each stamp over that at the beginning."""
        since = STEP_S * np.arange(self.count) - self.gain_changes_at
        done = np.clip(since / max(self.gain_changes_over, STEP_S), 0.0, 1.0)
        share: Float[np.ndarray, " samples"] = 1.0 + (self.gain_after - 1.0) * done
        return share

    @property
    def controller(self) -> AltitudeController:
        """Gains that suit the actuator."""
        velocity = min(self.quickness / (self.actuator_lag + self.delay + STEP_S / 2), LARGEST_VELOCITY_GAIN)
        return AltitudeController(
            position_gain=self.position_share * velocity,
            velocity_gain=velocity,
            integral_gain=self.integral_share * velocity**2,
        )


#: What each number of a specification may be.
RANGES = {
    "viscous_friction": (1e-3, 2.0),
    "hover_input": (0.1, 0.9),
    "actuator_lag": (1e-3, 0.3),
    "delay": (0.0, 0.2),
    "gust_rms": (0.0, 5.0),
    "gust_correlation": (0.01, 100.0),
    "accelerometer_bias": (-2.0, 2.0),
    "tilt_rms": (0.0, 0.2),
    "gain_after": (0.4, 2.0),
    "gain_changes_at": (0.0, 3600.0),
    "gain_changes_over": (0.0, 3600.0),
    "vigour": (0.01, 2.0),
    "quickness": (0.01, 0.6),
    "position_share": (0.01, 0.6),
    "integral_share": (0.0, 0.25),
    "duration": (2.0, 3600.0),
}
