"""Fleets with known truth, as a table and as logs."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from eivor.errors import UsageError
from eivor.fleet.analysis import across_of, wanted_columns
from eivor.logs import read_log
from eivor.motions import motion_by_name
from eivor.motions.vertical.model import GRAVITY
from validation.simulated_fleets import FleetSpec, fleet_rows, fleet_truth, write_fleet_logs


def test_wear_breakage_and_weather_act_on_thrust():
    spec = FleetSpec(
        vehicles=2, flights=5, between_vehicles=0.0, between_flights=0.0, wear=0.2, broken=((1, 3, 0.5),)
    )
    truth = fleet_truth(spec)
    assert truth.worn[:5] == pytest.approx([1.0, 0.95, 0.9, 0.85, 0.8])
    assert truth.worn[5:] == pytest.approx([1.0, 0.95, 0.9, 0.425, 0.4])
    assert truth.input_gain == pytest.approx(GRAVITY / 0.25 * truth.worn)
    assert truth.hover_input**2 * truth.input_gain == pytest.approx(GRAVITY)
    windy = fleet_truth(FleetSpec(vehicles=1, flights=50, between_flights=0.0, weather=0.05, battery=0.03))
    explained = np.log(windy.air_density / 1.20) + 1.5 * np.log(windy.battery_voltage / 15.6)
    left = np.log(windy.input_gain) - explained
    assert left == pytest.approx(np.full(50, left[0]))


def test_rows_are_the_truth_with_errors_as_they_say():
    spec = FleetSpec(vehicles=50, flights=40)
    rows, truth = fleet_rows(spec), fleet_truth(spec)
    off = (rows["input_gain.value"].to_numpy() - truth.input_gain) / rows["input_gain.std_error"].to_numpy()
    assert np.std(off) == pytest.approx(1.0, abs=0.06)
    columns = set(wanted_columns(across_of(motion_by_name("vertical"))))
    assert columns - set(rows.columns) == {"mass"}  # which no log tells
    assert rows.equals(fleet_rows(spec))
    assert rows.filter(pl.col("vehicle") == "v0001")["start"].is_sorted()


@pytest.mark.long
@pytest.mark.usefixtures("unchecked_shapes")
def test_logs_are_flights_of_the_truth(tmp_path):
    spec = FleetSpec(vehicles=2, flights=1, duration_s=4.0)
    logs = list(write_fleet_logs(spec, tmp_path))
    assert [path.relative_to(tmp_path).as_posix() for path in logs] == [
        "v0000/0000.parquet",
        "v0001/0000.parquet",
    ]
    truth = fleet_truth(spec)
    for path, hover in zip(logs, truth.hover_input, strict=True):
        command = read_log(path).channels["rotor_command_1"].values
        assert np.sqrt(np.mean(command**2)) == pytest.approx(hover, rel=0.1)


@pytest.mark.parametrize("wrong", [{"vehicles": 0}, {"wear": 1.0}, {"broken": ((0, 1, 1.5),)}])
def test_what_is_no_fleet_is_refused(wrong):
    with pytest.raises(UsageError, match=r"fleet of one vehicle|share of thrust"):
        FleetSpec(**wrong)
