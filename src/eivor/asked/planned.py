"""What is typed of a plan: the place of a mission, and what goes together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eivor.asked import words
from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.planning.limits import FlightLimits
    from eivor.planning.written.formats import Place


def check_mission(qgc: str, home: str, shape: str) -> None:
    """Refuse a mission without a place, a place without a mission, and a mission of another shape than steps.

    Raises
    ------
    UsageError
        For the first of them.
    """
    if bool(qgc) != bool(home):
        raise UsageError(
            "--qgc FILE.plan together with --home LAT,LON",
            "one without the other",
            "A mission of QGroundControl is at a place: --qgc flight.plan --home 47.3977,8.5456.",
        )
    if qgc and shape not in ("", "steps"):
        raise UsageError("--shape steps with --qgc", f"--shape {shape}", "A mission has levels only.")


def place_of(text: str) -> Place:
    """Place of ``LAT,LON`` [deg].

    Raises
    ------
    UsageError
        When it is not two numbers.
    """
    latitude, comma, longitude = text.partition(",")
    try:
        return float(latitude), float(longitude if comma else "")
    except ValueError:
        raise UsageError("--home LAT,LON in degrees", f"'{text}'", "Such as 47.3977,8.5456.") from None


def flight_limits(
    height: str = "3:8",
    speed: float = 2.0,
    acceleration: float = 3.0,
    tilt: float = 20.0,
    time: float = 60.0,
) -> FlightLimits:
    """Limits of a planned flight, with heights as ``LOW:HIGH`` [m].

    Raises
    ------
    UsageError
        When the heights are not two numbers, or no flight can be within the limits.
    """
    from eivor.planning.limits import FlightLimits

    low, high = words.ends(height)
    if not -math.inf < low < high < math.inf:
        expected = "--height LOW:HIGH with both ends, LOW below HIGH"
        raise UsageError(expected, f"'{height}'", "Such as 3:8, in metres above the place of take-off.")
    return FlightLimits((low, high), speed, acceleration, tilt, time)
