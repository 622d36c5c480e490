"""The coverage study at a reduced size, judged by binomial bounds; its files, tables and command."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pytest
from scipy.stats import binom

from eivor.errors import InputError
from eivor.lab.experiments import marks, page_with
from validation.coverage import study as coverage_study
from validation.coverage.study import BOUNDS, PART, coverage_tables, read_coverage, requirements
from validation.studies import WRONG
from validation.suite_files import coverage_suite, read_suite

RUNS = 20
CHANCE = 1e-4
DOCS = Path(__file__).parents[2] / "docs" / "studies"
SUITE = """
runs = {runs}
seed = 1
samples = [500]
scenarios = ["rich-high", "mine.toml"]
[[methods]]
label = "default"
name = "generalized_iv"
lags = [0, 5]
[[methods]]
label = "classical"
name = "generalized_iv"
lags = [0, 5]
covariance = "classical"
"""
MINE = """
viscous_friction = 0.293
input_gain = 0.021
[excitation]
kind = "white"
std = 1.0
[noise.input]
kind = "white"
ratio_to_signal = 0.1
"""


@dataclass(frozen=True)
class Run:
    code: int
    printed: str
    page: str
    path: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The command, in a process of its own: checks of every shape would make it many times as long."""
    folder = tmp_path_factory.mktemp("coverage")
    out, page = folder / "coverage.parquet", folder / "page.md"
    page.write_text("Before.\n" + "\n".join(marks(PART)) + "\nAfter.\n", encoding="utf-8")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "validation.coverage.study", "--runs", str(RUNS)),
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
    assert set(rows["count"]) == {RUNS}
    for row in rows.iter_rows(named=True):
        least, _ = BOUNDS[row["samples"]]
        assert row["hits"] >= binom.ppf(CHANCE / 44, RUNS, least), row
    # All together they neither miss too often nor are they always right.
    for samples in BOUNDS:
        here = rows.filter(pl.col("samples") == samples)
        hits, count = here["hits"].sum(), here["count"].sum()
        assert binom.ppf(CHANCE, count, 0.94) <= hits <= binom.ppf(1.0 - CHANCE, count, 0.98)
    assert run.code == 0


@pytest.mark.calibration
def test_rivals_fall_short(run):
    """Intervals that take the scores for white, or look a few lags back, miss far more often."""
    rows = read_coverage(run.path)
    shares = {}
    for method in ("default", "classical", "newey_west"):
        here = rows.filter(pl.col("method") == method, pl.col("samples") == 500)
        shares[method] = here["hits"].sum() / here["count"].sum()
    spread = (0.05 / (22 * RUNS)) ** 0.5
    assert shares["classical"] < shares["newey_west"] < shares["default"] - 2.0 * spread
    paper = rows.filter(pl.col("scenario").is_in(["v", "p"]), pl.col("method") == "classical")
    assert paper["hits"].sum() < binom.ppf(CHANCE, paper["count"].sum(), 0.75)


@pytest.mark.calibration
def test_page_and_printed_tables_agree(run):
    begin, end = marks(PART)
    assert f"Before.\n{begin}\n\n{run.printed.strip()}\n\n{end}\nAfter." in run.page
    for part in ("## N = 4000", "## N = 500", "closed-loop", "K_u: coverage", "mean length"):
        assert part in run.printed


def test_published_page_is_made_of_the_published_table():
    rows = read_coverage(DOCS / "coverage.parquet")
    page = (DOCS / "coverage.md").read_text(encoding="utf-8")
    assert page_with(page, {PART: coverage_tables(rows)}) == page
    assert set(rows["runs"]) == {1000}
    suite = coverage_suite()
    assert set(rows["scenario"]) == {item.scenario for item in suite.studies}
    assert set(rows["method"]) == {choice.label for choice in suite.studies[0].study.methods}


def test_published_run_meets_what_is_asked():
    missed = [item for item in requirements(read_coverage(DOCS / "coverage.parquet")) if not item.met]
    assert not missed


def test_requirements_can_fail():
    rows = read_coverage(DOCS / "coverage.parquet")
    low = rows.with_columns(
        pl.when(pl.col("scenario") == "rich").then(900).otherwise(pl.col("hits")).alias("hits")
    )
    each, mean, short = requirements(low)
    assert not each.met
    assert "rich, viscous_friction 0.900" in each.measured
    assert mean.met
    assert short.met
    always = requirements(rows.with_columns(pl.col("count").alias("hits")))
    assert [item.met for item in always] == [False, False, False]


def test_own_suite_with_own_scenario(tmp_path, capsys):
    (tmp_path / "suite.toml").write_text(SUITE.format(runs=3))
    (tmp_path / "mine.toml").write_text(MINE)
    suite = read_suite(tmp_path / "suite.toml")
    assert [(item.scenario, item.samples) for item in suite.studies] == [
        ("rich-high", 500),
        ("mine.toml", 500),
    ]
    code = coverage_study.main(
        [str(tmp_path / "suite.toml"), "--folder", str(tmp_path / "trials"), "--workers", "1"]
    )
    assert code == 0
    assert "| mine.toml |" in capsys.readouterr().out
    assert (tmp_path / "trials" / "rich-high-500" / "trials.parquet").exists()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            SUITE.replace("rich-high", "rich-hihg"),
            "names out of arch, .*, or files at scenarios .*; received 'rich-hihg'",
        ),
        (
            SUITE.replace("[500]", "[500.5]"),
            r"a whole number at samples.1. of suite.toml; received 500.5",
        ),
        (SUITE.replace('"classical"', '"clasical"'), "Did you mean 'classical'"),
        (SUITE + "\nextra = 1\n", "extra"),
        (SUITE.replace("[500]", "[]"), "one length or more"),
        (SUITE.replace("[500]", "[500, 500]"), "each once"),
        (SUITE.replace("[500]", "[1e12]"), "a whole number at samples"),
        (SUITE.replace("runs = {runs}", "runs = 0"), "runs from 1"),
    ],
)
def test_wrong_suites_are_refused(tmp_path, wrong, message, capsys):
    (tmp_path / "suite.toml").write_text(wrong.replace("{runs}", "3"))
    (tmp_path / "mine.toml").write_text(MINE)
    with pytest.raises(InputError, match=message):
        read_suite(tmp_path / "suite.toml")
    assert coverage_study.main([str(tmp_path / "suite.toml")]) == WRONG
    assert "Expected" in capsys.readouterr().err


def test_other_tables_are_refused(tmp_path):
    pl.DataFrame({"a": [1]}).write_parquet(tmp_path / "other.parquet")
    for path in (tmp_path / "other.parquet", tmp_path / "none.parquet"):
        with pytest.raises(InputError, match="a table of coverage"):
            read_coverage(path)
