"""The table of the mutation check: its lines are in the project, and its page shows them."""

from __future__ import annotations

from pathlib import Path

from validation.mutation.check import TABLE, check_lines, read_mutants


def test_every_line_of_the_table_is_in_the_project_once():
    assert not check_lines(read_mutants(TABLE), Path(__file__).parents[2])


def test_the_page_shows_the_table_as_it_is():
    """Every mutant stands on the page with its line, and with what it becomes."""
    root = Path(__file__).resolve().parents[2]
    page = (root / "docs" / "studies" / "coverage.md").read_text(encoding="utf-8")
    page = page.partition("## The mutation check")[2]
    for mutant in read_mutants():
        row = next(line for line in page.splitlines() if mutant.what in line)
        for text in (mutant.line, mutant.replacement):
            assert f"`{text}`".replace("|", "\\|") in row, mutant.name
