"""Flights of this study's own simulator, side by side."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.signals.actuator import actuator_state
from eivor.simulation.flights.trajectories import Trajectory
from eivor.simulation.flights.truth import FlightTruth
from eivor.simulation.flights.vertical_flight import LOST_M, TILT_CORRELATION_S, TILT_SMOOTHING_S
from eivor.simulation.flights.wind import gusts
from validation.real_logs.closed_loop import Motion, Surroundings, Vehicles, fly, supply
from validation.real_logs.course import altitude, horizontal_velocity, pitch
from validation.real_logs.flown import Flown
from validation.real_logs.spec import STEP_S, FlightSpec


def stream(spec: FlightSpec, name: str) -> np.random.Generator:
    """Random stream of a flight for one purpose."""
    seed = np.random.SeedSequence(spec.seed, spawn_key=(zlib.crc32(name.encode()),))
    return np.random.Generator(np.random.PCG64(seed))


def fly_own(
    specs: Sequence[FlightSpec],
    seen_errors: Sequence[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]],
) -> list[Flown]:
    """Fly flights of one duration.

    Parameters
    ----------
    specs : sequence of FlightSpec
        The flights.
    seen_errors : sequence of (ndarray, ndarray)
        Errors of the position [m] and velocity [m/s] that each controller sees, at every step.
    """
    references = [altitude(spec, stream(spec, "altitude")) for spec in specs]
    met = _surroundings(specs, references, seen_errors)
    motion = fly(tuple(spec.vehicle for spec in specs), met)
    return [
        _flown(spec, reference, met, motion, number)
        for number, (spec, reference) in enumerate(zip(specs, references, strict=True))
    ]


def _surroundings(
    specs: Sequence[FlightSpec],
    references: Sequence[Trajectory],
    seen_errors: Sequence[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]],
) -> Surroundings:
    horizontal, angles = [], []
    for spec, reference in zip(specs, references, strict=True):
        speed = horizontal_velocity(spec, reference, stream(spec, "horizontal"))
        horizontal.append(speed)
        angles.append(_wander(spec) + np.stack([pitch(spec, speed), np.zeros(spec.steps)], axis=1))
    return Surroundings(
        position=np.stack([one.position for one in references], axis=1),
        velocity=np.stack([one.velocity for one in references], axis=1),
        acceleration=np.stack([one.acceleration for one in references], axis=1),
        gust=np.stack([_wind(spec) for spec in specs], axis=1),
        pitch=np.stack([one[:, 0] for one in angles], axis=1),
        roll=np.stack([one[:, 1] for one in angles], axis=1),
        horizontal=np.stack(horizontal, axis=1),
        position_noise=np.stack([position for position, _ in seen_errors], axis=1),
        velocity_noise=np.stack([velocity for _, velocity in seen_errors], axis=1),
    )


def _wander(spec: FlightSpec) -> Float[np.ndarray, "n 2"]:
    """Pitch and roll that are held against the air [rad]."""
    angles = gusts(
        count=spec.steps,
        axes=2,
        step_s=STEP_S,
        rms=spec.vehicle.tilt_rms,
        correlation_s=TILT_CORRELATION_S,
        rng=stream(spec, "tilt"),
    )
    return actuator_state(angles, step_s=STEP_S, lag_s=TILT_SMOOTHING_S, delay_s=0.0)


def _wind(spec: FlightSpec) -> Float[np.ndarray, " n"]:
    blown = gusts(
        count=spec.steps,
        axes=1,
        step_s=STEP_S,
        rms=spec.vehicle.gust_rms,
        correlation_s=spec.vehicle.gust_correlation,
        rng=stream(spec, "wind"),
    )
    return np.asarray(spec.vehicle.updraft + blown[:, 0])


def _flown(spec: FlightSpec, reference: Trajectory, met: Surroundings, motion: Motion, number: int) -> Flown:
    theta, phi = met.pitch[:, number], met.roll[:, number]
    force, horizontal = motion.force[:, number], met.horizontal[:, number]
    along = np.gradient(horizontal, STEP_S)
    vehicle = Vehicles((spec.vehicle,))
    truth = FlightTruth(
        time_s=STEP_S * np.arange(spec.steps),
        specific_force_z=force.copy(),
        air_velocity_z=motion.velocity[:, number] - met.gust[:, number],
        rotor_state=motion.rotor_state[:, [number]],
        cos_tilt=motion.cos_tilt[:, number].copy(),
        actuator_lag=spec.vehicle.actuator_lag,
        delay=spec.vehicle.delay,
        viscous_friction=spec.vehicle.viscous_friction,
        input_gain=GRAVITY / spec.vehicle.hover_input**2,
        hover_input=spec.vehicle.hover_input,
    )
    return Flown(
        truth=truth,
        thrust=vehicle.thrust,
        supply=supply(vehicle, spec.steps)[:, 0],
        command=motion.command[:, [number]],
        reference=reference,
        position=motion.position[:, number].copy(),
        velocity=motion.velocity[:, number].copy(),
        horizontal=horizontal.copy(),
        attitude=_quaternion(theta, phi),
        force_body=_in_body(theta, phi, along, force),
        flew=bool(np.abs(motion.position[:, number] - reference.position).max() < LOST_M),
    )


def _quaternion(theta: Float[np.ndarray, " n"], phi: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4"]:
    """Attitude that is pitched by theta, then rolled by phi."""
    c, s, cr, sr = np.cos(theta / 2), np.sin(theta / 2), np.cos(phi / 2), np.sin(phi / 2)
    return np.stack([c * cr, c * sr, s * cr, -s * sr], axis=1)


def _in_body(
    theta: Float[np.ndarray, " n"],
    phi: Float[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    up: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Specific force along x and z of the world, in the body's axes."""
    forward = along * np.cos(theta) - up * np.sin(theta)
    plane = along * np.sin(theta) + up * np.cos(theta)
    return np.stack([forward, plane * np.sin(phi), plane * np.cos(phi)], axis=1)
