"""Flights of RotorPy's multirotors, to be logged by this study's loggers."""

from __future__ import annotations

import numpy as np

from eivor.simulation.environment import SensorNoise, Trajectory, TrajectoryKind
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, simulate_rotorpy_flight
from validation.flight_recipe.rotorpy_vehicles import Vehicle
from validation.real_logs.flown import Flown
from validation.real_logs.spec import FlightSpec


def fly_rotorpy(spec: FlightSpec) -> Flown:
    """Fly one of RotorPy's multirotors at 100 Hz, with sensors that the controller sees without noise."""
    flight = simulate_rotorpy_flight(
        RotorpyFlightSpec(
            vehicle=Vehicle(spec.multirotor),
            actuator_lag=spec.vehicle.actuator_lag,
            delay=spec.vehicle.delay,
            gust_rms=spec.vehicle.gust_rms,
            gust_correlation=spec.vehicle.gust_correlation,
            noise=SensorNoise.none(),
            trajectory=TrajectoryKind(spec.reference.value),
            seed=spec.seed,
            duration=spec.duration,
        )
    )
    log = {name: channel.values for name, channel in flight.recording.channels.items()}
    gain = flight.truth.input_gain
    return Flown(
        truth=flight.truth,
        thrust=lambda states: gain * states**2,
        supply=np.ones(flight.truth.time_s.size),
        command=np.stack(
            [log[f"rotor_command_{rotor + 1}"] for rotor in range(flight.truth.rotor_state.shape[1])], axis=1
        ),
        reference=Trajectory(
            *(log[f"reference_{part}_z"] for part in ("position", "velocity", "acceleration"))
        ),
        position=log["position_z"],
        velocity=log["velocity_z"],
        horizontal=None,
        attitude=np.stack([log[f"attitude_{axis}"] for axis in "wxyz"], axis=1),
        force_body=np.stack([log[f"specific_force_body_{axis}"] for axis in "xyz"], axis=1),
        flew=flight.flew,
    )
