"""The study of a fleet's runs at a reduced size, and its tables."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from validation.fleet_run import study
from validation.fleet_run.study import Told

TOLD = Told("one", "one process", 17, 17, 17, {"weak": 17}, "a", 1_000_000, 3, 1500.0, 0, 9.0, 8.0, 100.0)


@pytest.mark.long
def test_whatever_computes_a_fleet_and_whatever_is_killed(tmp_path, capsys):
    """Two processes, runs that are killed and interrupted, two workers of Dask of which one is killed."""
    assert study.main(["--kept", str(tmp_path / "kept.jsonl")]) == 0
    assert "| different tables, compared to the byte | 1 | 1 | yes |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("other", "code"), [({}, 0), ({"sha256": "b"}, 3), ({"rows": 16}, 3), ({"ended": 1}, 3)]
)
def test_the_command_makes_the_page_of_a_kept_study(tmp_path, capsys, monkeypatch, other, code):
    killed = replace(TOLD, mode="ended", what="killed", **{"ended": 5, **other})
    modes = {"one": lambda *_: TOLD, "ended": lambda *_: killed}
    monkeypatch.setattr(study, "MODES", modes)
    monkeypatch.setattr(study, "write_logs", lambda *_: None)
    (tmp_path / "kept.cost.jsonl").write_text(json.dumps({"flight_s": 300.0, "cpu_s": 0.9}) + "\n")
    page, arguments = tmp_path / "page.md", ["--kept", str(tmp_path / "kept.jsonl"), "--page"]
    page.write_text("<!-- generated: fleet run -->\n<!-- end: fleet run -->\n")
    assert study.main([*arguments, str(page)]) == code
    table = capsys.readouterr().out
    assert "| processor time, 0.90 s for a flight of 300 s | 250 hours; 2.5 h on 100 cores |" in table
    assert "| table, 1.50 kB a row | 1.5 GB |" in table
    assert table.strip() in page.read_text()
    modes.clear()  # what was kept is not made again
    monkeypatch.setattr(study, "MODES", dict.fromkeys(("one", "ended")))
    assert study.main([*arguments, str(page)]) == code
