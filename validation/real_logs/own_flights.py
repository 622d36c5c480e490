"""Flights of this study's own simulator."""

from __future__ import annotations

import zlib

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.signals.filters import actuator_state
from eivor.simulation.environment import FlightTruth, Trajectory, gusts
from eivor.simulation.vertical import LOST_M, TILT_CORRELATION_S, TILT_SMOOTHING_S
from validation.real_logs.closed_loop import Motion, Surroundings, Thrust, fly, supply
from validation.real_logs.course import altitude, horizontal_velocity, pitch
from validation.real_logs.flown import Flown
from validation.real_logs.spec import STEP_S, FlightSpec


def stream(spec: FlightSpec, name: str) -> np.random.Generator:
    """Random stream of a flight for one purpose."""
    seed = np.random.SeedSequence(spec.seed, spawn_key=(zlib.crc32(name.encode()),))
    return np.random.Generator(np.random.PCG64(seed))


def fly_own(spec: FlightSpec, seen_errors: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]) -> Flown:
    """Fly one flight."""
    reference = altitude(spec, stream(spec, "altitude"))
    horizontal = horizontal_velocity(spec, reference, stream(spec, "horizontal"))
    wander = _wander(spec)
    met = Surroundings(
        position=reference.position,
        velocity=reference.velocity,
        acceleration=reference.acceleration,
        gust=_wind(spec),
        pitch=wander[:, 0] + pitch(spec, horizontal),
        roll=wander[:, 1],
        horizontal=horizontal,
        position_noise=seen_errors[0],
        velocity_noise=seen_errors[1],
    )
    return _simulated(spec, reference, met, fly(spec.vehicle, met))


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


def _simulated(spec: FlightSpec, reference: Trajectory, met: Surroundings, motion: Motion) -> Flown:
    truth = FlightTruth(
        time_s=STEP_S * np.arange(spec.steps),
        specific_force_z=motion.force,
        air_velocity_z=motion.velocity - met.gust,
        rotor_state=motion.rotor_state[:, None],
        cos_tilt=met.cos_tilt,
        actuator_lag=spec.vehicle.actuator_lag,
        delay=spec.vehicle.delay,
        viscous_friction=spec.vehicle.viscous_friction,
        input_gain=GRAVITY / spec.vehicle.hover_input**2,
        hover_input=spec.vehicle.hover_input,
    )
    along = np.gradient(met.horizontal, STEP_S)
    return Flown(
        truth=truth,
        thrust=Thrust(spec.vehicle),
        supply=supply(spec.vehicle, spec.steps),
        command=motion.command[:, None],
        reference=reference,
        position=motion.position,
        velocity=motion.velocity,
        horizontal=met.horizontal,
        attitude=_quaternion(met.pitch, met.roll),
        force_body=_in_body(met.pitch, met.roll, along, motion.force),
        flew=bool(np.abs(motion.position - reference.position).max() < LOST_M),
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
