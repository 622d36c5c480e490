"""`eivor inspect`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars
import pytest

Caller = Callable[..., Any]


def test_every_channel_is_listed_with_its_source(eivor: Caller, log: Path, flight: polars.DataFrame) -> None:
    run = eivor("inspect", log)
    assert run.code == 0
    assert run.err == ""
    for name in flight.columns:
        assert name == "time" or name in run.out
    assert "What identify says" in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 100


def test_json_has_the_documented_keys(eivor: Caller, log: Path, tmp_path: Path) -> None:
    run = eivor("inspect", f"{log}@5:20", "--json", "-")
    document = json.loads(run.out)
    described = (
        (Path(__file__).parents[2] / "docs" / "json.md").read_text().partition("## `eivor.inspect/1`")[2]
    )
    assert document["schema"] == "eivor.inspect/1"
    assert all(f"| `{key}` |" in described for key in document)
    assert all(f"`{key}`" in described for channel in document["channels"] for key in channel)
    assert document["airborne"]["used"] == [pytest.approx([5.0, 20.0], abs=0.02)]
    assert eivor("inspect", log, "--json", tmp_path / "x.json").code == 0
    assert json.loads((tmp_path / "x.json").read_text())["verdict"]


def test_a_log_that_identify_cannot_use_is_inspected(
    eivor: Caller, flight: polars.DataFrame, tmp_path: Path
) -> None:
    path = tmp_path / "blind.csv"
    flight.drop("velocity_z").write_csv(path)
    run = eivor("inspect", path)
    assert run.code == 0
    assert "velocity_z (needed)" in run.out
    assert "cannot begin" in run.out
    assert "Add a column 'velocity_z'" in run.out
    assert json.loads(eivor("inspect", path, "--json", "-").out)["verdict"] == "unusable"


def test_dirt_is_counted(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    path = tmp_path / "dirty.csv"
    table = polars.concat([flight.head(1000), flight.slice(990, 10), flight.slice(1300, 1700)])
    table.write_csv(path)
    document = json.loads(eivor("inspect", path, "--json", "-").out)
    velocity = next(channel for channel in document["channels"] if channel["name"] == "velocity_z")
    assert velocity["duplicated_stamps"] + velocity["backward_stamps"] == 10
    assert len(velocity["gaps"]) == 1
    assert "1 gap up to 3" in eivor("inspect", path).out


def test_wrong_usage_and_unreadable_input(eivor: Caller, log: Path, tmp_path: Path) -> None:
    assert eivor("inspect").code == 2
    assert eivor("inspect", log, "--window", "x").code == 2
    assert eivor("inspect", log, "--window", "900:901").code == 2
    assert eivor("inspect", tmp_path / "none.ulg").code == 1
    assert eivor("inspect", log, "--json", tmp_path / "none" / "x.json").code == 1
