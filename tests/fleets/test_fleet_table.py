"""The table of a fleet: its columns, its parts, and the questions of the page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import eivor as ev
from eivor.errors import InputError, UsageError
from eivor.fleet.analysis import QUERIES, query
from eivor.fleet.table import flight_frame, read_flights
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
    chosen = read_flights(fleet.folder, ["drag.value", "name", "unknown"])
    assert chosen.columns == ["drag.value", "name", "unknown"]


def test_what_is_no_fleet_is_told(tmp_path):
    with pytest.raises(InputError, match=r"the folder of a fleet.*eivor fleet run"):
        ev.fleet.open(tmp_path)
    write_fleet(tmp_path / "fleet", [row("a")])
    (tmp_path / "fleet" / "flights" / "part-9.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(InputError, match=r"can be read.*sets damaged parts aside"):
        ev.fleet.open(tmp_path / "fleet")


def test_queries(tmp_path):
    table = flight_frame(
        [
            row("a", vehicle="one", type="quad"),
            row("b", vehicle="one", type="quad", verdict="identified"),
            row("c", vehicle="two", type="quad", verdict="refused", reason="Never airborne."),
            row("d", verdict="failed", reason="It is empty."),
            row("e", verdict="copy", sha256="a" * 8, copy_of="a" * 8, duration_s=None),
        ]
    )
    assert dict(query(table, "verdicts").select("verdict", "logs").rows())["copy"] == 1
    vehicles = query(table, "vehicles").select("vehicle", "logs", "told", "identified", "hours")
    assert vehicles.rows()[0] == ("one", 2, 2, 1, 1.0)
    assert query(table, "failed")["reason"].to_list() == ["It is empty."]
    assert query(table, "refused")["name"].to_list() == ["c"]
    assert query(table, "copies").rows() == [("vertical", "e", "a")]
    assert query(table, "gain")["value"].to_list() == [1.0, 1.0, 1.0]
    with pytest.raises(UsageError, match=r"Did you mean 'gain'\?"):
        query(table, "gian")
    assert all(QUERIES[name](table).columns[0] == "motion" for name in QUERIES)


PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"


BLOCK = re.compile(r"^```sql\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_questions_of_the_page(tmp_path, monkeypatch):
    duckdb = pytest.importorskip("duckdb")
    table = fleet_rows(FleetSpec(vehicles=3, flights=4))
    path = tmp_path / "fleet" / "flights"
    path.mkdir(parents=True)
    table.write_parquet(path / "part-0.parquet")
    flight_frame([row("a", verdict="failed", reason="It is empty.")]).write_parquet(path / "part-1.parquet")
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
