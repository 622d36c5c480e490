"""What a planned flight may do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor import checks
from eivor.errors import UsageError


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Limits of a planned flight. Setpoints stay inside them with room for how a vehicle follows them.

    Parameters
    ----------
    height_m : tuple of float
        Lowest and highest height above the place of take-off [m].
    speed : float
        Largest climb and sink rate [m/s].
    acceleration : float
        Largest vertical acceleration of the setpoints [m/s^2].
    tilt_deg : float
        Largest tilt [deg]; the flight is vertical, and ends beyond it.
    duration_s : float
        Of the whole flight, from the first setpoint to the last [s].

    Raises
    ------
    UsageError
        When a limit is not above zero, the heights leave no room, or the flight is too short or too long.
    """

    height_m: tuple[float, float] = (3.0, 8.0)
    speed: float = 2.0
    acceleration: float = 3.0
    tilt_deg: float = 20.0
    duration_s: float = 60.0

    def __post_init__(self) -> None:
        remedy = "Give FlightLimits(height_m=(3.0, 8.0)), in metres above the place of take-off."
        checks.items("height_m", self.height_m, checks.NUMBERS, "two numbers", remedy)
        ends = [float(end) for end in self.height_m]
        if len(ends) != 2 or not 0.0 < ends[0] <= ends[-1] - 0.5 < math.inf:
            raise UsageError(
                "a lowest height above zero and a highest one, half a metre or more above it",
                f"{self.height_m}",
                remedy,
            )
        checks.within(self, RANGES, "Give another limit.")

    @property
    def middle_m(self) -> float:
        """Height about which a flight is planned [m]."""
        return 0.5 * (self.height_m[0] + self.height_m[1])


#: What each limit may be; a second of the recipe's least run, and flights that a battery bears.
RANGES = {
    "speed": (0.2, 10.0),
    "acceleration": (0.3, 6.0),
    "tilt_deg": (5.0, 60.0),
    "duration_s": (20.0, 600.0),
}
