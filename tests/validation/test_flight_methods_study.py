"""The study of methods on flights: its command, what it asks, and what it says of the default."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from eivor.estimation.methods import TABLE
from eivor.lab.experiments import marks
from validation.flight_methods.study import (
    GRID,
    OMITTED,
    PART,
    SEARCHED,
    Grid,
    Told,
    _judged,
    _line,
    _requirements,
    main,
)
from validation.studies import read_as

PAGE = Path(__file__).resolve().parents[2] / "docs" / "efficiency.md"
REGIME = """
[[regimes]]
name = "calm"
gust_rms = 0.1
duration = 20.0
every = 1
left_out = true
small = 1
full = 2
"""


def told(
    method: str, *, lag: str = SEARCHED, verdict: str = "identified", error: float = 0.1, held: bool = True
) -> Told:
    return Told("calm", 0, method, lag, verdict, [error, -error], [held, held])


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_the_command_makes_the_page_of_a_kept_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid, page, kept = tmp_path / "grid.toml", tmp_path / "page.md", tmp_path / "kept.jsonl"
    vehicle = "vehicle = { viscous_friction = 0.4, hover_input = 0.5, actuator_lag = 0.05 }\n"
    grid.write_text(f'{vehicle}methods = ["least_squares"]\n{REGIME}')
    begin, end = marks(PART)
    page.write_text(f"{begin}\n{end}\n")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    main(arguments)
    tables = capsys.readouterr().out
    assert "| left out | least_squares | 1 |" in tables
    assert "| searched for | least_squares | 1 |" in tables
    assert "| calm | least_squares | 1 |" in tables
    assert tables.strip() in page.read_text()
    before = kept.read_text()
    main(arguments)
    assert kept.read_text() == before
    assert len(before.splitlines()) == 2


def test_what_is_asked() -> None:
    good = [told("reference_iv"), told("spectral_giv"), told("reference_iv", lag=OMITTED, verdict="weak")]
    assert all(_requirement.met for _requirement in _requirements(good))
    trusted = told("reference_iv", lag=OMITTED, held=False)
    missed = told("spectral_giv", held=False)
    assert [_requirement.met for _requirement in _requirements([*good, trusted, missed])] == [
        False,
        True,
        False,
    ]


def test_a_line_leaves_out_what_has_no_estimate() -> None:
    none = told("reference_iv", verdict="refused", error=math.nan, held=False)
    line = _line([told("reference_iv", error=0.1), told("reference_iv", error=0.3, held=False), none])
    assert line == ("3", "+20.0 % / -20.0 %", "22.4 % / 22.4 %", "0.50 / 0.50", "0.67", "1")
    assert _line([none])[1:4] == ("-", "-", "-")


def test_the_default_changes_only_for_a_method_that_is_better_in_both() -> None:
    usual = [told("reference_iv"), told("reference_iv", held=False, verdict="weak")]
    better = [told("spectral_giv"), told("spectral_giv")]
    assert "it is better in both" in _judged([*usual, *better], "spectral_giv")
    no_surer = [told("spectral_giv"), told("spectral_giv", held=False)]
    assert "it is not better in both" in _judged([*usual, *no_surer], "spectral_giv")


def test_the_published_grid_and_its_page_belong_together() -> None:
    grid = read_as(Grid, GRID)
    text = PAGE.read_text(encoding="utf-8").partition(marks(PART)[0])[2].partition(marks(PART)[1])[0]
    assert set(grid.methods) <= set(TABLE)
    for regime in grid.regimes:
        assert f"{regime.full} of {regime.name}" in text
        for method in grid.methods:
            assert f"| {regime.name} | {method} | {regime.full} |" in text
