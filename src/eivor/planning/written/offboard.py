"""A plan as a program that flies it: MAVSDK-Python, offboard mode.

The program is `fly_plan.txt`, in which numbers replace one line: no text of a log or of a user enters it.
"""

from __future__ import annotations

from importlib.resources import files

from eivor.planning.plan import FlightPlan
from eivor.planning.written.samples import sampled

#: Setpoints per second.
RATE_HZ = 20.0
#: Line of the program in whose place the numbers stand.
MARK = "# -- numbers --\n"
#: Least charge of the battery before the flight, and during it [%].
BATTERY_BEFORE, BATTERY_DURING = 50.0, 30.0


def mavsdk_text(plan: FlightPlan) -> str:
    """Text of a Python program for MAVSDK-Python 3."""
    rows = sampled(plan, RATE_HZ)
    limits = plan.limits
    numbers = {
        "LOWEST_M": limits.height_m[0],
        "HIGHEST_M": limits.height_m[1],
        "MIDDLE_M": limits.middle_m,
        "NEAR_MIDDLE_M": min(0.5, 0.25 * (limits.height_m[1] - limits.height_m[0]) * 0.5),
        "FASTEST_M_S": limits.speed,
        "TILT_DEG": limits.tilt_deg,
        "BATTERY_BEFORE_PERCENT": BATTERY_BEFORE,
        "BATTERY_DURING_PERCENT": BATTERY_DURING,
    }
    lines = [f"{name} = {float(value)!r}" for name, value in numbers.items()]
    lines.append("SETPOINTS = (")
    for time, height, velocity, acceleration in rows.tolist():
        above = height - limits.middle_m
        lines.append(f"    ({time:.2f}, {above:.4f}, {velocity:.4f}, {acceleration:.4f}),")
    lines.append(")")
    program = files("eivor.planning.written").joinpath("fly_plan.txt").read_text(encoding="utf-8")
    return program.replace(MARK, "\n".join(lines) + "\n")
