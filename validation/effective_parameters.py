"""Parameters of the vertical model that a simulated flight really had."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eivor.simulation.vertical import STEP_S, VerticalFlight, VerticalFlightSpec
from eivor.tools import Bool, Float


@dataclass(frozen=True, slots=True)
class FlightTruth:
    """Noise-free arrays of a simulated flight, and its nominal parameters."""

    time_s: Float[np.ndarray, " n"]  # Stamps [s] of the rows
    specific_force_z: Float[np.ndarray, " n"]  # Acceleration plus g along the world's z [m/s^2]
    air_velocity_z: Float[np.ndarray, " n"]  # Vertical velocity minus vertical wind [m/s]
    rotor_state: Float[np.ndarray, "n rotors"]  # Actual rotor states, in the commands' unit
    cos_tilt: Float[np.ndarray, " n"]  # Cosine of the angle between the body's and the world's z
    actuator_lag: float  # Time constant of the rotors [s]
    delay: float  # [s]
    viscous_friction: float  # K at hover in still air [1/s]
    input_gain: float  # [m/s^2 per unit of the mean mapped rotor state]
    hover_input: float  # Rotor state at hover


def truth_of(spec: VerticalFlightSpec, flight: VerticalFlight) -> FlightTruth:
    """Truth of a flight of the own simulator."""
    met, motion = flight.truth
    moves = motion.specific_force, motion.velocity - met.gust, motion.rotor_state[:, None], met.cos_tilt
    numbers = spec.actuator_lag, spec.delay, spec.viscous_friction, spec.input_gain, spec.hover_input
    return FlightTruth(STEP_S * np.arange(spec.count), *moves, *numbers)


class BestFittingParameters(NamedTuple):
    """Parameters of the vertical model that fit one flight's noise-free data best."""

    viscous_friction: float  # K [1/s]
    input_gain: float  # K_u [m/s^2 per unit of the mean mapped rotor state]
    intercept: float  # b [m/s^2]


def effective_parameters(
    truth: FlightTruth,
    rows: Bool[np.ndarray, " n"],
    input_map: Callable[[Float[np.ndarray, "m rotors"]], Float[np.ndarray, "m rotors"]],
) -> BestFittingParameters:
    """Least squares of the true specific force on (-air velocity, U, 1) over the given rows."""
    columns = np.column_stack(
        [-truth.air_velocity_z[rows], truth.cos_tilt[rows] * input_map(truth.rotor_state[rows]).mean(axis=1)]
    )
    response = truth.specific_force_z[rows]
    means, response_mean = columns.mean(axis=0), float(response.mean())
    friction, gain = np.linalg.lstsq(columns - means, response - response_mean)[0].tolist()
    return BestFittingParameters(friction, gain, response_mean - float(means @ [friction, gain]))
