"""A plan of steps as a mission of QGroundControl: levels, each with its hold, above one place.

The autopilot goes from level to level in its own way, at the plan's speed: what it flies differs a little
from what was simulated. A multisine is no mission: fly it in offboard mode.
"""

from __future__ import annotations

import json
import math

import numpy as np

from eivor.errors import UsageError
from eivor.planning.plan import FlightPlan
from eivor.planning.setpoints import STEP_S

#: Commands of MAVLink.
WAYPOINT, LOITER, TAKEOFF, CHANGE_SPEED = 16, 17, 22, 178
#: Frame of heights above the place of take-off; commands without a place have another.
RELATIVE, NO_PLACE = 3, 2
#: QGroundControl's words for the firmware and the vehicle: PX4 and a multirotor.
PX4, QUADROTOR = 12, 2
CLIMB, DESCENT = 2.0, 3.0


def qgc_text(plan: FlightPlan, home: tuple[float, float]) -> str:
    """Text of a .plan file.

    Parameters
    ----------
    plan : FlightPlan
        Of steps.
    home : tuple of float
        Latitude and longitude of the place [deg].

    Raises
    ------
    UsageError
        For another shape, or a place that is none.
    """
    if plan.shape.kind != "steps":
        raise UsageError("a plan of steps", f"a {plan.shape.kind}", "Plan with --shape steps.")
    latitude, longitude = home
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise UsageError(
            "a latitude and a longitude [deg]", f"{latitude:g}, {longitude:g}", "Such as 47.4,8.5."
        )
    place = [round(float(latitude), 7), round(float(longitude), 7)]
    speed = plan.limits.speed * 0.8
    items = [
        _item(TAKEOFF, RELATIVE, [0.0, 0.0, 0.0, None, *place, plan.limits.middle_m]),
        _item(CHANGE_SPEED, NO_PLACE, [CLIMB, speed, -1.0, 0.0, 0.0, 0.0, 0.0]),
        _item(CHANGE_SPEED, NO_PLACE, [DESCENT, speed, -1.0, 0.0, 0.0, 0.0, 0.0]),
    ]
    for height, hold_s in levels(plan):
        items.append(_item(WAYPOINT, RELATIVE, [hold_s, 0.0, 0.0, None, *place, height]))
    items.append(_item(LOITER, RELATIVE, [0.0, 0.0, 0.0, None, *place, plan.limits.middle_m]))
    for number, item in enumerate(items):
        item["doJumpId"] = number + 1
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": PX4,
            "vehicleType": QUADROTOR,
            "cruiseSpeed": 5.0,
            "hoverSpeed": 2.0,
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": [*place, 0.0],
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def levels(plan: FlightPlan) -> list[tuple[float, float]]:
    """Heights above take-off [m] at which the setpoint rests, each with how long [s], in order."""
    slow = np.abs(plan.velocity) < 0.05 * plan.limits.speed
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(np.int8), [0]])))
    found: list[tuple[float, float]] = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        height = round(float(np.median(plan.height[first:last])), 2)
        if not found or abs(height - found[-1][0]) > 0.1:
            found.append((height, max(math.floor((last - first) * STEP_S * 10.0) / 10.0, 0.0)))
    return found


def _item(command: int, frame: int, params: list[float | None]) -> dict[str, object]:
    """One item of the mission, as QGroundControl writes it."""
    item: dict[str, object] = {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": 0,
        "frame": frame,
        "params": params,
    }
    if frame == RELATIVE:
        item |= {"AMSLAltAboveTerrain": None, "Altitude": params[-1], "AltitudeMode": 1}
    return item
