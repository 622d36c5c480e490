"""Closed-loop flights of the own simulator of vertical motion: many at once, and fast.

Conventions, settled here once:

* Controller and log run at 100 Hz. At each stamp the controller reads the noisy position and velocity
  that are logged, and its command is held until the next stamp; a delay of d means that the command
  issued at t reaches the rotor at t + d, and the log holds it at t.
* One rotor stands for all. Its state is a share of full command, thrust goes with its square, and K_u is
  g over the squared hover command. Friction is linear, so that K and K_u are the same at every speed.
* Noise is in the loop: the controller answers it. Its gains, the vehicle's tilt and the accelerometer's
  bias differ from flight to flight. Wind and tilt are held over a control step.
* Each flight draws trajectory, wind, sensors and tilt from streams of its own, spawned from its seed: a
  flight is a function of its specification and of nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from eivor.errors import UsageError
from eivor.models.vertical import GRAVITY
from eivor.models.vertical_simulation import (
    SUBSTEPS,
    AltitudeController,
    SimulatedMotion,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)
from eivor.signals.actuator import actuator_state
from eivor.signals.recording import Recording
from eivor.studies.flight_truth import FlightTruth, SimulatedFlight
from eivor.studies.sensor_noise import SensorErrors, SensorNoise, sensor_errors
from eivor.studies.simulated_log import simulated_recording
from eivor.studies.trajectories import Reference, TrajectoryKind, altitude_reference
from eivor.studies.wind import gusts

#: Step of the controller and of the log [s].
STEP_S = 0.01
#: Flights that are simulated side by side: memory stays flat, about a megabyte for a minute of each.
BATCH = 48
#: The velocity loop is never quicker than this [1/s].
LARGEST_VELOCITY_GAIN = 5.0
#: Roll and pitch wander with this correlation time, and are smooth over the second one [s].
TILT_CORRELATION_S = 1.0
TILT_SMOOTHING_S = 0.15
#: A vehicle this far from its reference is lost [m].
LOST_M = 5.0
#: Source of the channels.
SIMULATOR = "vertical"


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
        [m/s^2]
    tilt_rms : float
        Standard deviation of roll and of pitch [rad], before they are smoothed.
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
        [s], a multiple of 0.01.

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
        """K_u [m/s^2 per squared share of full command]."""
        return GRAVITY / self.hover_input**2

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
    "vigour": (0.01, 2.0),
    "quickness": (0.01, 0.6),
    "position_share": (0.01, 0.6),
    "integral_share": (0.0, 0.25),
    "duration": (2.0, 3600.0),
}


def simulate_vertical_flights(specs: Sequence[VerticalFlightSpec]) -> Iterator[SimulatedFlight]:
    """Fly each specification and give its log and its truth, in order.

    Parameters
    ----------
    specs : sequence of VerticalFlightSpec
        All of one duration. Flights are simulated side by side in batches; which ones share a batch makes
        no difference to any of them.

    Yields
    ------
    SimulatedFlight
        Recording with the channels rotor_command_1, velocity_z, position_z, specific_force_z, cos_tilt and
        reference_*_z, and the truth.

    Raises
    ------
    UsageError
        When the durations differ.

    Notes
    -----
    About .03 s for a flight of 60 s in a full batch.
    """
    if len({spec.count for spec in specs}) > 1:
        durations = sorted({spec.duration for spec in specs})
        raise UsageError("flights of one duration", f"durations {durations} s", "Simulate them separately.")
    for first in range(0, len(specs), BATCH):
        yield from _batch(specs[first : first + BATCH])


def actual_state_recording(flight: SimulatedFlight) -> Recording:
    """Recording in which the rotor's actual state stands in place of its command (`rotor_speed_1`)."""
    log, truth = flight.recording, flight.truth
    held = {key: channel.values for key, channel in log.channels.items() if key.startswith("reference_")}
    sampled = {
        key: channel.values
        for key, channel in log.channels.items()
        if key not in held and not key.startswith("rotor_")
    }
    sampled["rotor_speed_1"] = truth.rotor_state[:, 0]
    return simulated_recording(log.name, simulator=SIMULATOR, time_s=truth.time_s, held=held, sampled=sampled)


@dataclass(frozen=True, slots=True)
class _Surroundings:
    """What one flight meets."""

    reference: Reference
    gust: Float[np.ndarray, " n"]
    angles: Float[np.ndarray, "n 2"]
    errors: SensorErrors


def _surroundings(spec: VerticalFlightSpec) -> _Surroundings:
    shape, air, sensors, attitude = (
        np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(spec.seed).spawn(4)
    )
    reference = altitude_reference(
        spec.trajectory, count=spec.count, step_s=STEP_S, rng=shape, vigour=spec.vigour
    )
    wind = gusts(
        count=spec.count,
        axes=1,
        step_s=STEP_S,
        rms=spec.gust_rms,
        correlation_s=spec.gust_correlation,
        rng=air,
    )
    angles = gusts(
        count=spec.count,
        axes=2,
        step_s=STEP_S,
        rms=spec.tilt_rms,
        correlation_s=TILT_CORRELATION_S,
        rng=attitude,
    )
    smooth = actuator_state(angles, step_s=STEP_S, lag_s=TILT_SMOOTHING_S, delay_s=0.0)
    errors = sensor_errors(spec.noise, count=spec.count, axes=2, rng=sensors)
    return _Surroundings(reference, wind[:, 0], smooth, errors)


def _batch(specs: Sequence[VerticalFlightSpec]) -> Iterator[SimulatedFlight]:
    met = [_surroundings(spec) for spec in specs]
    gains = [spec.controller for spec in specs]
    vehicles = VerticalVehicles(
        viscous_friction=np.array([spec.viscous_friction for spec in specs]),
        input_gain=np.array([spec.input_gain for spec in specs]),
        lag_s=np.array([spec.actuator_lag for spec in specs]),
        delay_s=np.array([spec.delay for spec in specs]),
    )
    environment = VerticalEnvironment(
        reference_position=np.stack([s.reference.position for s in met], axis=1),
        reference_velocity=np.stack([s.reference.velocity for s in met], axis=1),
        reference_acceleration=np.stack([s.reference.acceleration for s in met], axis=1),
        gust=np.stack([s.gust for s in met], axis=1),
        cos_tilt=np.stack([np.cos(s.angles).prod(axis=1) for s in met], axis=1),
        position_noise=np.stack([s.errors.position[:, 0] for s in met], axis=1),
        velocity_noise=np.stack([s.errors.velocity[:, 0] for s in met], axis=1),
        acceleration_noise=np.stack([s.errors.acceleration[:, 0] for s in met], axis=1),
    )
    controller = AltitudeController(
        position_gain=np.array([gain.position_gain for gain in gains]),
        velocity_gain=np.array([gain.velocity_gain for gain in gains]),
        integral_gain=np.array([gain.integral_gain for gain in gains]),
    )
    motion = simulate_vertical(vehicles, environment, step_s=STEP_S, controller=controller)
    for number, (spec, surroundings) in enumerate(zip(specs, met, strict=True)):
        yield _flight(spec, surroundings, motion, number)


def _flight(
    spec: VerticalFlightSpec, met: _Surroundings, motion: SimulatedMotion, number: int
) -> SimulatedFlight:
    time = STEP_S * np.arange(spec.count)
    velocity, force = motion.velocity[:, number], motion.specific_force[:, number]
    truth = FlightTruth(
        time_s=time,
        specific_force_z=force.copy(),
        air_velocity_z=velocity - met.gust,
        rotor_state=motion.rotor_state[:, [number]],
        cos_tilt=np.cos(met.angles).prod(axis=1),
        actuator_lag=spec.actuator_lag,
        delay=spec.delay,
        viscous_friction=spec.viscous_friction,
        input_gain=spec.input_gain,
        hover_input=spec.hover_input,
    )
    recording = simulated_recording(
        f"vertical simulator, {spec.trajectory}, seed {spec.seed}",
        simulator=SIMULATOR,
        time_s=time,
        held={
            "rotor_command_1": motion.command[:, number],
            "reference_position_z": met.reference.position,
            "reference_velocity_z": met.reference.velocity,
            "reference_acceleration_z": met.reference.acceleration,
        },
        sampled={
            "position_z": motion.position[:, number] + met.errors.position[:, 0],
            "velocity_z": velocity + met.errors.velocity[:, 0],
            "specific_force_z": force + met.errors.acceleration[:, 0] + spec.accelerometer_bias,
            "cos_tilt": np.cos(met.angles + met.errors.attitude).prod(axis=1),
        },
    )
    flew = bool(np.abs(motion.position[:, number] - met.reference.position).max() < LOST_M)
    return SimulatedFlight(recording, truth, flew)
