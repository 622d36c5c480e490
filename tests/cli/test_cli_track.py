"""`eivor track` prints, draws and writes what is followed, and says what is wrong."""

from __future__ import annotations

import json
import re

import pytest


@pytest.mark.thorough
def test_track_prints_draws_and_writes(eivor, tmp_path):
    figure, out = tmp_path / "gain.png", tmp_path / "gain.json"
    run = eivor("track", "--example", "--figure", figure, "--json", out)
    assert run.code == 0
    assert "input gain K_u over the flight" in run.out
    assert figure.stat().st_size > 10_000
    document = json.loads(out.read_text())
    assert document["parameter"] == "input_gain"
    assert document["changes"] == []


@pytest.mark.thorough
def test_wrong_usage_is_told(eivor):
    assert eivor("track").code == 2
    run = eivor("track", "--example", "--memory", "900")
    assert (run.code, "the length of the flight" in run.err) == (2, True)
    run = eivor("track", "--example", "--window", "10:12")
    assert (run.code, "no moment identifies it" in run.out) == (3, True)


DAMAGED = """
kind = "flight"
trajectory = "steps"
gust_rms = 0.2
duration = 40.0
gain_after = 0.8
gain_changes_at = 25.0
"""


@pytest.mark.thorough
def test_a_damaged_propeller_is_told(eivor, tmp_path):
    scenario, log, known, gain = (tmp_path / f"damaged{end}" for end in (".toml", ".csv", ".json", "-k.json"))
    scenario.write_text(DAMAGED, encoding="utf-8")
    assert eivor("simulate", scenario, "-o", log, "--truth", known).code == 0
    assert json.loads(known.read_text())["gain_after"] == 0.8
    run = eivor("track", log, "--json", gain)
    assert run.code == 0
    (change,) = json.loads(gain.read_text())["changes"]
    assert not change["upwards"]
    assert 25.0 < change["time_s"] <= 29.0
    assert re.search(r"input gain K_u fell by (19|20|21)\s%", run.out)
