"""What is known of the lag, on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Caller = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def test_a_lag_is_given_in_milliseconds(eivor: Caller, log: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--json", "-")
    document = json.loads(run.out)
    assert document["provenance"]["options"]["lag"] == {"mean": 0.07, "std": 0.015}
    assert document["given_lag"]["mean"] == 0.07
    assert "given 70 ± 15 ms" in eivor("identify", log, "--lag", "70:15").out


def test_a_lag_is_taken_from_another_flight(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    told = json.loads(other.read_text())["derived"]["effective_lag"]
    given = json.loads(eivor("identify", log, "--lag-from", other, "--json", "-").out)["given_lag"]
    assert given["mean"] == told["value"]
    low, high = told["interval"]
    assert given["std"] == pytest.approx(max((high - low) / 4.0, told["std_error"]))


@pytest.mark.parametrize(
    "text", ["70", "70:", ":15", "x:15", "70:0", "-70:15", "nan:15", "70:15:3", "70..90"]
)
def test_a_lag_that_is_none_is_refused(eivor: Caller, log: Path, text: str) -> None:
    run = eivor("identify", log, f"--lag={text}")
    assert run.code == 2
    assert "a lag MS:STD" in run.err
    assert "Give 70:15" in run.err


def test_one_of_the_two_is_given(eivor: Caller, log: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--lag-from", "other.json")
    assert run.code == 2
    assert "--lag or --lag-from" in run.err


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
