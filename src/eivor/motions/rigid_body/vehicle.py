"""A vehicle as a physicist describes it: mass, inertia, rotors, drag.

Conventions of everything in this folder, settled here once:

* The world's z points up; the body's axes are forward, left, up, with their origin in the centre of mass.
* Body rates p, q, r [rad/s] turn about these axes by the right-hand rule.
* A rotor's thrust points along the body's z. Its spin is +1 where its reaction torque on the body points up:
  it turns clockwise, seen from above.
* SI units. Rotor speeds are in rad/s; any other unit does, as long as it is the same throughout, for a
  vehicle whose rotors have no inertia.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.parameter_ranges import non_negative, positive, triple
from eivor.motions.rigid_body.rotors import Rotors
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class BodyDrag:
    """What the air does to the body without its rotors, along and about the body's axes.

    Parameters
    ----------
    linear : tuple of float
        Force against the air speed on each axis [N/(m/s)].
    quadratic : tuple of float
        Force per product of the air's speed and its component on each axis [N/(m/s)^2].
    rotational : tuple of float
        Torque against the rate about each axis [N m/(rad/s)].

    Raises
    ------
    ParameterError
        When one of them is no triple of numbers of zero or more.
    """

    linear: tuple[float, ...] = (0.0, 0.0, 0.0)
    quadratic: tuple[float, ...] = (0.0, 0.0, 0.0)
    rotational: tuple[float, ...] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("linear", "quadratic", "rotational"):
            triple(name, getattr(self, name))
            non_negative(name, *getattr(self, name))


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A rigid body that flies on rotors.

    Parameters
    ----------
    mass : float
        With everything on board [kg].
    inertia : tuple of float
        About the centre of mass, rotors included [kg m^2]: Ixx, Iyy, Izz of the inertia matrix, or these and
        its elements Ixy, Ixz, Iyz (minus the products of inertia).
    rotors : Rotors
        What drives it.
    drag : BodyDrag
        What the air does to the body.

    Raises
    ------
    ParameterError
        When a number is out of its range, or the inertia matrix is not positive definite.
    """

    mass: float
    inertia: tuple[float, ...]
    rotors: Rotors
    drag: BodyDrag = field(default_factory=BodyDrag)

    def __post_init__(self) -> None:
        positive("mass", self.mass)
        if len(self.inertia) not in (3, 6):
            raise ParameterError(
                "an inertia of three numbers (Ixx, Iyy, Izz) or six (and Ixy, Ixz, Iyz)",
                f"{len(self.inertia)} of them",
                "Give the elements of the matrix in this order.",
            )
        matrix = self.inertia_matrix
        if not (np.all(np.isfinite(matrix)) and np.linalg.eigvalsh(matrix)[0] > 0.0):
            raise ParameterError(
                "an inertia matrix that is positive definite",
                f"{self.inertia}",
                "Correct its elements; those off the diagonal are minus the products of inertia.",
            )

    @property
    def inertia_matrix(self) -> Float[np.ndarray, "3 3"]:
        """Inertia about the body's axes [kg m^2]."""
        xx, yy, zz, xy, xz, yz = (*self.inertia, 0.0, 0.0, 0.0)[:6]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def hover_speed(self) -> float:
        """Speed at which equal rotors carry the weight."""
        return self.rotors.speed_of_thrust(self.mass * GRAVITY / self.rotors.count)

    @property
    def full_thrust(self) -> float:
        """Thrust of all rotors at their highest speed [N]."""
        return self.rotors.count * self.rotors.thrust(self.rotors.highest_speed)
