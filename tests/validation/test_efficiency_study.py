"""The study of errors over the Cramer-Rao bound: what it asks can fail, and its page is what it measured."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from eivor.studies.generated_page import marks, page_with
from validation.efficiency.page import PART, efficiency_tables
from validation.efficiency.requirements import requirements
from validation.efficiency.study import efficiency_suite, main
from validation.efficiency.table import COLUMNS
from validation.suites import WRONG, read_rows

DOCS = Path(__file__).parents[2] / "docs"
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
    assert set(published["scenario"]) == {one.scenario for one in suite.studies}
    assert set(published["method"]) == {choice.label for choice in suite.studies[0].study.methods}


def test_requirements_can_fail(published: pl.DataFrame) -> None:
    worse = published.with_columns(
        pl.when((pl.col("scenario") == "rich") & (pl.col("method") == "spectral_giv"))
        .then(pl.col("rmse") * 3.0)
        .otherwise(pl.col("rmse"))
        .alias("rmse"),
        pl.lit(0).alias("hits"),
    )
    found = {item.what: item for item in requirements(worse)}
    over_bound = found["spectral_giv, N = 4000: RMSE over the bound"]
    assert not over_bound.met
    assert "rich, N = 4000, viscous_friction" in over_bound.measured
    assert not found["spectral_giv, rich: RMSE of K over generalized IV's"].met
    assert not found["spectral_giv, N = 4000: mean coverage"].met
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
