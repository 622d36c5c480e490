"""Simulators that know one order of rotors: four of them, one in each quarter."""

from __future__ import annotations

from eivor.errors import UsageError
from eivor.motions.rigid_body.known_vehicle import KnownVehicle

#: Signs of the places forward and left: front right, rear right, rear left, front left.
QUARTERS = ((1, -1), (-1, -1), (-1, 1), (1, 1))


def by_quarters(vehicle: KnownVehicle, target: str) -> tuple[int, ...]:
    """Numbers of the rotors, from zero, in the order of `QUARTERS`.

    Raises
    ------
    UsageError
        When there is another number of rotors, they are elsewhere, or neighbours turn the same way.
    """
    order = [
        number
        for ahead, left in QUARTERS
        for number, (x, y) in enumerate(vehicle.positions)
        if x * ahead > 0.0 and y * left > 0.0
    ]
    spins = [vehicle.spins[number] for number in order]
    if vehicle.count != len(QUARTERS) or spins not in ([1, -1, 1, -1], [-1, 1, -1, 1]):
        raise UsageError(
            f"four rotors for {target}, one in each quarter, neighbours of opposite spins",
            f"rotors at {vehicle.positions} with spins {vehicle.spins}",
            "Export to another simulator: mujoco, rotorpy and gazebo take rotors anywhere.",
        )
    return tuple(order)


def mean_distances(vehicle: KnownVehicle) -> tuple[float, float]:
    """Mean distance of the rotors forward or behind, and to a side [m]."""
    count = vehicle.count
    return sum(abs(x) for x, _ in vehicle.positions) / count, sum(
        abs(y) for _, y in vehicle.positions
    ) / count
