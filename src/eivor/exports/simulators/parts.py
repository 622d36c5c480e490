"""Numbers of a vehicle as simulators want them, and how a draw of each is made of what it rests on.

Names and units, settled here once:

    mass                        [kg]
    thrust                      of a rotor, per unit of its mapped command [N]
    actuator_lag, delay         of a rotor [s]
    drag_x, drag_y, drag_z      on the body's axes [N/(m/s)]
    inertia_xx, ..._yy, ..._zz  about the centre of mass [kg m^2]
    torque_ratio                a rotor's reaction torque over its thrust [m]
    arm_scale                   what all positions have to be multiplied by
    largest_command             in the unit of the commands
    speed_scale                 rotor speed per unit of command [rad/s]

A flight tells ratios: thrust is mass times gain, and so is every force, row by row of the draws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from eivor.exports.fitted import Number
from eivor.shapes import Float

Column = Float[np.ndarray, " n"]
Columns = Mapping[str, Column]

WORDS = {
    "mass": "mass [kg]",
    "thrust": "thrust of a rotor per unit of mapped command [N]",
    "actuator_lag": "lag of the rotors [s]",
    "delay": "delay of the commands [s]",
    "drag_x": "drag along x [N/(m/s)]",
    "drag_y": "drag along y [N/(m/s)]",
    "drag_z": "drag along z [N/(m/s)]",
    "inertia_xx": "inertia in roll [kg m^2]",
    "inertia_yy": "inertia in pitch [kg m^2]",
    "inertia_zz": "inertia in yaw [kg m^2]",
    "torque_ratio": "reaction torque over thrust [m]",
    "arm_scale": "arms over the lengths in the vehicle's file",
    "largest_command": "largest command",
    "speed_scale": "rotor speed per unit of command [rad/s]",
}
INERTIAS = ("inertia_xx", "inertia_yy", "inertia_zz")
DRAGS = ("drag_x", "drag_y", "drag_z")


@dataclass(frozen=True)
class Part:
    """A number of the vehicle.

    Parameters
    ----------
    number : Number
        With its interval.
    column : callable
        A row for each row of the columns that it rests on.
    """

    number: Number
    column: Callable[[Columns], Column]


@dataclass(frozen=True)
class Parts:
    """What a flight tells of a vehicle.

    Parameters
    ----------
    told : mapping of str to Part
        By the names above.
    missing : mapping of str to str
        Why it does not tell the rest of what its motion estimates.
    """

    told: Mapping[str, Part]
    missing: Mapping[str, str]


def itself(name: str) -> Callable[[Columns], Column]:
    """Column of a root by its name."""
    return lambda columns: columns[name]


def of_mass(mass: Number, per_mass: Number, share: float = 1.0) -> Number:
    """Mass times what a flight tells per mass; both err independently.

    Each side of the interval is the root of the squared sides of both.
    """
    value = share * mass.value * per_mass.value
    below, above = (
        share
        * math.hypot(
            per_mass.value * (mass.interval[side] - mass.value),
            mass.value * (per_mass.interval[side] - per_mass.value),
        )
        for side in (0, 1)
    )
    source = f"{per_mass.source}, times the mass as given"
    return Number(value, (value - below, value + above), source)
