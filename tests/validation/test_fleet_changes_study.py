"""The study of changes in fleets at a reduced size, and its table."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from validation.fleet_changes.study import Cell, Grid, main, told

CELL = Cell("nothing", 0.0, 40, 20, 1, 1)


def told_of(**what):
    return told(Grid(0.05, 0.03, []), replace(CELL, **what), 1)


@pytest.mark.thorough
def test_steps_are_dated_and_nothing_is_not_told():
    assert told_of().changes <= 0.1
    step = told_of(what="step", share=0.08)
    assert step.dated >= 0.8
    assert step.held >= 0.8
    assert told_of(outliers=2).deviating >= 0.9
    assert told_of(payload=0.3).changes <= 0.1
    wear = told_of(what="wear", share=0.10)
    assert wear.sign == 1.0
    assert wear.covered >= 0.8


@pytest.mark.thorough
def test_the_command_makes_the_page_of_a_kept_study(tmp_path, capsys):
    grid, page, kept = (tmp_path / name for name in ("grid.toml", "page.md", "kept.jsonl"))
    cell = '[[cells]]\nwhat = "{}"\nshare = {}\nflights = 14\nvehicles = 2\nsmall = 1\nfull = 2\n'
    cells = [cell.format(*item) for item in (("nothing", 0.0), ("wear", 0.1), ("step", 0.08))]
    grid.write_text("weather = 0.01\nbattery = 0.01\n" + "".join(cells))
    page.write_text("<!-- generated: fleet-changes -->\n<!-- end: fleet-changes -->\n")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    main(arguments)
    table = capsys.readouterr().out
    assert "| wear | 14 | 2 | 1 |" in table
    assert table.strip() in page.read_text()
    lines = kept.read_text()
    main(arguments)
    assert kept.read_text() == lines
