"""`eivor inspect`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars
import pytest

import eivor as ev

Caller = Callable[..., Any]
# Numbers and shapes are not the point; test_cli_recordings.py inspects with all lags and checks.
pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.mark.thorough
def test_every_channel_is_listed_with_its_source(eivor: Caller, log: Path, flight: polars.DataFrame) -> None:
    run = eivor("inspect", log)
    assert run.code == 0
    assert run.err == ""
    for name in flight.columns:
        assert name == "time" or name in run.out
    assert "What identify says" in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 100


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_dirt_is_counted(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    path = tmp_path / "dirty.csv"
    table = polars.concat([flight.head(1000), flight.slice(990, 10), flight.slice(1300, 1700)])
    table.write_csv(path)
    document = json.loads(eivor("inspect", path, "--json", "-").out)
    velocity = next(channel for channel in document["channels"] if channel["name"] == "velocity_z")
    assert velocity["duplicated_stamps"] + velocity["backward_stamps"] == 10
    assert len(velocity["gaps"]) == 1
    assert "1 gap of 3" in eivor("inspect", path).out


@pytest.mark.thorough
@pytest.mark.parametrize(
    "arguments",
    [
        ("--example",),
        ("--example", "--window", "0:12"),
        ("LOG", "--max-tilt", "4"),
        ("LOG", "--input", "rotor_command_1"),
        ("LOG", "--input-map", "linear"),
        ("LOG@0:14", "LOG@14:29"),
        ("LOG@0:14", "LOG@14:29", "--max-tilt", "4", "--input-map", "power:2"),
    ],
)
def test_it_foretells_what_identify_says(eivor: Caller, log: Path, arguments: tuple[str, ...]) -> None:
    """With the same arguments, for one log and for several."""
    typed = [argument.replace("LOG", str(log)) for argument in arguments]
    foretold = json.loads(eivor("inspect", *typed, "--json", "-").out)
    sentence = json.loads(eivor("identify", *typed, "--json", "-").out)
    assert (foretold["verdict"], foretold["reasons"]) == (sentence["verdict"], sentence["reasons"])


@pytest.mark.thorough
def test_several_logs_are_told_one_by_one_and_together(eivor: Caller, log: Path) -> None:
    run = eivor("inspect", f"{log}@0:14", f"{log}@14:29")
    assert run.code == 0
    assert run.out.count("What identify says (found by running it)") == 2
    assert "What identify says of the 2 logs together" in run.out
    assert "flight.csv@0:14" in run.out
    document = json.loads(eivor("inspect", f"{log}@0:14", f"{log}@14:29", "--json", "-").out)
    described = (
        (Path(__file__).parents[2] / "docs" / "json.md").read_text().partition("## `eivor.inspect_pool/1`")[2]
    )
    assert document["schema"] == "eivor.inspect_pool/1"
    assert all(f"| `{key}` |" in described for key in document)
    ends = [part["airborne"]["used"][-1][1] for part in document["logs"]]
    assert ends == pytest.approx([14.0, 29.0], abs=0.05)
    assert {part["schema"] for part in document["logs"]} == {"eivor.inspect/1"}


@pytest.mark.thorough
def test_a_log_of_several_windows_is_read_once(
    eivor: Caller, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standard input cannot be read a second time."""
    read: list[Path] = []
    read_log = ev.read_log

    def counted(path: Path, **options: Any) -> ev.Recording:
        read.append(path)
        return read_log(path, **options)

    monkeypatch.setattr("eivor.cli.identify.read_log", counted)
    document = json.loads(eivor("inspect", f"{log}@0:14", f"{log}@14:29", "--json", "-").out)
    assert len(document["logs"]) == 2
    assert read == [log]


@pytest.mark.thorough
def test_logs_that_cannot_be_pooled_are_inspected(
    eivor: Caller, log: Path, flight: polars.DataFrame, tmp_path: Path
) -> None:
    blind = tmp_path / "blind.csv"
    flight.drop("velocity_z").write_csv(blind)
    document = json.loads(eivor("inspect", log, blind, "--json", "-").out)
    assert document["verdict"] == "unusable"
    assert "velocity_z" in document["reasons"][0]
    assert [part["verdict"] == "unusable" for part in document["logs"]] == [False, True]
    assert "cannot begin" in eivor("inspect", log, blind).out


def test_wrong_usage_and_unreadable_input(eivor: Caller, log: Path, tmp_path: Path) -> None:
    assert eivor("inspect").code == 2
    assert "received both" in eivor("inspect", log, "--example").err
    assert eivor("inspect", "--example", "--map", "nanobench").code == 2
    assert eivor("inspect", log, "--max-tilt", "91").code == 2
    assert eivor("inspect", log, "--input-map", "cube").code == 2
    assert eivor("inspect", log, "--window", "x").code == 2
    assert eivor("inspect", log, "--window", "900:901").code == 2
    assert eivor("inspect", tmp_path / "none.ulg").code == 1
    assert eivor("inspect", log, "--json", tmp_path / "none" / "x.json").code == 1
