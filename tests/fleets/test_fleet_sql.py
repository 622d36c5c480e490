"""The questions in SQL of the documentation's page, asked of a simulated fleet."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from eivor.fleet.table import flight_frame
from fleets.fleet_rows import row
from validation.simulated_fleets import FleetSpec, fleet_rows

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
