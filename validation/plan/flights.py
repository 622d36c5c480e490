"""Six vehicles: three of the own simulator and three of RotorPy, each flown along any height reference.

The controller of a planned flight is another one than that of the first flight, which the plan knows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from eivor.motions.vertical.model import GRAVITY
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Recording
from eivor.simulation.environment import SensorNoise, Trajectory, gusts, sensor_errors, simulated_recording
from eivor.simulation.vertical import (
    AltitudeController,
    VerticalEnvironment,
    VerticalVehicles,
    simulate_vertical,
)
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, simulate_rotorpy_flight
from validation.flight_recipe.rotorpy_vehicles import Vehicle

STEP_S = 0.01
#: Vertical gusts of every flight, the sensors' noise is that of the studies of the recipe [m/s].
GUST_RMS = 0.3
#: Gains of the second controller over those of the first: slower on climb rate, quicker on height.
OTHER_CONTROLLER = 0.75


@dataclass(frozen=True)
class FlownPlan:
    """What a vehicle did."""

    recording: Recording  # Its log
    height: Float[np.ndarray, " n"]  # Its motion [m, m/s], on the reference's own zero
    velocity: Float[np.ndarray, " n"]


class Flyer(Protocol):
    """A vehicle that flies along a reference."""

    @property
    def name(self) -> str:
        """What to call it."""

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        """Fly with the first controller's gains times `gains`."""


@dataclass(frozen=True)
class OwnVehicle:
    """A vehicle of the own simulator."""

    name: str  # What to call it
    friction: float  # K [1/s], share of full command, lag [s]
    hover_input: float
    lag_s: float

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        """Fly in gusts, seen by noisy sensors."""
        count = reference.position.size
        air, sensors, attitude = (
            np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(seed).spawn(3)
        )
        gust = gusts(count=count, axes=1, step_s=STEP_S, rms=GUST_RMS, correlation_s=1.0, rng=air)
        angles = gusts(count=count, axes=2, step_s=STEP_S, rms=0.05, correlation_s=1.0, rng=attitude)
        tilt = np.cos(actuator_state(angles, step_s=STEP_S, lag_s=0.15, delay_s=0.0)).prod(axis=1)
        errors = sensor_errors(SensorNoise(), count=count, axes=1, rng=sensors)
        environment = VerticalEnvironment(
            reference.position[:, None],
            reference.velocity[:, None],
            reference.acceleration[:, None],
            gust,
            tilt[:, None],
            errors.position,
            errors.velocity,
            errors.acceleration,
        )
        vehicles = VerticalVehicles(
            *(np.array([value]) for value in (self.friction, GRAVITY / self.hover_input**2, self.lag_s, 0.0))
        )
        velocity = gains * min(0.35 / (self.lag_s + STEP_S / 2.0), 5.0)
        controller = AltitudeController(0.3 * velocity / gains**2, velocity, 0.05 * velocity**2)
        motion = simulate_vertical(vehicles, environment, step_s=STEP_S, controller=controller)
        recording = simulated_recording(
            f"{self.name}, seed {seed}",
            simulator="vertical",
            time_s=STEP_S * np.arange(count),
            held={
                "rotor_command_1": motion.command[:, 0],
                "reference_position_z": reference.position,
                "reference_velocity_z": reference.velocity,
                "reference_acceleration_z": reference.acceleration,
            },
            sampled={
                "position_z": motion.position[:, 0] + errors.position[:, 0],
                "velocity_z": motion.velocity[:, 0] + errors.velocity[:, 0],
                "specific_force_z": motion.specific_force[:, 0] + errors.acceleration[:, 0],
                "cos_tilt": tilt,
            },
        )
        return FlownPlan(recording, motion.position[:, 0], motion.velocity[:, 0])


@dataclass(frozen=True)
class RotorpyVehicle:
    """A vehicle of RotorPy."""

    vehicle: Vehicle  # Which one

    @property
    def name(self) -> str:
        """What to call it."""
        return f"RotorPy {self.vehicle}"

    def fly(self, reference: Trajectory, seed: int, *, gains: float) -> FlownPlan:
        """Fly in three-dimensional wind."""
        duration = reference.position.size * STEP_S
        spec = RotorpyFlightSpec(self.vehicle, gust_rms=GUST_RMS, seed=seed, duration=duration)
        flight = simulate_rotorpy_flight(spec, reference, gains)
        height, velocity = (
            _quiet(flight.recording.channels[f"{what}_z"].values) for what in ("position", "velocity")
        )
        return FlownPlan(flight.recording, height, velocity)


def _quiet(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values without their noise: means over a tenth of a second."""
    return np.convolve(np.pad(values, 5, mode="edge"), np.ones(11) / 11.0, mode="valid")


OWN = (
    OwnVehicle("light, quick", 0.6, 0.35, 0.02),
    OwnVehicle("usual", 0.3, 0.5, 0.045),
    OwnVehicle("heavy, slow", 0.2, 0.6, 0.09),
)
ROTORPY = tuple(RotorpyVehicle(vehicle) for vehicle in Vehicle)
#: Every vehicle by its name.
_ALL: tuple[Flyer, ...] = (*OWN, *ROTORPY)
VEHICLES: Mapping[str, Flyer] = {vehicle.name: vehicle for vehicle in _ALL}
