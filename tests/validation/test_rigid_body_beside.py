"""The tables of docs/rigid-body.md that flights make: what they show of rows, and that the page has them."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from eivor.lab.experiments import page_text
from validation.rigid_body import beside
from validation.studies import Row, StudyTable

pytest.importorskip("rotorpy")

PAGE = Path(__file__).parents[2] / "docs/rigid-body.md"


def rows(kind: str, errors: dict[int, float], method: str, half_width: float = 0.02) -> list[Row]:
    """Every quantity of flights, each off by its flight's error, relative to a truth of 2."""
    return [
        {
            "kind": kind,
            "case": 1,
            "number": number,
            "method": method,
            "quantity": name,
            "truth": 2.0,
            "value": 2.0 * (1.0 + error),
            "low": 2.0 * (1.0 + error - half_width),
            "high": 2.0 * (1.0 + error + half_width),
            "verdict": "weak",
            "agreement": 1e-5,
        }
        for number, error in errors.items()
        for name in (beside.LAG, *beside.PLOTTED)
    ]


def test_tables_say_what_the_rows_are_off_by_and_how_many_intervals_held():
    made = [
        *rows(beside.LAGS, {0: -0.01}, beside.INSTRUMENTS),
        *rows(beside.LAGS, {0: 0.03}, beside.LEAST_SQUARES),
        *rows(beside.SPEEDS, {0: 0.01, 1: 0.03}, beside.TOTAL),
    ]
    tables = beside.tables(StudyTable(pl.DataFrame(made), {}))
    assert tables[beside.LAGS].splitlines()[2:] == [
        "| 60, 72 ms | `reference_iv` | -1.0 % | -1.0 %, -1.0 %, -1.0 % | -1.0 % | -1.0 % "
        "| weak, p = 1e-05 |",
        "| 60, 72 ms | `whitened_least_squares` | (+3.0 %) | (+3.0 %), (+3.0 %), (+3.0 %) | (+3.0 %) "
        "| (+3.0 %) | weak |",
    ]
    assert beside.STAMPS not in tables  # a page keeps the table of what was not flown
    (line,) = tables[beside.SPEEDS].splitlines()[2:]
    assert line.startswith("| 3 % | `total_least_squares` | 2 of 2 | +2.0, 2.2 % [0.50] |")


def test_the_table_of_stamps_that_err_has_the_worst_of_each_group():
    made = rows(beside.STAMPS, {0: 0.01, 1: 0.03}, beside.LEAST_SQUARES)
    (line,) = beside.tables(StudyTable(pl.DataFrame(made), {}))[beside.STAMPS].splitlines()[2:]
    assert line == "| 2 | " + " | ".join(4 * ["+2 %, 2.2 % [0.50]"]) + " |"


def test_the_page_has_all_tables_and_every_lag_of_them():
    for kind in (beside.LAGS, beside.SPEEDS, *beside.OF_GRID):
        text = page_text(PAGE, kind)
    for up, down in beside.LAGS_S:
        assert text.count(f"| {1e3 * up:.0f}, {1e3 * down:.0f} ms |") == 2


def test_a_refused_flight_counts_as_flown_and_not_as_told():
    refused = [{**row, "verdict": "refused"} for row in rows(beside.SPEEDS, {2: 1e6}, beside.TOTAL)]
    made = [*rows(beside.SPEEDS, {0: 0.01, 1: 0.03}, beside.TOTAL), *refused]
    (line,) = beside.tables(StudyTable(pl.DataFrame(made), {}))[beside.SPEEDS].splitlines()[2:]
    assert line.startswith("| 3 % | `total_least_squares` | 2 of 3 | +2.0, 2.2 % [0.50] |")
    (line,) = beside.tables(StudyTable(pl.DataFrame(refused), {}))[beside.SPEEDS].splitlines()[2:]
    assert line == "| 3 % | `total_least_squares` | 0 of 1 | - | - | - | - | - |"
