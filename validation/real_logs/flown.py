"""What really happened in one flight, on one clock, and the effective values that follow from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from eivor.errors import EivorError
from eivor.motions.vertical.model import GRAVITY
from eivor.simulation.environment import FlightTruth, Trajectory, effective_parameters
from validation.real_logs.effective_lag import effective_lag

#: Rotor states, as shares of that at hover, among which the one that carries the weight is looked for.
NEAR_HOVER = np.linspace(0.5, 1.5, 4001)


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight's noise-free motion on one clock, n instants."""

    truth: FlightTruth  # Its arrays and nominal parameters
    # Static thrust [m/s^2] of rotor states, elementwise
    thrust: Callable[[Float[np.ndarray, "m rotors"]], Float[np.ndarray, "m rotors"]]
    supply: Float[np.ndarray, " n"]  # What the voltage leaves of the thrust
    command: Float[np.ndarray, "n rotors"]  # In force from each instant on
    reference: Trajectory  # Of the altitude
    position: Float[np.ndarray, " n"]  # Height [m] and vertical velocity [m/s]
    velocity: Float[np.ndarray, " n"]
    horizontal: Float[np.ndarray, " n"] | None  # Velocity along x [m/s], where it is logged
    attitude: Float[np.ndarray, "n 4"]  # Quaternion [w, x, y, z] from body to world
    force_body: Float[np.ndarray, "n 3"]  # Specific force along the body's axes [m/s^2]
    flew: bool  # False when the vehicle was lost

    def effective(self, used_s: Float[np.ndarray, " m"], used: Bool[np.ndarray, " m"]) -> dict[str, float]:
        """Values that an estimator without any error would give over the samples that were used."""
        truth = self.truth
        rows = np.interp(truth.time_s, used_s, used.astype(np.float64), left=0.0, right=0.0) > 0.5
        friction, gain, hover = truth.viscous_friction, truth.input_gain, truth.hover_input
        supplied = replace(truth, cos_tilt=truth.cos_tilt * self.supply)
        try:
            parameters = effective_parameters(supplied, rows, self.thrust)
        except EivorError:  # Rows that tell nothing: the nominal values stand.
            pass
        else:
            friction = parameters.viscous_friction
            thrust = parameters.input_gain * float(self.supply[rows].mean())
            gain = thrust * GRAVITY / truth.hover_input**2
            air = truth.air_velocity_z[rows].mean() - self.velocity[rows].mean()
            weight = (GRAVITY - parameters.intercept + friction * air) / thrust
            states = truth.hover_input * NEAR_HOVER
            hover = float(np.interp(weight, self.thrust(states[:, None])[:, 0], states))
        return {
            "viscous_friction": friction,
            "input_gain": gain,
            "effective_lag": effective_lag(supplied, self.command, self.thrust, rows),
            "hover_input": hover,
        }
