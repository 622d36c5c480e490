"""The table of a fleet: its columns, its parts, and the questions of the page."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import eivor as ev
from eivor.errors import InputError
from eivor.fleet.run import compact_fleet
from fleets.fleet_rows import row, write_fleet
from validation.simulated_fleets import FleetSpec, fleet_rows


def test_parts_of_several_motions_are_put_together_by_name(tmp_path):
    other = {name.replace("gain.", "drag."): value for name, value in row("a", motion="rates").items()}
    fleet = ev.fleet.open(write_fleet(tmp_path / "fleet", [row("b"), row("a")], [other]))
    assert fleet.flights.select("motion", "name", "gain.value", "drag.value").rows() == [
        ("rates", "a", None, 1.0),
        ("vertical", "a", 1.0, None),
        ("vertical", "b", 1.0, None),
    ]
    assert fleet.quantities.select("motion", "name", "quantity", "value").rows() == [
        ("rates", "a", "drag", 1.0),
        ("vertical", "a", "gain", 1.0),
        ("vertical", "b", "gain", 1.0),
    ]


def test_what_is_no_fleet_is_told(tmp_path):
    with pytest.raises(InputError, match=r"the folder of a fleet.*eivor fleet run"):
        ev.fleet.open(tmp_path)
    write_fleet(tmp_path / "fleet", [row("a")])
    (tmp_path / "fleet" / "flights" / "part-9.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(InputError, match=r"can be read.*sets damaged parts aside"):
        ev.fleet.open(tmp_path / "fleet")


def test_queries(tmp_path, command_line):
    rows = [
        row("a", vehicle="one", type="quad"),
        row("b", vehicle="one", type="quad", verdict="identified"),
        row("c", vehicle="two", type="quad", verdict="refused", reason="Never airborne."),
        row("d", verdict="failed", reason="It is empty."),
        row("e", verdict="copy", sha256="a" * 8, copy_of="a" * 8, duration_s=None),
    ]
    folder = write_fleet(tmp_path / "fleet", rows)

    def query(what):
        run = command_line("fleet", "query", folder, what, "--csv", "-")
        assert run.code == 0, run.err
        table = pl.read_csv(io.StringIO(run.out))
        assert table.columns[0] == "motion"
        return table

    assert dict(query("verdicts").select("verdict", "logs").rows())["copy"] == 1
    vehicles = query("vehicles").select("vehicle", "logs", "told", "identified", "hours")
    assert vehicles.rows()[0] == ("one", 2, 2, 1, 1.0)
    assert query("failed")["reason"].to_list() == ["It is empty."]
    assert query("refused")["name"].to_list() == ["c"]
    assert query("copies").rows() == [("vertical", "e", "a")]
    assert query("gain")["value"].to_list() == [1.0, 1.0, 1.0]
    run = command_line("fleet", "query", folder, "gian")
    assert run.code == 2
    assert "Did you mean 'gain'?" in run.err


PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"

BLOCK = re.compile(r"^```sql\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_questions_of_the_page(tmp_path, monkeypatch):
    duckdb = pytest.importorskip("duckdb")
    table = fleet_rows(FleetSpec(vehicles=3, flights=4))
    write_fleet(tmp_path / "fleet", [row("a", verdict="failed", reason="It is empty.")])
    table.write_parquet(tmp_path / "fleet" / "flights" / "part-1.parquet")
    compact_fleet(tmp_path / "fleet")
    monkeypatch.chdir(tmp_path)
    questions = [text for block in BLOCK.findall(PAGE.read_text("utf-8")) for text in block.split(";")]
    fixed, failed, over_time = (duckdb.sql(text) for text in questions if text.strip())
    weight = 1.0 / pl.col("input_gain.std_error") ** 2
    expected = table.group_by("vehicle").agg(
        pl.len(), (pl.col("input_gain.value") * weight).sum() / weight.sum()
    )
    assert fixed.fetchall() == [pytest.approx(item) for item in expected.sort("vehicle").rows()]
    assert failed.fetchall() == [("a", "It is empty.")]
    assert over_time.shape == (table.height, 5)
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(code, PAGE.name, "exec"), names)  # noqa: S102 - the project's own page
    assert names["fleet"].flights.height == table.height + 1
    assert set(names["fleet"].quantities["name"]) == set(table["name"])
