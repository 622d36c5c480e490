"""Logs whose clock was never set have no time, whatever it says, and are pooled all the same."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import polars as pl
import pytest

from eivor.fleet.analysis import fleet_reports
from eivor.fleet.logs import logs_found
from eivor.fleet.run import run_fleet
from eivor.fleet.table import FleetOptions, read_flights
from validation.simulated_fleets import FleetSpec, write_fleet_logs

#: Where the clocks of logs of one vehicle begin [s since 1970].
BEGIN = {"unset": 30.0, "autumn_of_1970": 86400.0 * 300, "set": 1.77e9, "far": 9.9e12}


@pytest.mark.thorough
def test_clocks_of_1970_tell_no_time(tmp_path: Path) -> None:
    (log,) = write_fleet_logs(FleetSpec(vehicles=1, flights=1, duration_s=6.0), tmp_path / "made")
    rows = pl.read_parquet(log)
    logs = tmp_path / "logs"
    (logs / "one").mkdir(parents=True)
    for name, begin in BEGIN.items():
        rows.with_columns(pl.col("time") - rows["time"][0] + begin).write_csv(logs / "one" / f"{name}.csv")
    options = FleetOptions(vehicle_from="{vehicle}/*.csv")
    run_fleet(logs_found(str(logs)), tmp_path / "fleet", options, guarded=False)
    path = read_flights(tmp_path / "fleet", ["name", "start", "duration_s"])
    assert dict(path.select("name", "start").rows()) == {
        f"one/{name}.csv": datetime(2026, 2, 2, 2, 40, tzinfo=UTC) if name == "set" else None
        for name in BEGIN
    }
    assert path["duration_s"].is_between(5.9, 6.0).all()
    (report,) = fleet_reports(tmp_path / "fleet")
    assert report.logs["logs"] == len(BEGIN)
    assert report.flights["vehicle"].to_list() == ["one"] * len(BEGIN)
