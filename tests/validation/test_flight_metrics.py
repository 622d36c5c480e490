"""Scores, requirements, tables and pages of the flight study, on trials made up for the purpose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from eivor.errors import InputError
from eivor.lab.experiments import marks, page_with
from eivor.lab.study import Share
from eivor.simulation.vertical import VerticalFlightSpec
from validation.flight_recipe import study as flight_study
from validation.flight_recipe.study import (
    LEVEL,
    PART,
    accepted_share,
    flown,
    requirements,
    score,
    study_tables,
)
from validation.flight_recipe.trials import (
    ESTIMATORS,
    LOST,
    RECIPE,
    FlightCase,
    FlightTrial,
    Number,
    read_trial_table,
    trial_table,
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "studies" / "coverage.md"
TRIALS = PAGE.with_name("flight-recipe.parquet")
TRUTH = {"viscous_friction": 0.4, "input_gain": 40.0, "effective_lag": 0.05, "hover_input": 0.5}

BEGIN, END = marks(PART)


def trial(
    number: int,
    *,
    kind: str = "excited",
    calm: bool = True,
    verdict: str = "identified",
    error: float = 0.01,
    half_width: float = 0.02,
    control_error: float = -0.5,
) -> FlightTrial:
    """A flight whose estimates are off by a share of the truth, each interval a share of it wide."""
    spec = VerticalFlightSpec(seed=number, gust_rms=0.1 if calm else 1.0)
    case = FlightCase(f"{kind} {number}", kind, "vertical", kind, calm and kind == "excited", False, spec)

    def around(name: str, off: float) -> Number:
        value, width = TRUTH[name] * (1.0 + off), TRUTH[name] * half_width
        return value, value - width, value + width

    estimates = {
        estimator: {name: around(name, error if estimator == RECIPE else control_error) for name in names}
        for estimator, names in ESTIMATORS.items()
    }
    return FlightTrial(case, verdict, TRUTH, estimates, first_stage=30.0, p_value=0.5)


def good_run() -> list[FlightTrial]:
    """Trials that meet every requirement: one interval in twenty misses."""
    excited = [trial(k, error=0.03 if k % 20 == 0 else 0.01) for k in range(80)]
    gusty = [trial(100 + k, calm=False, error=0.03 if k % 20 == 0 else 0.01) for k in range(40)]
    hovers = [trial(200 + k, kind="hover", verdict="refused") for k in range(10)]
    return [*excited, *gusty, *hovers]


def rows_of(trials: list[FlightTrial]) -> pl.DataFrame:
    return trial_table(trials, grid="made up", size="full").rows


def missed(trials: list[FlightTrial]) -> list[str]:
    return [item.what for item in requirements(rows_of(trials)) if not item.met]


def test_score_is_what_it_says():
    rows = rows_of([trial(k, error=error) for k, error in enumerate([-0.6, -0.01, 0.0, 0.015, 0.03])])
    result = score(rows, "viscous_friction")
    assert result.median == pytest.approx(0.015, abs=2e-5)
    assert result.ninetieth == pytest.approx(np.quantile([0.0, 0.01, 0.015, 0.03, 0.6], 0.9), abs=2e-5)
    assert result.bias == pytest.approx(-0.565 / 5, abs=2e-5)
    assert (result.coverage.hits, result.coverage.count) == (3, 5)
    assert result.beyond_half.hits == 1
    assert score(rows, "effective_lag").median == pytest.approx(0.015 * 0.05, abs=2e-6)


def test_what_is_not_known_is_not_scored():
    rows = rows_of([trial(0), trial(1, verdict=LOST, error=float("nan"))])
    assert score(rows, "input_gain").coverage.count == 1
    assert flown(rows).height == 1
    assert accepted_share(rows) == Share(1, 1, LEVEL)
    assert np.isnan(score(rows.clear(), "input_gain").median)


def test_good_run_meets_everything():
    assert missed(good_run()) == []


@pytest.mark.parametrize(
    ("count", "changes", "what"),
    [
        (100, {"error": 0.1, "half_width": 0.2}, "error of K, calm"),
        (100, {"error": 0.02, "half_width": 0.03}, "error of K_u, calm"),
        (30, {"error": 0.5, "half_width": 0.6}, "error of effective lag"),
        (40, {"error": 0.05}, "coverage of the 95 % interval of K,"),
        (3000, {"half_width": 1.0}, "coverage of the 95 % interval of K_u"),
        (40, {"verdict": "weak"}, "calm excited flights accepted"),
        (1, {"kind": "hover"}, "constant-reference hovers accepted"),
        (9, {"calm": False, "error": 0.6}, "accepted flights whose K is off"),
        (400, {"control_error": 0.0}, "control that must fail: lag ignored"),
        (400, {"calm": False, "control_error": 0.0}, "control that must fail: nonlinear"),
    ],
)
def test_each_requirement_can_be_missed(count, changes, what):
    spoilt = [trial(300 + k, **changes) for k in range(count)]
    assert any(item.startswith(what) for item in missed([*good_run(), *spoilt]))


def test_chance_is_allowed_to_few_flights_only():
    def judged(count: int, *, allow_chance: bool) -> bool:
        rows = rows_of([trial(k, verdict="weak" if k % 2 else "identified") for k in range(count)])
        result = next(
            item
            for item in requirements(rows, allow_chance=allow_chance)
            if item.what == "calm excited flights accepted"
        )
        return result.met

    assert not judged(6, allow_chance=False)
    assert judged(6, allow_chance=True)
    assert not judged(400, allow_chance=True)


def test_table_survives_its_file(tmp_path):
    table = trial_table(good_run(), grid="made up", size="full")
    table.write(tmp_path / "trials.parquet")
    again = read_trial_table(tmp_path / "trials.parquet")
    assert again.origin == table.origin
    assert again.rows.columns == table.rows.columns
    for name in table.rows.columns:
        assert again.rows[name].dtype == table.rows[name].dtype
        assert again.rows[name].to_list() == table.rows[name].to_list()
    value = table.rows["recipe.viscous_friction.value"][1]
    assert value == pytest.approx(0.4 * 1.01, rel=1e-5)


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "other.parquet"
    pl.DataFrame({"a": [1]}).write_parquet(path)
    with pytest.raises(InputError, match="a table of trials"):
        read_trial_table(path)
    path.write_text("no table")
    with pytest.raises(InputError, match="a table of trials"):
        read_trial_table(path)


def test_tables_have_a_row_for_every_class_and_estimator():
    trials = [*good_run(), trial(500, verdict=LOST, error=float("nan"))]
    text = study_tables(trial_table(trials, grid="made up", size="small"))
    assert "flight_recipe.study --size small`" in text
    assert "of which 1 lost their vehicle" in text
    assert text.count("\n| calm | ") == text.count("\n| gusty | ") == 3
    assert "| hover | 10 | 0 | 0 | 0 | 10 | 0 | 0 |" in text
    assert "| hover | 10 | 0 | - |" in text
    assert "| noise | white | 120 |" in text
    assert "nan" not in text


# ------------------------------------------------------------------------------------- what is published


def test_published_tables_are_made_from_the_published_trials():
    table = read_trial_table(TRIALS)
    assert table.origin["size"] == "full"
    page = PAGE.read_text(encoding="utf-8")
    assert page_with(page, {PART: study_tables(table)}) == page


def test_published_trials_are_those_of_the_grid():
    rows = read_trial_table(TRIALS).rows
    grid = flight_study.published_grid()
    assert sorted(rows["flight"]) == sorted(case.name for case in grid.cases)
    seeds = dict(zip(rows["flight"], rows["seed"], strict=True))
    assert all(seeds[case.name] == case.spec.seed for case in grid.cases)
    assert TRIALS.stat().st_size < 150 * 1024
