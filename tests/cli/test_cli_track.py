"""`eivor track` prints, draws and writes what is followed, and says what is wrong."""

from __future__ import annotations

import json


def test_track_prints_draws_and_writes(eivor, tmp_path):
    figure, out = tmp_path / "gain.png", tmp_path / "gain.json"
    run = eivor("track", "--example", "--figure", figure, "--json", out)
    assert run.code == 0
    assert "input gain K_u over the flight" in run.out
    assert figure.stat().st_size > 10_000
    document = json.loads(out.read_text())
    assert document["parameter"] == "input_gain"
    assert document["changes"] == []


def test_wrong_usage_is_told(eivor):
    assert eivor("track").code == 2
    run = eivor("track", "--example", "--memory", "900")
    assert (run.code, "up to the length of the flight" in run.err) == (2, True)
    run = eivor("track", "--example", "--window", "10:12")
    assert (run.code, "no moment tells it" in run.out) == (3, True)
