"""Closed-loop flights of the own simulator of vertical motion: many at once, and fast.

Conventions, settled here once:

* Controller and log run at 100 Hz. At each stamp the controller reads the noisy position and velocity
  that are logged, and its command is held until the next stamp; a delay of d means that the command
  issued at t reaches the rotor at t + d, and the log holds it at t.
* Noise is in the loop: the controller answers it. Its gains, the vehicle's tilt and the accelerometer's
  bias differ from flight to flight. Wind and tilt are held over a control step.
* Each flight draws trajectory, wind, sensors and tilt from streams of its own, spawned from its seed: a
  flight is a function of its specification and of nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.errors import UsageError
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state
from eivor.signals.recording import Recording
from eivor.simulation.flights.closed_loop import (
    AltitudeController,
    SimulatedMotion,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)
from eivor.simulation.flights.sensor_noise import SensorErrors, sensor_errors
from eivor.simulation.flights.simulated_log import simulated_recording
from eivor.simulation.flights.trajectories import Trajectory, altitude_reference
from eivor.simulation.flights.truth import FlightTruth, SimulatedFlight
from eivor.simulation.flights.vertical_flight_spec import STEP_S, VerticalFlightSpec
from eivor.simulation.flights.wind import gusts

#: Flights that are simulated side by side: memory stays flat, about a megabyte for a minute of each.
BATCH = 48
#: Roll and pitch wander with this correlation time, and are smooth over the second one [s].
TILT_CORRELATION_S = 1.0
TILT_SMOOTHING_S = 0.15
#: A vehicle this far from its reference is lost [m].
LOST_M = 5.0
#: Source of the channels.
SIMULATOR = "vertical"


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

    reference: Trajectory
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
    motion = simulate_vertical(
        vehicles,
        environment,
        step_s=STEP_S,
        controller=controller,
        gain_share=np.stack([spec.gain_share for spec in specs], axis=1),
    )
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
