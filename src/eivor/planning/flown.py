"""Planned flights, flown in simulation and identified by the recipe: what it will report.

The simulated vehicle has the numbers of a guess or an estimate, is pushed by a force and seen by sensors of
the densities that the estimate left, and follows the setpoint as the first flight did.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from eivor.flights.result import FlightEstimate
from eivor.motions.identify import identify_flight
from eivor.planning.limits import FlightLimits
from eivor.planning.setpoints import STEP_S, Shape
from eivor.planning.vehicle import VehicleGuess
from eivor.shapes import Float
from eivor.signals.recording import Recording
from eivor.simulation.flights.closed_loop import (
    AltitudeController,
    SimulatedMotion,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)
from eivor.simulation.flights.simulated_log import simulated_recording

#: Error of a logged height [m].
POSITION_NOISE = 0.01
#: Roll and pitch wander with this correlation time, and are smooth over the second one [s].
TILT_CORRELATION_S, TILT_SMOOTHING_S = 1.0, 0.15


@dataclass(frozen=True)
class Flown:
    """A shape, flown once.

    Parameters
    ----------
    shape : Shape
        What was asked for.
    height, velocity : ndarray, shape (n,)
        What the vehicle did, from the middle [m], [m/s].
    recording : Recording
        Its log.
    """

    shape: Shape
    height: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    recording: Recording

    def keeps(self, limits: FlightLimits) -> bool:
        """Whether the vehicle stayed within height and speed."""
        half_height = 0.5 * (limits.height_m[1] - limits.height_m[0])
        return bool(np.abs(self.height).max() <= half_height and np.abs(self.velocity).max() <= limits.speed)

    def identified(self) -> FlightEstimate:
        """What the recipe says of it."""
        return identify_flight(self.recording)


def fly(shapes: Sequence[Shape], vehicle: VehicleGuess, seeds: Sequence[int]) -> list[Flown]:
    """Fly each shape with its seed, all side by side.

    Parameters
    ----------
    shapes : sequence of Shape
        Of one length.
    vehicle : VehicleGuess
        Numbers, controller and what pushes it.
    seeds : sequence of int
        Of wind, sensors and tilt; one for each shape.
    """
    count, flights = shapes[0].offset.size, len(shapes)
    drawn = [_surroundings(vehicle, count, seed) for seed in seeds]
    derivatives = [shape.derivatives for shape in shapes]
    every = np.ones(flights)
    environment = VerticalEnvironment(
        reference_position=np.stack([shape.offset for shape in shapes], axis=1),
        reference_velocity=np.stack([one[0] for one in derivatives], axis=1),
        reference_acceleration=np.stack([one[1] for one in derivatives], axis=1),
        **{name: np.stack([one[name] for one in drawn], axis=1) for name in drawn[0]},
    )
    vehicles = VerticalVehicles(
        _apart(vehicle) * every, vehicle.input_gain * every, vehicle.lag_s * every, 0.0 * every
    )
    motion = simulate_vertical(
        vehicles, environment, step_s=STEP_S, controller=_alike(vehicle.follows, flights)
    )
    return [_flown(shape, environment, motion, number) for number, shape in enumerate(shapes)]


def _apart(vehicle: VehicleGuess) -> float:
    """Friction, moved a little where the simulator's closed form does not hold."""
    rate = 1.0 / vehicle.lag_s
    near = any(abs(vehicle.viscous_friction - multiple * rate) < 1e-6 for multiple in (1.0, 2.0))
    return vehicle.viscous_friction + (1e-4 if near else 0.0)


def _alike(gains: AltitudeController, flights: int) -> AltitudeController:
    every = np.ones(flights)
    return AltitudeController(
        gains.position_gain * every, gains.velocity_gain * every, gains.integral_gain * every
    )


def _surroundings(vehicle: VehicleGuess, count: int, seed: int) -> dict[str, Float[np.ndarray, " n"]]:
    force, acceleration, velocity, other = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)
    )
    angles = [
        vehicle.tilt_rms * _with_density(_tilt_density, count, other),
        vehicle.tilt_rms * _with_density(_tilt_density, count, other),
    ]
    return {
        "gust": _coloured(vehicle, "force", count, force) / _apart(vehicle),
        "cos_tilt": np.cos(angles[0]) * np.cos(angles[1]),
        "position_noise": POSITION_NOISE * other.standard_normal(count),
        "velocity_noise": _coloured(vehicle, "velocity", count, velocity),
        "acceleration_noise": _coloured(vehicle, "accelerometer", count, acceleration),
    }


def _coloured(
    vehicle: VehicleGuess, name: str, count: int, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Gaussian series of one of the vehicle's densities."""
    return _with_density(partial(vehicle.left.at, name), count, rng)


def _tilt_density(frequency_hz: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Density of an angle of standard deviation 1 with that correlation time, smoothed."""
    pulsation = 2.0 * np.pi * frequency_hz
    wandering = 4.0 * TILT_CORRELATION_S / (1.0 + (pulsation * TILT_CORRELATION_S) ** 2)
    return np.asarray(wandering / (1.0 + (pulsation * TILT_SMOOTHING_S) ** 2))


def _with_density(
    density: Callable[[Float[np.ndarray, " m"]], Float[np.ndarray, " m"]],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """Gaussian series of a one-sided density, with no mean."""
    frequency = np.fft.rfftfreq(count, STEP_S)
    scale = np.zeros(frequency.size)
    scale[1:] = np.sqrt(density(frequency[1:]) * count / (4.0 * STEP_S))
    spectrum = scale * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    return np.fft.irfft(spectrum, n=count)


def _flown(shape: Shape, environment: VerticalEnvironment, motion: SimulatedMotion, number: int) -> Flown:
    height, velocity = motion.position[:, number], motion.velocity[:, number]
    recording = simulated_recording(
        f"planned {shape.kind}",
        simulator="plan",
        time_s=STEP_S * np.arange(height.size),
        held={
            "rotor_command_1": motion.command[:, number],
            "reference_position_z": environment.reference_position[:, number],
            "reference_velocity_z": environment.reference_velocity[:, number],
            "reference_acceleration_z": environment.reference_acceleration[:, number],
        },
        sampled={
            "position_z": height + environment.position_noise[:, number],
            "velocity_z": velocity + environment.velocity_noise[:, number],
            "specific_force_z": motion.specific_force[:, number] + environment.acceleration_noise[:, number],
            "cos_tilt": environment.cos_tilt[:, number],
        },
    )
    return Flown(shape, height, velocity, recording)
