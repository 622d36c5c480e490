"""What a flight meets: references, wind, torques from outside, errors of sensors; each of its own stream."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.flights.trajectories import altitude_reference
from eivor.simulation.rigid_body.spec import AxisExcitations, RigidBodyFlightSpec
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.excitation import Excitation


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What one flight meets, a row for each step.

    Parameters
    ----------
    height : ndarray, shape (n, 3)
        Height [m], climb rate [m/s] and acceleration [m/s^2] that are asked for.
    attitude : ndarray, shape (n, 4)
        Attitude that is asked for, w, x, y, z.
    injected : ndarray, shape (n, 3)
        What is added to the torque setpoints.
    wind : ndarray, shape (n, 3)
        Velocity of the air [m/s].
    disturbance : ndarray, shape (n, 3)
        Torque from outside [N m].
    rate_error, attitude_error, velocity_error, position_error, force_error : ndarray, shape (n, 3)
        Errors of the sensors, before their filters.
    speed_error : ndarray, shape (n, rotors)
        Likewise of the rotors' speeds.
    """

    height: Float[np.ndarray, "n 3"]
    attitude: Float[np.ndarray, "n 4"]
    injected: Float[np.ndarray, "n 3"]
    wind: Float[np.ndarray, "n 3"]
    disturbance: Float[np.ndarray, "n 3"]
    rate_error: Float[np.ndarray, "n 3"]
    attitude_error: Float[np.ndarray, "n 3"]
    velocity_error: Float[np.ndarray, "n 3"]
    position_error: Float[np.ndarray, "n 3"]
    force_error: Float[np.ndarray, "n 3"]
    speed_error: Float[np.ndarray, "n rotors"]


def surroundings_of(spec: RigidBodyFlightSpec) -> Surroundings:
    """Draw everything that a flight meets.

    Parameters
    ----------
    spec : RigidBodyFlightSpec
        The flight. Each part has a stream of its own, so that a change of one leaves the others as they were.
    """
    height, angles, injected, air, torque, *sensing = _streams(spec.seed)
    count, step_s, sensors = spec.count, spec.step_s, spec.sensors
    reference = altitude_reference(
        spec.trajectory, count=count, step_s=step_s, rng=height, vigour=spec.vigour
    )
    about = (spec.torque_disturbance.roll, spec.torque_disturbance.pitch, spec.torque_disturbance.yaw)
    accelerations = _series(about, count, step_s, torque)
    rotors = spec.vehicle.rotors.count
    of_speeds = sensors.rotor_speed
    period = round(spec.rate_hz / spec.controller.rate_hz)
    held = np.arange(count) // period * period  # what is injected is held as torque setpoints are
    return Surroundings(
        height=np.column_stack([reference.position, reference.velocity, reference.acceleration]),
        attitude=quaternions(_excited(spec.attitude, count, step_s, angles)),
        injected=_excited(spec.injection, count, step_s, injected)[held],
        wind=np.array(spec.wind.steady)
        + _series((spec.wind.x, spec.wind.y, spec.wind.z), count, step_s, air),
        disturbance=accelerations @ spec.vehicle.inertia_matrix,
        rate_error=sensors.angular_rate.errors(count, 3, sensing[0]),
        attitude_error=sensors.attitude.errors(count, 3, sensing[1]),
        velocity_error=sensors.velocity.errors(count, 3, sensing[2]),
        position_error=sensors.position.errors(count, 3, sensing[3]),
        force_error=sensors.specific_force.errors(count, 3, sensing[4]),
        speed_error=of_speeds.errors(count, rotors, sensing[5]) if of_speeds else np.zeros((count, rotors)),
    )


def stamping_stream(spec: RigidBodyFlightSpec) -> np.random.Generator:
    """Stream of the stamps' errors."""
    return _streams(spec.seed)[-1]


def _streams(seed: int) -> list[np.random.Generator]:
    return [np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(seed).spawn(12)]


def quaternions(angles: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Attitudes w, x, y, z of roll, pitch and yaw [rad]: yaw first, then pitch, then roll."""
    (a, b, c), (d, e, f) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    return np.column_stack(
        [
            a * b * c + d * e * f,
            d * b * c - a * e * f,
            a * e * c + d * b * f,
            a * b * f - d * e * c,
        ]
    )


def _excited(
    axes: AxisExcitations, count: int, step_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "count 3"]:
    return _series((axes.roll, axes.pitch, axes.yaw), count, step_s, rng)


def _series(
    sources: tuple[Excitation | Disturbance | None, ...], count: int, step_s: float, rng: np.random.Generator
) -> Float[np.ndarray, "count axes"]:
    """Each source's series from a stream of its own; zeros where there is none."""
    streams = rng.spawn(len(sources))
    return np.column_stack(
        [
            np.zeros(count) if source is None else source.sample(count, step_s, stream)
            for source, stream in zip(sources, streams, strict=True)
        ]
    )
