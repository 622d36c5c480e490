"""The small size of the flight study, judged with binomial bounds, and the command that runs it.

The bounds are crossed by chance once in a thousand runs of a recipe that is exactly as good as it must be;
this one is the same in every run.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import polars as pl
import pytest
from scipy.stats import binom

from eivor.lab.experiments import marks
from validation.flight_recipe import study as flight_study
from validation.flight_recipe import trials as flight_trials
from validation.flight_recipe.study import (
    ERROR_BOUNDS,
    PART,
    accepted,
    accepted_share,
    flown,
    requirements,
    score,
)
from validation.flight_recipe.trials import (
    LAG_IGNORED,
    NONLINEAR,
    QUANTITIES,
    TrialTable,
    published_grid,
    read_trial_table,
)

pytest.importorskip("rotorpy")
pytestmark = pytest.mark.calibration

CHANCE = 1e-3

BEGIN, END = marks(PART)


PAGE = f"# Study\n\nBefore.\n\n{BEGIN}\n{END}\n\nAfter.\n"


@dataclass(frozen=True)
class Run:
    """What the command left behind."""

    code: int
    printed: str
    page: str
    path: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The command, in a process of its own: checks of every shape would make it three times as long."""
    folder = tmp_path_factory.mktemp("study")
    trials, page = folder / "trials.parquet", folder / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "validation.flight_recipe.study", "--size", "small"),
            *("--out", str(trials), "--page", str(page)),
        ],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUTF8": "1"},
    )
    assert trials.exists(), done.stderr
    return Run(done.returncode, done.stdout, page.read_text(encoding="utf-8"), trials)


@pytest.fixture(scope="module")
def table(run) -> TrialTable:
    return read_trial_table(run.path)


@pytest.fixture(scope="module")
def calm(table) -> pl.DataFrame:
    return table.rows.filter(pl.col("calm"))


def least(count: int, share: float) -> int:
    """So many of `count` trials succeed at least, unless a rare chance has it otherwise."""
    return int(binom.ppf(CHANCE, count, share))


def most(count: int, share: float) -> int:
    return int(binom.isf(CHANCE, count, share))


def test_every_flight_of_the_small_grid_was_flown(table):
    assert table.rows.height == 36
    assert flown(table.rows).height == 36
    assert set(table.rows["simulator"]) == {"vertical", "rotorpy"}


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_intervals_of_accepted_flights_hold_the_truth(table, quantity):
    coverage = score(accepted(table.rows), quantity).coverage
    assert coverage.count >= 20
    assert coverage.hits >= least(coverage.count, 0.92)


@pytest.mark.parametrize("quantity", list(ERROR_BOUNDS))
def test_errors_of_calm_accepted_flights_are_small(calm, quantity):
    result = score(accepted(calm), quantity)
    assert result.median <= ERROR_BOUNDS[quantity][0]
    # Of flights whose 90th percentile is at the bound, so many may lie beyond it.
    beyond = accepted(calm).filter(
        (pl.col(f"recipe.{quantity}.value") - pl.col(f"truth.{quantity}")).abs()
        > ERROR_BOUNDS[quantity][1] * (1.0 if quantity == "effective_lag" else pl.col(f"truth.{quantity}"))
    )
    assert beyond.height <= most(accepted(calm).height, 0.1)


def test_calm_excited_flights_are_accepted_and_hovers_are_not(table, calm):
    share = accepted_share(calm)
    assert share.hits >= least(share.count, 0.75)
    hovers = accepted_share(table.rows.filter(pl.col("kind") == "hover"))
    assert hovers.count >= 3
    assert hovers.hits == 0
    far = score(accepted(table.rows), "viscous_friction").beyond_half
    assert far.hits <= most(far.count, 0.04)


def test_controls_fail(table, calm):
    ignored = score(calm, "viscous_friction", LAG_IGNORED)
    assert ignored.bias < -0.2
    assert ignored.coverage.hits < least(ignored.coverage.count, 0.8)
    gusty = table.rows.filter((pl.col("kind") == "excited") & ~pl.col("calm"))
    direct = score(gusty, "viscous_friction", NONLINEAR)
    assert direct.coverage.hits <= most(direct.coverage.count, 0.8)
    assert direct.bias < -0.05
    assert direct.bias < score(gusty, "viscous_friction").bias


def test_no_requirement_is_missed_beyond_chance(table):
    missed = [item for item in requirements(table.rows, allow_chance=True) if not item.met]
    assert not missed


def test_command_prints_its_tables_and_puts_them_into_the_page(run):
    assert run.code == 0, run.printed
    assert "| constant-reference hovers accepted | none | 0 of 3 | yes |" in run.printed
    assert f"Before.\n\n{BEGIN}\n\n{run.printed.strip()}\n\n{END}\n\nAfter." in run.page


def test_missed_requirement_is_the_exit_code(table, tmp_path, capsys, monkeypatch):
    spoilt = TrialTable(table.rows.with_columns(pl.lit("identified").alias("verdict")), table.origin)
    monkeypatch.setattr(flight_study, "run_grid", lambda *chosen: {("small", None): spoilt}[chosen])
    assert flight_study.main(["--size", "small", "--out", str(tmp_path / "spoilt.parquet")]) == 3
    assert "| constant-reference hovers accepted | none | 3 of 3 | **no** |" in capsys.readouterr().out


@pytest.mark.long
def test_the_table_does_not_depend_on_the_number_of_workers(tmp_path, monkeypatch):
    """A few flights of both simulators, cut short, by one process and by two: the same bytes."""
    whole = published_grid()
    current = [case for case in whole.cases if case.simulator == "vertical"][::200]
    other = [case for case in whole.cases if case.simulator == "rotorpy"][:1]
    short = [
        *(replace(case, spec=replace(case.spec, duration=2.0)) for case in other),
        *(replace(case, spec=replace(case.spec, duration=12.0)) for case in current),
    ]
    monkeypatch.setattr(flight_study, "published_grid", lambda: replace(whole, cases=tuple(short)))
    monkeypatch.setattr(flight_trials, "FLIGHTS_TOGETHER", 2)
    written = []
    for workers in (1, 2):
        flight_study.run_grid("full", workers).write(tmp_path / "trials.parquet")
        written.append((tmp_path / "trials.parquet").read_bytes())
    assert written[0] == written[1]
    rows = read_trial_table(tmp_path / "trials.parquet").rows
    assert rows["flight"].to_list() == [case.name for case in (*current, *other)]
    assert rows["recipe.viscous_friction.value"].is_finite().sum() >= len(current)
