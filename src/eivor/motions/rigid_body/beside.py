"""What turns a vehicle beside its rotors' thrust: drag off the centre of mass, and rotors that spin.

A rotor at (x, y, z) of the centre of mass drags along the velocity there, with the moment of its place: one
that is above the centre of mass pitches a vehicle that flies forward, one that is beside it yaws it. About
x, y and z that goes with the velocities along y and z, x and z, x and y; torques of flapping rotors go alike.
Thrust has the known places of the vehicle file, and so has what damps; the height of the rotors is in none,
nor is where the centre of mass lies.

The rotors' angular momentum -J sum s n goes round with the body, which takes J q sum s n about x and
-J p sum s n about y. Where a vehicle yaws, sum s n goes with the rate of yaw, and looks like a coupling.
"""

from __future__ import annotations

import numpy as np

from eivor.motions.rigid_body.parameters import DRAG_MOMENT, PITCH, ROLL
from eivor.shapes import Float

#: Axes along which a velocity turns the vehicle about each axis.
ALONG_OTHERS = ((1, 2), (0, 2), (0, 1))


def drag_moments(axis: int, velocity: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "2 n"]:
    """What drag beside the centre of mass turns about an axis, but for the two constants.

    Parameters
    ----------
    axis : int
        About which, from 0.
    velocity : ndarray, shape (3, n)
        Of the body through the air, on its own axes.
    """
    return velocity[list(ALONG_OTHERS[axis])]


def spin_moment(
    axis: int, rates: Float[np.ndarray, "3 n"], spin: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """What rotors that spin turn about x or y, but for their inertia over the body's.

    Parameters
    ----------
    axis : int
        0 or 1.
    rates : ndarray, shape (3, n)
        Body rates.
    spin : ndarray, shape (n,)
        Sum of the rotors' speeds, each with the sign of its reaction torque.
    """
    return rates[PITCH] * spin if axis == ROLL else -rates[ROLL] * spin


#: Parameters of these moments, side by side.
ALL_DRAG_MOMENTS = tuple(one for pair in DRAG_MOMENT for one in pair)
