"""What each rotor does about and along the body's axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.shapes import Float


@dataclass(frozen=True)
class RotorLayout:
    """Arms and signs of a vehicle's rotors, in the order of their commands. Performs no checks.

    Parameters
    ----------
    vehicle : KnownVehicle
        Whose rotors; in metres, or in arms where nobody knows how long these are.
    """

    vehicle: KnownVehicle

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.vehicle.spins)

    @cached_property
    def roll(self) -> Float[np.ndarray, " rotors"]:
        """Arm of each thrust about the forward axis: y."""
        return np.array([place[1] for place in self.vehicle.positions], dtype=np.float64)

    @cached_property
    def pitch(self) -> Float[np.ndarray, " rotors"]:
        """Arm of each thrust about the left axis: -x."""
        return np.array([-place[0] for place in self.vehicle.positions], dtype=np.float64)

    @cached_property
    def yaw(self) -> Float[np.ndarray, " rotors"]:
        """Sign of each reaction torque."""
        return np.array(self.vehicle.spins, dtype=np.float64)

    @cached_property
    def sums(self) -> Float[np.ndarray, "7 rotors"]:
        """Weights of the rotors in sums over them: 1, x, y, x^2, x y, y^2, and the spin."""
        x, y = -self.pitch, self.roll
        return np.stack([np.ones(self.count), x, y, x * x, x * y, y * y, self.yaw])
