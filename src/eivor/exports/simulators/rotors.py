"""Rotors as simulators count them: thrust is a constant times the squared speed, and the speed lags.

The speed is w = c sqrt(phi), c the rotor speed per unit of command and phi the mapped command: where thrust
goes with the square of the command that is the rotor's own speed, and the simulation is exact. Of other maps
it is another variable in place of the command, with the same lag about hover.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.exports.simulators.described import Described
from eivor.exports.simulators.parts import Column
from eivor.motions.vertical.model import GRAVITY


def mapped_hover(made: Described) -> Column:
    """Mapped command at hover."""
    return made.values["mass"] * GRAVITY / (made.count * made.values["thrust"])


@dataclass(frozen=True)
class Rotors:
    """Numbers of a rotor, a row for each vehicle.

    Parameters
    ----------
    thrust_constant : ndarray, shape (n,)
        [N/(rad/s)^2].
    torque_constant : ndarray, shape (n,)
        [N m/(rad/s)^2].
    hover_speed, largest_speed : ndarray, shape (n,)
        [rad/s]; infinite where the largest command is not known.
    drag_along, drag_across : ndarray, shape (n,)
        Force per air speed, along the rotor's axis and across it, and per rotor speed [N s^2/(m rad)]. With
        all rotors at hover speed they are the drag of the vehicle.
    """

    thrust_constant: Column
    torque_constant: Column
    hover_speed: Column
    largest_speed: Column
    drag_along: Column
    drag_across: Column


def rotors_of(made: Described, gravity: float = GRAVITY) -> Rotors:
    """Rotors of a vehicle.

    Parameters
    ----------
    made : Described
        The vehicle.
    gravity : float
        Of the simulator [m/s^2]. Thrust is counted in it, so that the vehicle hovers where it hovered.
    """
    values = made.values
    scale, thrust, zero = values["speed_scale"], values["thrust"], np.zeros_like(values["mass"])
    hover = scale * np.sqrt(mapped_hover(made))
    constant = thrust / scale**2 * (gravity / GRAVITY)
    largest = made.thrust_map(values.get("largest_command", zero + np.inf))
    across = [values[name] for name in ("drag_x", "drag_y") if name in values]
    return Rotors(
        constant,
        values["torque_ratio"] * constant,
        hover,
        scale * np.sqrt(largest),
        values.get("drag_z", zero) / (made.count * hover),
        (np.mean(across, axis=0) if across else zero) / (made.count * hover),
    )


def speed_comments(made: Described, simulator: str, gravity: float = GRAVITY) -> tuple[str, ...]:
    """What a rotor's speed, gravity and delays are in a simulator, as sentences."""
    said = []
    if made.thrust_map.name == "square":
        said.append("Rotor speeds are the commands times the rotor speed per unit of command.")
    else:
        said.append(
            "Rotor speeds are the rotor speed per unit of command times the square root of the mapped "
            "command: exact at rest, with the identified lag about hover."
        )
    if gravity != GRAVITY:
        said.append(
            f"{simulator} takes gravity for {gravity:g} m/s^2: thrust is times {gravity / GRAVITY:.6g}, "
            "so that the vehicle hovers with the same command."
        )
    return (*said, *delay_comments(made, simulator))


def delay_comments(made: Described, simulator: str) -> tuple[str, ...]:
    """A sentence where there is a delay: none of the simulators has one."""
    delay = float(np.mean(made.values["delay"])) if "delay" in made.values else 0.0
    return (f"{simulator} has no delay: hold its commands back by {delay:.4g} s.",) if delay > 0.0 else ()
