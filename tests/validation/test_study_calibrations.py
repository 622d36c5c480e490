"""Studies at reduced sizes, and what they require: intervals, delays, plans, pools and fleets."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.stats import binom

import eivor as ev
from validation.coverage.study import BOUNDS, PART, read_coverage
from validation.efficiency.known_spectra import rows_of as known_rows_of
from validation.efficiency.known_spectra import trial as known_trial
from validation.plan.study import OWN, PLANNED_FOR, outcomes
from validation.pooling.study import cell as pooling_cell
from validation.suite_files import coverage_suite, read_suite

COVERAGE_RUNS = 20
COVERAGE_CHANCE = 1e-4


@dataclass(frozen=True)
class Run:
    code: int
    printed: str
    page: str
    path: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The command, in a process of its own: checks of every shape would make it many times as long."""
    folder = tmp_path_factory.mktemp("coverage")
    out, page = folder / "coverage.parquet", folder / "page.md"
    page.write_text(f"<!-- generated: {PART} -->\n<!-- end: {PART} -->\n", encoding="utf-8")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "validation.coverage.study", "--runs", str(COVERAGE_RUNS)),
            *("--out", str(out), "--page", str(page)),
        ],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUTF8": "1"},
    )
    assert not done.stderr, done.stderr
    return Run(done.returncode, done.stdout, page.read_text(encoding="utf-8"), out)


@pytest.mark.calibration
def test_default_intervals_cover_in_every_scenario(run):
    rows = read_coverage(run.path).filter(pl.col("method") == "default")
    suite = coverage_suite()
    assert rows.height == 2 * len(suite.studies) == 44
    assert set(rows["count"]) == {COVERAGE_RUNS}
    for row in rows.iter_rows(named=True):
        least, _ = BOUNDS[row["samples"]]
        assert row["hits"] >= binom.ppf(COVERAGE_CHANCE / 44, COVERAGE_RUNS, least), row
    # All together they neither miss too often nor are they always right.
    for samples in BOUNDS:
        here = rows.filter(pl.col("samples") == samples)
        hits, count = here["hits"].sum(), here["count"].sum()
        assert (
            binom.ppf(COVERAGE_CHANCE, count, 0.94) <= hits <= binom.ppf(1.0 - COVERAGE_CHANCE, count, 0.98)
        )
    assert run.code == 0


@pytest.mark.calibration
def test_rivals_fall_short(run):
    """Intervals that take the scores for white, or look a few lags back, miss far more often."""
    rows = read_coverage(run.path)
    shares = {}
    for method in ("default", "classical", "newey_west"):
        here = rows.filter(pl.col("method") == method, pl.col("samples") == 500)
        shares[method] = here["hits"].sum() / here["count"].sum()
    spread = (0.05 / (22 * COVERAGE_RUNS)) ** 0.5
    assert shares["classical"] < shares["newey_west"] < shares["default"] - 2.0 * spread
    paper = rows.filter(pl.col("scenario").is_in(["v", "p"]), pl.col("method") == "classical")
    assert paper["hits"].sum() < binom.ppf(COVERAGE_CHANCE, paper["count"].sum(), 0.75)


HELD = Path(__file__).parents[2] / "validation" / "efficiency" / "held.toml"


def test_a_likelihood_that_knows_the_spectra_is_on_the_same_records(tmp_path):
    item = next(
        study for study in read_suite(HELD).studies if (study.scenario, study.samples) == ("rich-high", 500)
    )
    results = [known_trial(item, run) for run in range(3)]
    plain = [
        ev.identify(
            item.study.experiment.problem(item.study.experiment.record(item.study.rng(run)), ()),
            ev.methods.spectral_giv(),
        )
        for run in range(3)
    ]
    rows = list(known_rows_of(item, results))
    assert [row["parameter"] for row in rows] == ["viscous_friction", "input_gain"]
    for each, other in zip(results, plain, strict=True):
        separated = np.abs(np.array(each.values) - other.values[:2])
        assert (separated < 2.0 * np.array([other.std_error(name) for name in other.names[:2]])).all()
    assert all(float(row["rmse"]) < 2.5 * float(row["bound"]) for row in rows)


@pytest.mark.parametrize(("flights", "heterogeneity"), [(4, 0.05), (10, 0.02)])
def test_intervals_hold_and_those_of_others_do_not(flights, heterogeneity):
    reported = pooling_cell(flights, heterogeneity, 1000, (0.01, 0.05))
    assert reported.mean >= 0.93
    assert reported.following >= 0.90
    assert reported.fixed < reported.moments < reported.mean
    assert reported.spread == pytest.approx(0.95, abs=0.03)
    assert pooling_cell(flights, heterogeneity, 1000, (0.01, 0.05)) == reported


@pytest.mark.long  # 21 s; the study flies nine times as many, and `docs/studies/coverage.md` has its figures
def test_planned_flights_reach_what_was_predicted():
    """Bounds of the study, with room for four flights."""
    keys = [(OWN[1].name, target, number) for target in PLANNED_FOR for number in (0, 1)]
    result = [outcome for made in outcomes(OWN[1], 1, keys) for outcome in made]
    ratios = {
        target: [item.ratio for item in result if item.target == target] for target in ("friction", "lag")
    }
    assert 0.6 < np.median(ratios["friction"]) < 1.6
    assert 0.5 < np.median(ratios["lag"]) < 2.0
    assert all(item.kept for item in result)
