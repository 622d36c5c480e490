"""What a user knows of a vehicle before its flight is identified. Only the rotors' layout is needed.

The conventions are those of `vehicle`: the body's axes are forward, left, up, and a rotor's spin is +1 where
its reaction torque on the body points up (clockwise, seen from above). `vehicle_file` reads it from TOML.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.parameter_ranges import finite
from eivor.motions.rigid_body.rotors import MOST_ROTORS
from eivor.signals.input_map import input_map

#: What each known number may be, with its unit.
RANGES = {
    "mass": (1e-3, 1e3, " kg"),
    "arm_scale": (0.5, 2.0, ""),
    "speed_scale": (1e-6, 1e6, " rad/s per unit of command"),
    "torque_ratio": (1e-4, 1.0, " m"),
    "yaw_inertia_ratio": (0.2, 2.0, ""),
    "delay": (0.0, 0.5, " s"),
}
#: Cutoffs of filters [Hz].
CUTOFFS_HZ = (1.0, 10_000.0)
#: Radii of rotors [m].
RADII = (0.005, 5.0)


@dataclass(frozen=True, slots=True)
class KnownVehicle:
    """What is known of a vehicle; None for what is not.

    Parameters
    ----------
    name : str
        For people.
    positions : tuple of (float, float)
        Of each rotor forward and left of the centre, in the order of the commands: in metres where
        `arm_scale` is known, else in arms (the distance from the centre to a rotor).
    spins : tuple of int
        Of each rotor: +1 where its reaction torque on the body points up (clockwise from above), and else -1.
    arm_scale : KnownNumber, optional
        What all positions have to be multiplied by: one, with the relative error of the lengths. None when
        they are in arms of an unknown length.
    mass : KnownNumber, optional
        With everything on board [kg].
    speed_scale : KnownNumber, optional
        From the logged commands to rotor speeds [rad/s per unit of command].
    torque_ratio : KnownNumber, optional
        kappa, a rotor's reaction torque over its thrust [m].
    yaw_inertia_ratio : KnownNumber, optional
        Izz over the mean of Ixx and Iyy, where it is assumed.
    delay : KnownNumber, optional
        From a command to its first effect [s].
    thrust_map : str
        From a rotor's state to phi, which its thrust is proportional to: ``square``, ``linear``,
        ``power:EXPONENT`` or ``mixed:SHARE``; for c1 n + c2 n^2 the share is c2 / (c1 + c2), with n in the
        unit of the commands.
    gyro_cutoff_hz, accelerometer_cutoff_hz : float, optional
        Of the onboard filters that the logged values have passed, low-passes of second order [Hz].
    rotor_radius : float, optional
        Of a rotor [m]; heights over the ground are counted in it.

    Raises
    ------
    ParameterError
        When a number is out of its range, or the rotors cannot turn the vehicle about every axis.
    UsageError
        When there is no such thrust map.
    """

    name: str
    positions: tuple[tuple[float, ...], ...]
    spins: tuple[int, ...]
    arm_scale: KnownNumber | None = None
    mass: KnownNumber | None = None
    speed_scale: KnownNumber | None = None
    torque_ratio: KnownNumber | None = None
    yaw_inertia_ratio: KnownNumber | None = None
    delay: KnownNumber | None = None
    thrust_map: str = "square"
    gyro_cutoff_hz: float | None = None
    accelerometer_cutoff_hz: float | None = None
    rotor_radius: float | None = None

    def __post_init__(self) -> None:
        _check_rotors(self.positions, self.spins)
        for name, (low, high, unit) in RANGES.items():
            number: KnownNumber | None = getattr(self, name)
            if number is not None:
                number.check(name, low, high, unit)
        for name in ("gyro_cutoff_hz", "accelerometer_cutoff_hz"):
            cutoff: float | None = getattr(self, name)
            if cutoff is not None:
                KnownNumber(cutoff).check(name, *CUTOFFS_HZ, " Hz")
        if self.rotor_radius is not None:
            KnownNumber(self.rotor_radius).check("rotor_radius", *RADII, " m")
        input_map(self.thrust_map)

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.positions)

    @property
    def in_metres(self) -> bool:
        """Whether the positions are in metres; in arms of an unknown length when not."""
        return self.arm_scale is not None

    @property
    def arm(self) -> float:
        """Mean distance of the rotors from the centre, in the unit of the positions."""
        return float(np.mean([math.hypot(*position) for position in self.positions]))


def _check_rotors(positions: tuple[tuple[float, ...], ...], spins: tuple[int, ...]) -> None:
    if not 2 <= len(positions) <= MOST_ROTORS or len(spins) != len(positions):
        raise ParameterError(
            f"positions of 2 to {MOST_ROTORS} rotors, and a spin for each",
            f"{len(positions)} positions and {len(spins)} spins",
            "Give both in the order of the rotors' commands.",
        )
    if not all(len(position) == 2 for position in positions):
        raise ParameterError(
            "two numbers for a rotor's position, forward and left",
            f"{positions}",
            "Leave its height out.",
        )
    for position in positions:
        finite("position", *position)
    if not all(spin in (1, -1) for spin in spins):
        raise ParameterError(
            "spins of +1 or -1",
            f"{spins}",
            "A rotor whose reaction torque on the body points up (clockwise from above) has +1.",
        )
    size = max(max(abs(x), abs(y)) for x, y in positions) or 1.0
    turning = np.array(
        [[y / size, x / size, spin, 1.0] for (x, y), spin in zip(positions, spins, strict=True)]
    )
    if np.linalg.matrix_rank(turning) < turning.shape[1]:
        raise ParameterError(
            "rotors that turn the vehicle about each of its axes",
            f"positions {positions} with spins {spins}, which do not",
            "Correct the positions and the spins: four rotors or more, on all sides, of both spins.",
        )
