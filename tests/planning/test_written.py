"""Plans as tables, missions and trajectories, read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eivor.errors import UsageError
from eivor.planning.plan import FlightPlan, csv_text, levels, qgc_text, rotorpy_text
from planning.conftest import written_module

HOME = (47.3977, 8.5456)
NUMBER = (int, float)
ITEM = {"type", "autoContinue", "command", "doJumpId", "frame", "params"}
PLACED = ITEM | {"AMSLAltAboveTerrain", "Altitude", "AltitudeMode"}
MISSION = {
    "version": int,
    "firmwareType": int,
    "vehicleType": int,
    "cruiseSpeed": NUMBER,
    "hoverSpeed": NUMBER,
    "globalPlanAltitudeMode": int,
    "plannedHomePosition": list,
    "items": list,
}


def strictly_read(text: str) -> list[dict[str, Any]]:
    """Items of a .plan file; every key, type and number of it is looked at."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    document = json.loads(text, parse_constant=refuse)
    assert set(document) == {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"}
    assert (document["fileType"], document["version"]) == ("Plan", 1)
    assert document["groundStation"] == "QGroundControl"
    assert document["geoFence"] == {"version": 2, "circles": [], "polygons": []}
    assert document["rallyPoints"] == {"version": 2, "points": []}
    mission = document["mission"]
    assert set(mission) == set(MISSION)
    assert all(isinstance(mission[key], kind) for key, kind in MISSION.items())
    assert mission["version"] == 2
    assert len(mission["plannedHomePosition"]) == 3
    for number, item in enumerate(mission["items"], start=1):
        assert item["type"] == "SimpleItem"
        assert item["doJumpId"] == number
        assert item["autoContinue"] is True
        assert len(item["params"]) == 7
        assert all(value is None or isinstance(value, NUMBER) for value in item["params"])
        if item["frame"] == 3:
            assert set(item) == PLACED
            assert item["command"] in {16, 17, 22}
            assert item["params"][4:6] == list(HOME)
            assert item["Altitude"] == item["params"][6]
            assert item["AltitudeMode"] == 1
            assert item["AMSLAltAboveTerrain"] is None
        else:
            assert set(item) == ITEM
            assert (item["frame"], item["command"]) == (2, 178)
    return mission["items"]


def test_the_mission_climbs_to_every_level_and_loiters(steps: FlightPlan) -> None:
    items = strictly_read(qgc_text(steps, HOME))
    commands = [item["command"] for item in items]
    assert commands[:3] == [22, 178, 178]
    assert commands[-1] == 17
    assert set(commands[3:-1]) == {16}
    low, high = steps.limits.height_m
    flight = [(item["Altitude"], item["params"][0]) for item in items if item["command"] == 16]
    assert flight == levels(steps)
    assert all(low < height < high and hold >= 0.0 for height, hold in flight)
    rises = np.sign(np.diff([height for height, _ in flight]))
    assert len(flight) > 5
    assert (rises[1:-1] != rises[2:]).all()


def test_a_multisine_or_a_wrong_place_is_no_mission(multisine: FlightPlan, steps: FlightPlan) -> None:
    with pytest.raises(UsageError, match="a plan of steps"):
        qgc_text(multisine, HOME)
    with pytest.raises(UsageError, match="a latitude and a longitude"):
        qgc_text(steps, (91.0, 0.0))


def test_the_table_is_the_plan(multisine: FlightPlan) -> None:
    head, *rows = csv_text(multisine).splitlines()
    assert head == "time,reference_position_z,reference_velocity_z,reference_acceleration_z"
    read = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(read[:, 1], multisine.height[::2], atol=1e-3)
    np.testing.assert_allclose(read[:, 2], multisine.velocity[::2], atol=1e-3)


def test_the_trajectory_gives_flat_outputs(multisine: FlightPlan, tmp_path: Path) -> None:
    flight = written_module(rotorpy_text(multisine), tmp_path).PlannedFlight(place=(1.0, 2.0))
    update = flight.update(10.0)
    np.testing.assert_allclose(update["x"], [1.0, 2.0, multisine.height[1000]], atol=1e-3)
    np.testing.assert_allclose(update["x_dot"], [0.0, 0.0, multisine.velocity[1000]], atol=1e-3)
    np.testing.assert_allclose(update["x_ddot"], [0.0, 0.0, multisine.acceleration[1000]], atol=1e-3)
    assert {"x_dddot", "x_ddddot", "yaw", "yaw_dot", "yaw_ddot"} <= set(update)
    np.testing.assert_allclose(flight.update(1e3)["x"][2], multisine.height[-2:], atol=1e-3)
