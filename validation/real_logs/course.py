"""What a flight is asked to fly: the altitude's reference, and where it goes horizontally meanwhile."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.environment import Trajectory, TrajectoryKind, altitude_reference
from validation.real_logs.spec import STEP_S, FlightSpec, Reference

#: The altitude's shape is made at this step and read between it; sines have no need of more [s].
SHAPE_STEP_S = 0.01
#: Ramps: climb rates [m/s], how long each is kept [s], and the height that they stay within [m].
RAMP_SPEED, RAMP_SECONDS, RAMP_HEIGHT = 1.8, (1.5, 4.0), 4.0
#: Largest speed [m/s] and acceleration [m/s^2] of a single sine.
SINE_LIMITS = (1.8, 3.5)
#: Horizontal flight goes back and forth with this acceleration at most [m/s^2].
HORIZONTAL_ACCELERATION = 2.5


def altitude(spec: FlightSpec, rng: np.random.Generator) -> Trajectory:
    """Reference of the altitude at every step of the simulation."""
    time = STEP_S * np.arange(spec.steps)
    if spec.reference is Reference.RAMPS:
        return _ramps(time, rng, spec.vigour)
    if spec.reference is Reference.SINE:
        return _sine(time, spec, rng)
    count = round(spec.duration / SHAPE_STEP_S) + 1
    shape = altitude_reference(
        TrajectoryKind(spec.reference.value), count=count, step_s=SHAPE_STEP_S, rng=rng, vigour=spec.vigour
    )
    coarse = SHAPE_STEP_S * np.arange(count)
    return Trajectory(
        *(np.interp(time, coarse, part) for part in (shape.position, shape.velocity, shape.acceleration))
    )


def _ramps(time: Float[np.ndarray, " n"], rng: np.random.Generator, vigour: float) -> Trajectory:
    """Climbs and descents at speeds that jump, which turn back before they leave the heights allowed."""
    velocity = np.zeros(time.size)
    start, height = 0.0, 0.0
    while start < time[-1]:
        seconds = rng.uniform(*RAMP_SECONDS)
        speed = vigour * rng.uniform(-RAMP_SPEED, RAMP_SPEED)
        if abs(height + speed * seconds) > RAMP_HEIGHT:
            speed = -speed
        velocity[(time >= start) & (time < start + seconds)] = speed
        start, height = start + seconds, height + speed * seconds
    return Trajectory(np.cumsum(velocity) * STEP_S, velocity, np.zeros(time.size))


def _sine(time: Float[np.ndarray, " n"], spec: FlightSpec, rng: np.random.Generator) -> Trajectory:
    pulsation = 2.0 * np.pi * spec.frequency
    size = spec.vigour * min(SINE_LIMITS[0] / pulsation, SINE_LIMITS[1] / pulsation**2)
    angle = pulsation * time + rng.uniform(0.0, 2.0 * np.pi)
    return Trajectory(
        size * np.sin(angle), size * pulsation * np.cos(angle), -size * pulsation**2 * np.sin(angle)
    )


def horizontal_velocity(
    spec: FlightSpec, vertical: Trajectory, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Velocity along the world's x [m/s] at every step: along with the climbs, back and forth, or none."""
    vehicle = spec.vehicle
    count = vertical.position.size
    if vehicle.horizontal_speed == 0.0:
        return np.zeros(count)
    time = STEP_S * np.arange(count)
    pulsation = HORIZONTAL_ACCELERATION / vehicle.horizontal_speed * rng.uniform(0.8, 1.0)
    current = np.sin(pulsation * time + rng.uniform(0.0, 2.0 * np.pi))
    fastest = float(np.abs(vertical.velocity).max())
    along = vertical.velocity / fastest if fastest > 0.0 else np.zeros(count)
    share = vehicle.diagonal
    return np.asarray(vehicle.horizontal_speed * (share * along + (1.0 - share) * current))


def pitch(spec: FlightSpec, horizontal: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Pitch [rad] that makes the horizontal acceleration, against the drag."""
    acceleration = np.gradient(horizontal, STEP_S)
    drag = spec.vehicle.horizontal_friction * horizontal
    return np.asarray(np.arctan((acceleration + drag) / GRAVITY))
