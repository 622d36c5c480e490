"""`eivor plan` as it is called; the plan itself is made elsewhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eivor.planning.vehicle import VehicleGuess
from eivor.report import other_results
from planning.conftest import planned as plan_of

Caller = Callable[..., Any]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What the command asks for; it gets a plan without simulations."""
    calls: list[dict[str, Any]] = []

    def made(vehicle: VehicleGuess, **options: Any) -> Any:
        calls.append({"vehicle": vehicle, **options})
        return plan_of(options["shape"] or "multisine")

    monkeypatch.setattr(other_results, "make_plan", made)
    return calls


def test_every_form_is_written(eivor: Caller, asked: list[dict[str, Any]], tmp_path: Path) -> None:
    files = {name: tmp_path / f"flight{ending}" for name, ending in (("csv", ".csv"), ("mavsdk", ".py"))}
    files |= {"rotorpy": tmp_path / "trajectory.py", "qgc": tmp_path / "flight.plan"}
    options = [text for name, path in files.items() for text in (f"--{name}", path)]
    run = eivor("plan", "--for", "friction", "--home", "47.4,8.5", "--json", tmp_path / "plan.json", *options)
    assert run.code == 3  # identified in one of two simulated flights
    assert "identified in 1 of 2" in " ".join(run.out.split())
    assert "is not identified in most" in run.err
    assert all(path.stat().st_size > 500 for path in files.values())
    assert json.loads((tmp_path / "plan.json").read_text())["schema"] == "eivor.plan/1"
    assert asked[0]["shape"] == "steps"  # a mission has levels only


def test_rough_numbers_and_limits_reach_the_plan(
    eivor: Caller, asked: list[dict[str, Any]], tmp_path: Path
) -> None:
    limits = ("--height", "2:4", "--speed", "1", "--time", "90", "--tilt", "15", "--acceleration", "2")
    run = eivor("plan", "--hover", "0.4", "--lag", "80", "--gusts", "0.6", *limits, "--json", "-")
    assert json.loads(run.out)["target"] == "friction"
    assert asked[0]["vehicle"] == VehicleGuess(hover_input=0.4, lag_s=0.08, gust_rms=0.6)
    result = asked[0]["limits"]
    assert (result.height_m, result.speed, result.duration_s) == ((2.0, 4.0), 1.0, 90.0)
    assert (result.tilt_deg, result.acceleration) == (15.0, 2.0)
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text("viscous_friction = 0.7\n")
    assert eivor("plan", vehicle).code == 3
    assert asked[1]["vehicle"].viscous_friction == 0.7


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--qgc", "a.plan"), "--home LAT,LON"),
        (("--qgc", "a.plan", "--home", "1,2", "--shape", "multisine"), "--shape steps with --qgc"),
        (("--height", "3:"), "with both ends"),
        (("--height", "9:3"), "--height LOW:HIGH with both ends, LOW below HIGH; received '9:3'"),
        (("--height", "high"), "--height LOW:HIGH with both ends"),
        (("--csv", ""), "Expected a value for --csv; received an empty text. Give --csv FILE, or leave"),
        (("--hover", "2"), "hover_input between"),
        (("fit.json", "--hover", "0.5"), "rough numbers as options"),
    ],
)
def test_wrong_usage_is_told(
    eivor: Caller, asked: list[dict[str, Any]], options: tuple[str, ...], words: str
) -> None:
    run = eivor("plan", *options)
    assert run.code == 2
    assert words in run.err
    assert not asked


def test_a_file_that_is_no_result_is_told(eivor: Caller, tmp_path: Path) -> None:
    assert eivor("plan", tmp_path / "none.json").code == 1
