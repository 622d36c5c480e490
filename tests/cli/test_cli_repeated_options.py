"""`eivor.toml` and `eivor --config`: options where the command line does not say otherwise."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "from-a-log.md").read_text(encoding="utf-8")


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(text, name="eivor.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")

    return write


def test_it_is_read_where_it_is_and_said(eivor, written):
    written('[identify]\nlag = "65:15"\nterm = ["quadratic-drag", "voltage"]\nalign = true\nmax-tilt = 20\n')
    ran = eivor("identify", "missing.ulg")
    assert ran.code == 1
    splitline, missing = ran.err.splitlines()[0], ran.err
    assert (
        splitline
        == "eivor: options of eivor.toml: max-tilt 20, lag 65:15, align, term quadratic-drag voltage"
    )
    assert "missing.ulg" in missing
    assert ran.out == ""


def test_a_value_reaches_the_command(eivor, written):
    written("[identify]\nmax-tilt = 200\n")
    assert "tilt" in eivor("identify", "--example").err.splitlines()[1]


def test_the_command_line_comes_first(eivor, written):
    written('[identify]\nlag = "65:15"\n')
    assert "options of" not in eivor("identify", "missing.ulg", "--lag", "60:10").err
    assert "options of" not in eivor("inspect", "missing.ulg").err


def test_a_file_that_is_named(eivor, written):
    written('[identify]\nlag = "65:15"\n')
    written("[fleet.run]\nworkers = 2\n", "lab.toml")
    assert "options of" not in eivor("--config", "lab.toml", "identify", "missing.ulg").err
    assert (
        "options of lab.toml: workers 2"
        in eivor("--config", "lab.toml", "fleet", "run", "missing", "-o", "out").err
    )


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[identfy]", r"tables named as commands.*\[identfy\]\. Did you mean 'identify'"),
        ("lag = 3", "tables named as commands.*Remove it"),
        ("identify = 3", r"Expected a table \[identify\]"),
        ("[identify]\nlagg = 3", "options of eivor identify.*'lagg'. Did you mean 'lag'"),
        ("[fleet.run]\nworker = 3", "options of eivor fleet run.*Did you mean 'workers'"),
        ("[identify]\nalign = 3", "true or false at identify.align of eivor.toml; received 3"),
        ("[identify]\nlag = true", "a text or a number, at identify.lag of eivor.toml; received True"),
        ("[identify]\nterm = [{}]", "a text or a number, or a list of them"),
        ("[identify", "not: "),
    ],
)
def test_what_is_wrong_is_said(eivor, written, text, wrong):
    written(text)
    ran = eivor("identify", "missing.ulg")
    assert ran.code == 1
    assert re.search(wrong, ran.err)
    assert "missing.ulg" not in ran.err


def test_a_file_that_is_missing(eivor, written):
    ran = eivor("--config", "lab.toml", "identify", "missing.ulg")
    assert ran.code == 1
    assert "'lab.toml', unreadable" in ran.err


def test_tables_of_commands_that_are_not_loaded(written):
    from typer.testing import CliRunner

    from eivor.cli.main import application

    written('[fleet.run]\nworkers = 2\n[identify]\nlag = "65:15"\n')
    ran = CliRunner().invoke(application("plan", "identify"), ["identify", "missing.ulg"])
    assert "lag 65:15" in ran.output


def test_the_file_of_the_page_is_valid(eivor, written):
    (block,) = re.findall(r"```text\n(\[identify\]\n.*?)```", PAGE, flags=re.DOTALL)
    written(block)
    splitline = eivor("identify", "missing.ulg").err.splitlines()[0]
    assert splitline.startswith("eivor: options of eivor.toml: ")
    assert all(
        option in splitline for option in ("lag 65:15", "map mycopter.toml", "align", "term quadratic-drag")
    )
