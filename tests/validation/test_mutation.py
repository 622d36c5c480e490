"""The mutation check on a small project: what it notices, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation.mutation.check import TABLE, check_lines, main, read_mutants

SOURCE = """def twice(x):
    doubled = 2 * x
    return doubled


def half(x):
    return x / 2
"""
TESTS = """import toy


def test_twice():
    assert toy.twice(3) == 6


class TestHalf:
    def test_half(self):
        assert toy.half(6) == 3

    def test_of_nothing(self):
        assert toy.half(0) == 0
"""
TWICE = {
    "name": "twice",
    "area": "signs",
    "what": "Doubles.",
    "file": "src/toy.py",
    "line": "doubled = 2 * x",
    "replacement": "doubled = 3 * x",
    "tests": ["tests/test_toy.py::test_twice"],
}
HALF = TWICE | {
    "name": "half",
    "area": "solvers",
    "line": "return x / 2",
    "replacement": "return x / 4",
    "tests": ["tests/test_toy.py::TestHalf"],
}


@pytest.fixture
def project(tmp_path, monkeypatch):
    # Other plugins than the one that its option is of take a second to load.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    for name, text in (
        ("src/toy.py", SOURCE),
        ("tests/test_toy.py", TESTS),
        ("pyproject.toml", '[tool.pytest.ini_options]\naddopts = "-p xdist"\n'),
        ("page.md", "# Mutants\n\n<!-- generated: mutants -->\n\nold\n\n<!-- end: mutants -->\n\nBy hand.\n"),
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def table(project, *entries):
    path = project / "mutants.toml"
    lines = []
    for entry in entries:
        lines.append("[[mutant]]")
        lines += [f"{key} = {value!r}" for key, value in entry.items()]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.thorough
def test_what_is_noticed_is_told_and_shown(project, capsys):
    chosen = table(project, TWICE, HALF)
    page = project / "page.md"
    assert main(["--page", str(page)], project=project, table=chosen) == 0
    out = capsys.readouterr().out
    assert "twice: noticed by 1" in out
    assert "half: noticed by 1" in out
    assert "2 of 2 noticed" in out
    assert (project / "src" / "toy.py").read_text() == SOURCE
    text = page.read_text()
    assert "old" not in text
    assert text.endswith("By hand.\n")
    assert "2 of 2 swapped lines were noticed." in text
    row = (
        "| Doubles.<br>`src/toy.py` | `doubled = 2 * x` | `doubled = 3 * x` | 1 of `test_toy.py::test_twice`"
    )
    assert f"{row} |" in text.splitlines()
    assert text.index("## Signs") < text.index("## Solvers")


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
