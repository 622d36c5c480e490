"""The study of errors over the Cramer-Rao bound: what it asks can fail, and its page is what it measured."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import eivor as ev
from eivor.lab.experiments import marks, page_with
from validation.efficiency.known_spectra import main as known_spectra
from validation.efficiency.known_spectra import rows_of, trial
from validation.efficiency.study import (
    COLUMNS,
    HELD,
    KNOWN,
    OVER_BOUND,
    PART,
    efficiency_suite,
    efficiency_tables,
    main,
    requirements,
)
from validation.studies import KEYS, WRONG, joined, read_rows, write_rows
from validation.suite_files import read_suite

DOCS = Path(__file__).parents[2] / "docs"
SUITES = Path(__file__).parents[2] / "validation" / "efficiency"
HELD_SUITE, QUICK_SUITE = SUITES / "held.toml", SUITES / "quick.toml"
SUITE = """
name = "small"
runs = 2
seed = 1
samples = [500]
scenarios = ["white"]
[[methods]]
name = "generalized_iv"
lags = [0, 10]
[[methods]]
name = "spectral_giv"
lags = [0, 10]
[[methods]]
name = "spectral_giv_combined"
lags = [0, 10]
"""


@pytest.fixture(scope="module")
def published() -> pl.DataFrame:
    return read_rows(DOCS / "studies" / "efficiency.parquet", COLUMNS, "efficiency")


def test_published_page_is_made_of_the_published_table(published: pl.DataFrame) -> None:
    page = (DOCS / "efficiency.md").read_text(encoding="utf-8")
    assert page_with(page, {PART: efficiency_tables(published)}) == page
    suite = efficiency_suite()
    assert set(published["scenario"]) == {study.scenario for study in suite.studies}
    assert set(published["method"]) == {KNOWN, *(each.label for each in suite.studies[0].study.methods)}


def test_the_held_scenarios_are_those_that_are_judged() -> None:
    held = read_suite(HELD_SUITE)
    assert {(study.scenario, study.samples) for study in held.studies} == {
        (a, b) for a in HELD for b in OVER_BOUND
    }
    whole = {(study.scenario, study.samples): study.study for study in efficiency_suite().studies}
    assert all(study.study == whole[study.scenario, study.samples] for study in held.studies)


def test_the_quick_methods_are_on_the_same_records() -> None:
    quick = {(item.scenario, item.samples): item.study for item in read_suite(QUICK_SUITE).studies}
    whole = {(item.scenario, item.samples): item.study for item in efficiency_suite().studies}
    assert quick.keys() == whole.keys()
    for name, study in quick.items():
        assert study == dataclasses.replace(whole[name], methods=study.methods)
        assert set(study.methods) < set(whole[name].methods)


def test_a_likelihood_that_knows_the_spectra_is_on_the_same_records(tmp_path: Path) -> None:
    item = next(
        study
        for study in read_suite(HELD_SUITE).studies
        if (study.scenario, study.samples) == ("rich-high", 500)
    )
    results = [trial(item, run) for run in range(3)]
    plain = [
        ev.identify(
            item.study.experiment.problem(item.study.experiment.record(item.study.rng(run)), ()),
            ev.methods.spectral_giv(),
        )
        for run in range(3)
    ]
    rows = list(rows_of(item, results))
    assert [row["parameter"] for row in rows] == ["viscous_friction", "input_gain"]
    for each, other in zip(results, plain, strict=True):
        separated = np.abs(np.array(each.values) - other.best.values[:2])
        assert (separated < 2.0 * np.array([other.std_error(name) for name in other.names[:2]])).all()
    assert all(float(row["rmse"]) < 2.5 * float(row["bound"]) for row in rows)


@pytest.mark.thorough
def test_known_spectra_go_on_from_what_is_kept(tmp_path: Path) -> None:
    (tmp_path / "suite.toml").write_text(SUITE.replace("runs = 2", "runs = 3"), encoding="utf-8")
    kept, out = tmp_path / "kept.jsonl", tmp_path / "rows.parquet"
    arguments = [str(tmp_path / "suite.toml"), "--kept", str(kept), "--out", str(out)]
    assert known_spectra([*arguments, "--runs", "2"]) == 0
    first = kept.read_text(encoding="utf-8")
    assert known_spectra(arguments) == 0
    assert kept.read_text(encoding="utf-8").startswith(first)
    assert len(kept.read_text(encoding="utf-8").splitlines()) == 3
    assert read_rows(out, COLUMNS, "efficiency")["method"].to_list() == [KNOWN, KNOWN]
    assert known_spectra([str(tmp_path / "none.toml"), *arguments[1:]]) == WRONG


def test_runs_of_other_lengths_make_one_page(
    published: pl.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    longest = pl.col("samples") == 4000
    parts = [published.filter(longest), published.filter(~longest).with_columns(runs=pl.lit(7, pl.Int64))]
    files = [tmp_path / "long.parquet", tmp_path / "short.parquet"]
    for rows, file in zip(parts, files, strict=True):
        write_rows(rows, file)
    main([word for file in files for word in ("--from", str(file))])
    out = capsys.readouterr().out
    assert out == efficiency_tables(pl.concat(parts)) + "\n"
    assert "7 to" in out
    assert "| v | 7 |" in out


def test_a_row_of_several_runs_is_of_most_records(published: pl.DataFrame) -> None:
    quick = published.filter(pl.col("method") == "generalized_iv").with_columns(runs=pl.lit(5000, pl.Int64))
    both = joined([published, quick])
    assert both.drop("runs").equals(published.drop("runs"))
    assert both.filter(pl.col("runs") == 5000).equals(quick)
    assert joined([quick, published]).sort(KEYS).equals(both.sort(KEYS))
    assert "| v | 1000 to 5000 |" in efficiency_tables(both)


def test_requirements_can_fail(published: pl.DataFrame) -> None:
    worse = published.with_columns(
        pl.when((pl.col("scenario") == "rich") & (pl.col("method") == "spectral_giv"))
        .then(pl.col("rmse") * 3.0)
        .otherwise(pl.col("rmse"))
        .alias("rmse"),
        pl.lit(0).alias("hits"),
    )
    results = {item.what: item for item in requirements(worse)}
    over_bound = results["spectral_giv, N = 4000: RMSE over the bound"]
    assert not over_bound.met
    assert "rich, N = 4000, viscous_friction" in over_bound.measured
    assert not results["spectral_giv, rich: RMSE of K over generalized IV's"].met
    assert not results["spectral_giv, N = 4000: mean coverage"].met
    shifted = published.with_columns(pl.lit(0.9).alias("bias"))
    assert not {item.what: item for item in requirements(shifted)}[
        "spectral_giv, N = 500: bias over the scatter"
    ].met


@pytest.mark.thorough
def test_a_small_suite_fills_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "suite.toml").write_text(SUITE, encoding="utf-8")
    page, out = tmp_path / "page.md", tmp_path / "rows.parquet"
    page.write_text("\n".join(marks(PART)), encoding="utf-8")
    arguments = [str(tmp_path / "suite.toml"), "--workers", "1", "--out", str(out), "--page", str(page)]
    assert main(arguments) in {0, 3}
    rows = read_rows(out, COLUMNS, "efficiency")
    assert rows.height == 6
    assert (rows["bound"] > 0.0).all()
    assert "| white |" in page.read_text(encoding="utf-8")
    assert "RMSE over the Cramer-Rao bound" in capsys.readouterr().out


def test_a_wrong_file_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "other.parquet").write_bytes(b"nothing")
    assert main(["--from", str(tmp_path / "other.parquet")]) == WRONG
    assert "a table of efficiency" in capsys.readouterr().err
