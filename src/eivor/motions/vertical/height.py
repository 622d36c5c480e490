"""How near to the ground a flight was, in rotor radii: there rotors give more thrust than the model knows.

A rotor by itself gains 1 / (1 - (R / 4 h)^2) (Cheeseman and Bennett 1955): .4 % four radii above the ground,
7 % at one. The gain takes that up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from eivor.flights.circumstances import Circumstances
from eivor.flights.prepared import PreparedFlight
from eivor.inference.verdict import Reason, Status
from eivor.motions.vertical.surroundings import ground, height_over_ground

#: A flight is near the ground below so many radii, when it is there for this share of the time used.
NEAR_RADII, NEAR_SHARE = 4.0, 0.01
#: Numbers of this motion: the share of the time near the ground, and the lowest height in radii.
NEAR_GROUND, LOWEST = "near_ground_share", "lowest_radii"


def near_ground(
    flights: Sequence[PreparedFlight], radius: float | None, *, corrected: bool
) -> Mapping[str, float]:
    """Share of the time used that was near the ground, and the lowest height; of the lowest flight.

    Parameters
    ----------
    flights : sequence of PreparedFlight
        With runs.
    radius : float, optional
        Of a rotor [m]; nothing is told without it, nor where a log does not tell the ground.
    corrected : bool
        The equation has the ground's effect: nothing is told then.
    """
    if radius is None or corrected:
        return {}
    shares, lowest = [], []
    for flight in flights:
        height = height_over_ground(flight)
        if height is not None and ground(flight) is not None:
            radii = height[flight.used] / radius
            shares.append(float(np.mean(radii < NEAR_RADII)))
            lowest.append(float(radii.min()))
    return {NEAR_GROUND: max(shares), LOWEST: min(lowest)} if shares else {}


def near_ground_reasons(at: Circumstances) -> list[Reason]:
    """Ground against gain and hover input: a flight near the ground."""
    share = at.numbers.get(NEAR_GROUND, 0.0)
    if share < NEAR_SHARE:
        return []
    return [
        Reason(
            Status.WEAK,
            f"The vehicle flew below {NEAR_RADII:.0f} rotor radii over the ground for {share:.0%} of the "
            f"time ({at.numbers[LOWEST]:.1f} at the lowest): thrust grows there, and the gain takes it up.",
            "Fly higher, or add --term ground-effect.",
        )
    ]
