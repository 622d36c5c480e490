"""The numbers of a vehicle as its equations of motion need them.

In two forms: floats, for the floats of one flight; or arrays, for arrays. Flights side by side, or samples
in time, are the last axis of these. What belongs to rotors has an axis of rotors before it, in place of a
list of rotors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from eivor.errors import UsageError
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float

#: A number of one flight, or those of several, or of several samples.
Value: TypeAlias = float | Float[np.ndarray, "..."]
#: Where a rotor is, three components, and its spin; or all rotors as arrays of shape (rotors, flights).
Place: TypeAlias = tuple[Value, Value, Value, Value]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Every number of the equations of motion; see `Vehicle` and `Rotors` for what they mean.

    Parameters
    ----------
    rotors : int
        How many.
    gyroscopic : bool
        Whether rotors have inertia.
    weight_acceleration : float
        g [m/s^2].
    mass : float or ndarray, shape (flights,)
        [kg].
    inertia, inverse_inertia : tuple
        Elements xx, yy, zz, xy, xz, yz of the matrix and of its inverse [kg m^2 and its inverse].
    places : tuple
        Position [m] and spin of each rotor; or one entry with all of them.
    thrust_linear, thrust_quadratic, torque_ratio, rotor_inertia : float or ndarray, shape (flights,)
        Of the rotors.
    rate_up, rate_down : float or ndarray, shape (flights,)
        One over the rotors' time constants [1/s].
    drag, inflow, translational_lift, flapping : float or ndarray, shape (flights,)
        Of the rotors.
    body_linear, body_quadratic, body_rotational : tuple
        Drag of the body on three axes.
    """

    rotors: int
    gyroscopic: bool
    weight_acceleration: float
    mass: Value
    inertia: tuple[Value, ...]
    inverse_inertia: tuple[Value, ...]
    places: tuple[Place, ...]
    thrust_linear: Value
    thrust_quadratic: Value
    torque_ratio: Value
    rotor_inertia: Value
    rate_up: Value
    rate_down: Value
    drag: Value
    inflow: Value
    translational_lift: Value
    flapping: Value
    body_linear: tuple[Value, ...]
    body_quadratic: tuple[Value, ...]
    body_rotational: tuple[Value, ...]


def coefficients_of(vehicle: Vehicle, gravity: float = GRAVITY) -> Coefficients:
    """Coefficients of one vehicle, all of them floats.

    Parameters
    ----------
    vehicle : Vehicle
        What flies.
    gravity : float
        Acceleration of gravity [m/s^2].
    """
    rotors, drag = vehicle.rotors, vehicle.drag
    matrix = vehicle.inertia_matrix
    inverse = np.linalg.solve(matrix, np.eye(3))
    return Coefficients(
        rotors=rotors.count,
        gyroscopic=rotors.inertia > 0.0,
        weight_acceleration=gravity,
        mass=vehicle.mass,
        inertia=_elements(matrix),
        inverse_inertia=_elements(inverse),
        places=tuple(
            (x, y, z, float(spin)) for (x, y, z), spin in zip(rotors.positions, rotors.spins, strict=True)
        ),
        thrust_linear=rotors.thrust_linear,
        thrust_quadratic=rotors.thrust_quadratic,
        torque_ratio=rotors.torque_ratio,
        rotor_inertia=rotors.inertia,
        rate_up=1.0 / rotors.lag_up,
        rate_down=1.0 / rotors.lag_down,
        drag=rotors.drag,
        inflow=rotors.inflow,
        translational_lift=rotors.translational_lift,
        flapping=rotors.flapping,
        body_linear=drag.linear,
        body_quadratic=drag.quadratic,
        body_rotational=drag.rotational,
    )


def side_by_side(vehicles: Sequence[Vehicle], gravity: float = GRAVITY) -> Coefficients:
    """Coefficients of several vehicles as arrays, or of one for arrays of any length.

    Parameters
    ----------
    vehicles : sequence of Vehicle
        One for each flight, with equally many rotors.
    gravity : float
        Acceleration of gravity [m/s^2].

    Raises
    ------
    UsageError
        When they have not equally many rotors.
    """
    counts = sorted({vehicle.rotors.count for vehicle in vehicles})
    if len(counts) != 1:
        raise UsageError("vehicles with equally many rotors", f"{counts} rotors", "Simulate them separately.")
    each = [coefficients_of(vehicle, gravity) for vehicle in vehicles]
    parts = {name: stacked([getattr(one, name) for one in each]) for name in _STACKED}
    # (rotors, 4, flights): of every rotor position and spin
    places = np.array([one.places for one in each]).transpose(1, 2, 0)
    x, y, z, spin = (np.ascontiguousarray(places[:, part]) for part in range(4))
    return replace(
        each[0], places=((x, y, z, spin),), gyroscopic=any(one.gyroscopic for one in each), **parts
    )


#: What differs from vehicle to vehicle, but for the places.
_STACKED = tuple(
    name
    for name in Coefficients.__slots__
    if name not in {"rotors", "gyroscopic", "weight_acceleration", "places"}
)


def _elements(matrix: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    return tuple(float(matrix[pair]) for pair in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def stacked(values: Sequence[Any]) -> Any:
    """Tuples element by element, numbers as an array."""
    if isinstance(values[0], tuple):
        return tuple(stacked(parts) for parts in zip(*values, strict=True))
    return np.array(values, dtype=np.float64)
