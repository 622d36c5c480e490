"""Commands of studies at their smallest size: tables, pages, and what is kept."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import pytest

from validation.studies import NOT_MET, WRONG

thorough = pytest.mark.thorough
CELL = '[[cells]]\nwhat = "{}"\nshare = {}\nflights = 14\nvehicles = 2\nsmall = 1\nfull = 2\n'
RECORDS = '[[records]]\nscenario = "rich"\nchanged = "{}"\nsmall = 1\nfull = 1\n'
FLIGHTS = """
vehicle = { viscous_friction = 0.4, hover_input = 0.5, actuator_lag = 0.05 }
methods = ["least_squares"]
[[regimes]]
name = "calm"
gust_rms = 0.1
duration = 20.0
every = 1
left_out = true
small = 1
full = 2
"""
#: Module, part of its page, grid, rows of its tables.
KEPT = {
    "pooling": (
        "pooling.study",
        "pooling",
        "flights = [4]\nheterogeneity = [0.0, 0.05]\nstd_errors = [0.01, 0.05]\nsmall = 40\nfull = 50\n",
        ["| 4 | 0.05 |"],
    ),
    "recursion": (
        "recursion.study",
        "recursion",
        RECORDS.format("nothing") + RECORDS.format("input_gain"),
        ["| rich | K_u | 1 |"],
    ),
    "fleet changes": (
        "fleet_changes.study",
        "fleet-changes",
        "weather = 0.01\nbattery = 0.01\n"
        + "".join(CELL.format(*item) for item in (("nothing", 0.0), ("wear", 0.1), ("step", 0.08))),
        ["| wear | 14 | 2 | 1 |"],
    ),
    "flight methods": (
        "flight_methods.study",
        "flight-methods",
        FLIGHTS,
        ["| left out | least_squares | 1 |", "| searched for | least_squares | 1 |"],
    ),
}
METHOD = '[[methods]]\nname = "{}"\nlags = [0, 10]\n'
SUITE = 'name = "small"\nruns = 2\nseed = 1\nsamples = [500]\nscenarios = ["white"]\n' + "".join(
    METHOD.format(name) for name in ("generalized_iv", "spectral_giv", "spectral_giv_combined")
)
CLAIMS = Path(__file__).parents[2] / "validation" / "paper" / "claims.toml"
UNKNOWN = """
name = "small"
runs = 2
seed = 1
[cases.short]
scenario = "rich-high"
samples = 400
order = 0.0
methods = ["generalized_iv_unknown_noise", "frisch_scheme"]
"""


def command(module):
    result: Callable[[list[str]], int] = importlib.import_module(f"validation.{module}").main
    return result


def page_of(folder, part):
    page = folder / "page.md"
    page.write_text(f"Before.\n<!-- generated: {part} -->\n<!-- end: {part} -->\nAfter.\n", encoding="utf-8")
    return page


@pytest.mark.parametrize(
    "study",
    [
        pytest.param(name, marks=[] if name in ("pooling", "recursion") else thorough, id=name)
        for name in KEPT
    ],
)
@pytest.mark.usefixtures("unchecked_shapes")
def test_a_study_that_keeps_its_trials(study, tmp_path, capsys):
    module, part, text, rows = KEPT[study]
    grid, kept, page = tmp_path / "grid.toml", tmp_path / "kept.jsonl", page_of(tmp_path, part)
    grid.write_text(text, encoding="utf-8")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    code = command(module)(arguments)
    printed, lines = capsys.readouterr().out, kept.read_text(encoding="utf-8")
    assert code in (0, NOT_MET)
    assert all(row in printed for row in rows)
    assert page.read_text(encoding="utf-8").count(printed.strip()) == 1
    assert command(module)(arguments) == code
    assert kept.read_text(encoding="utf-8") == lines
    with pytest.raises(SystemExit):
        command(module)(["--size", "huge"])


@pytest.mark.parametrize(
    ("module", "part", "text", "rows"),
    [
        pytest.param("efficiency.study", "efficiency", SUITE, ["| white |", "RMSE over the"], marks=thorough),
        pytest.param(
            "paper.claims",
            "claims",
            CLAIMS.read_text(encoding="utf-8")
            .replace("[60, 150, 500, 4000]", "[150]")
            .replace('["v", "p", "rich", "white"]', '["white"]'),
            ["white noise"],
            marks=thorough,
        ),
        ("unknown_noise.study", "unknown-noise", UNKNOWN, ["| short | frisch_scheme | noise_variance_velo"]),
    ],
    ids=["efficiency", "claims", "unknown noise"],
)
def test_a_study_of_a_suite(module, part, text, rows, tmp_path, capsys):
    suite, page = tmp_path / "suite.toml", page_of(tmp_path, part)
    suite.write_text(text, encoding="utf-8")
    assert command(module)([str(suite), "--runs", "3", "--page", str(page)]) in (0, NOT_MET)
    written = page.read_text(encoding="utf-8")
    assert all(row in written for row in rows)
    assert capsys.readouterr().out.strip() in written
    assert command(module)([str(suite), "--page", str(suite)]) == WRONG


@pytest.mark.parametrize(
    ("module", "arguments", "message"),
    [
        ("efficiency.study", ["--from", "none.parquet"], "a table of efficiency"),
        ("coverage.study", ["--from", "none.parquet"], "a table of coverage"),
        ("flight_recipe.study", ["--from", "none.parquet"], "a table of trials"),
        ("real_logs.study", ["--from", "none.parquet"], "a table of the study"),
        ("real_logs.study", ["--folder", "none", "--tables"], "a folder with finished tasks"),
        ("rigid_body.study", ["--folder", "none", "--tables"], "a folder with finished tasks"),
    ],
)
def test_a_wrong_call_is_a_sentence(module, arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command(module)(arguments) == WRONG
    assert message in capsys.readouterr().err
