"""What is known of the lag, on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Caller = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_lag_is_given_in_milliseconds(eivor: Caller, log: Path, tmp_path: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--json", tmp_path / "fit.json")
    document = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert document["provenance"]["options"]["lag"] == {"mean": 0.07, "std": 0.015}
    assert document["given_lag"]["mean"] == 0.07
    assert "given 70 ± 15 ms" in run.out


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_bounds_of_a_lag_and_no_lag_are_given(eivor: Caller, log: Path) -> None:
    document = json.loads(eivor("identify", log, "--lag", "50..90", "--json", "-").out)
    assert document["provenance"]["options"]["lag"] == {"low": 0.05, "high": 0.09}
    given = document["given_lag"]
    assert [given[name] for name in ("mean", "std", "low", "high")] == [None, None, 0.05, 0.09]
    assert document["derived"]["effective_lag"]["interval"] == [0.05, 0.09]
    run = eivor("identify", log, "--lag", "none")
    assert "given neither lag nor delay; the flight alone says" in run.out.replace("\n", " ")
    assert "they contradict each other" in " ".join(run.out.split())


@pytest.mark.thorough
def test_a_lag_is_taken_from_another_flight(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    reported = json.loads(other.read_text())["derived"]["effective_lag"]
    given = json.loads(eivor("identify", log, "--lag-from", other, "--json", "-").out)["given_lag"]
    assert given["mean"] == reported["value"]
    low, high = reported["interval"]
    assert given["std"] == pytest.approx(max((high - low) / 4.0, reported["std_error"]))


@pytest.mark.parametrize(
    "text",
    [
        "70",
        "70:",
        ":15",
        "x:15",
        "70:0",
        "-70:15",
        "nan:15",
        "70:15:3",
        "90..70",
        "-5..10",
        "5..",
        "..5",
        "5..nan",
        "5...7..9",
        "no",
    ],
)
def test_a_lag_that_is_none_is_refused(eivor: Caller, log: Path, text: str) -> None:
    run = eivor("identify", log, f"--lag={text}")
    assert run.code == 2
    assert "a lag MS:STD" in run.err
    assert "Give 70:15 or 50..90" in " ".join(run.err.split())


def test_one_of_the_two_is_given(eivor: Caller, log: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--lag-from", "other.json")
    assert run.code == 2
    assert "--lag or --lag-from" in run.err


@pytest.mark.thorough
def test_a_result_that_does_not_tell_its_lag_is_refused(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    document = json.loads(other.read_text())
    document["derived"]["effective_lag"]["verdict"] = "refused"
    other.write_text(json.dumps(document))
    run = eivor("identify", log, "--lag-from", other)
    assert run.code == 2
    assert "one whose lag is refused" in run.err
    missing = eivor("identify", log, "--lag-from", tmp_path / "none.json")
    assert missing.code == 1
    assert "none.json" in missing.err
