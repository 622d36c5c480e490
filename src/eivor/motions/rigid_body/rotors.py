"""The rotors of a vehicle: where they are, how they spin, what they give, how they follow their commands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor.errors import ParameterError
from eivor.motions.rigid_body.parameter_ranges import finite, non_negative, positive, triple

#: A vehicle has at least two, and more than this is a mistake.
MOST_ROTORS = 64


@dataclass(frozen=True, slots=True)
class Rotors:
    """Equal rotors at several places.

    With n the speed of one of them, l the air velocity there on the body's axes, and s its spin:

        thrust = c1 n + c2 n^2 + k_h (l_x^2 + l_y^2) - k_z n l_z
        drag   = -k_d n (l_x, l_y)
        torque = s kappa (c1 n + c2 n^2) + s J n'
        n'     = (command(t - delay) - n) / lag

    The drag terms are those of the simulator RotorPy.

    Parameters
    ----------
    positions : tuple of tuple of float
        Of each rotor from the centre of mass, forward, left, up [m].
    spins : tuple of int
        Of each rotor: +1 where its reaction torque on the body points up, which turns clockwise as seen from
        above, and else -1.
    highest_speed : float
        Commands above it are cut off [rad/s].
    thrust_quadratic : float
        c2 [N/(rad/s)^2].
    thrust_linear : float
        c1 [N/(rad/s)].
    torque_ratio : float
        kappa, reaction torque over thrust [m].
    inertia : float
        J of one rotor with what turns of its motor, about its axis [kg m^2].
    lag_up, lag_down : float
        Time constants towards a higher and towards a lower speed [s].
    delay : float
        From a command to its first effect on the speed [s].
    lowest_speed : float
        Commands below it are raised to it [rad/s].
    drag, inflow : float
        k_d across the axis and k_z along it [N/(m/s) per rad/s].
    translational_lift : float
        k_h [N/(m/s)^2].
    flapping : float
        Torque -k n (l_y, -l_x) on the hub [N m/(m/s) per rad/s].

    Raises
    ------
    ParameterError
        When a number is out of its range, or positions and spins do not fit.
    """

    positions: tuple[tuple[float, ...], ...]
    spins: tuple[int, ...]
    highest_speed: float
    thrust_quadratic: float
    torque_ratio: float
    lag_up: float
    lag_down: float
    thrust_linear: float = 0.0
    inertia: float = 0.0
    delay: float = 0.0
    lowest_speed: float = 0.0
    drag: float = 0.0
    inflow: float = 0.0
    translational_lift: float = 0.0
    flapping: float = 0.0

    def __post_init__(self) -> None:
        if not 2 <= len(self.positions) <= MOST_ROTORS or len(self.spins) != len(self.positions):
            raise ParameterError(
                f"positions of 2 to {MOST_ROTORS} rotors, and a spin for each",
                f"{len(self.positions)} positions and {len(self.spins)} spins",
                "Give both in the order of the rotors' commands.",
            )
        for position in self.positions:
            triple("position", position)
            finite("position", *position)
        if not all(spin in (1, -1) for spin in self.spins):
            raise ParameterError(
                "spins of +1 or -1",
                f"{self.spins}",
                "A rotor whose reaction torque on the body points up (clockwise from above) has +1.",
            )
        positive("highest_speed", self.highest_speed)
        positive("lag_up", self.lag_up)
        positive("lag_down", self.lag_down)
        for name in _NOT_NEGATIVE:
            non_negative(name, getattr(self, name))
        if not self.thrust_linear + self.thrust_quadratic > 0.0:
            raise ParameterError("rotors with thrust", "none", "Give thrust_quadratic or thrust_linear.")
        if not self.lowest_speed < self.highest_speed:
            raise ParameterError(
                "a lowest_speed below the highest_speed",
                f"{self.lowest_speed:g} and {self.highest_speed:g}",
                "Correct the limits.",
            )

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.positions)

    def thrust(self, speed: float) -> float:
        """Thrust of one rotor in still air [N]."""
        return (self.thrust_linear + self.thrust_quadratic * speed) * speed

    def speed_of_thrust(self, thrust: float) -> float:
        """Speed at which one rotor has this thrust [N] in still air; zero where there is none."""
        linear, quadratic = self.thrust_linear, self.thrust_quadratic
        if thrust <= 0.0:
            return 0.0
        # the root that also serves without a quadratic part
        return 2.0 * thrust / (linear + math.sqrt(linear**2 + 4.0 * quadratic * thrust))


_NOT_NEGATIVE = (
    "thrust_quadratic",
    "thrust_linear",
    "torque_ratio",
    "inertia",
    "delay",
    "lowest_speed",
    "drag",
    "inflow",
    "translational_lift",
    "flapping",
)
