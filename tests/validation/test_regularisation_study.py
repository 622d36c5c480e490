"""The study of regularisation: its page is what it measured, and the sentences above it are borne out."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from eivor.studies.generated_page import marks, page_with
from validation.efficiency.regularisation import main, regularisation_suite
from validation.efficiency.regularisation_page import PART, regularisation_tables
from validation.efficiency.table import COLUMNS
from validation.suites import read_rows

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
name = "generalized_iv"
lags = [0, 10]
label = "pulled"
regularisation = { choice = "given", parameter = 1.0 }
"""


@pytest.fixture(scope="module")
def published() -> pl.DataFrame:
    return read_rows(DOCS / "studies" / "regularisation.parquet", COLUMNS, "regularisation")


def over_plain(rows: pl.DataFrame, method: str) -> pl.DataFrame:
    keys = ["scenario", "samples", "parameter"]
    plain = rows.filter(pl.col("method") == "generalized_iv").select(*keys, plain="rmse")
    joined = rows.filter(pl.col("method") == method).join(plain, on=keys)
    return joined.with_columns(over=pl.col("rmse") / pl.col("plain"))


def test_published_page_is_made_of_the_published_table(published: pl.DataFrame) -> None:
    page = (DOCS / "efficiency.md").read_text(encoding="utf-8")
    assert page_with(page, {PART: regularisation_tables(published)}) == page
    suite = regularisation_suite()
    assert set(published["scenario"]) == {one.scenario for one in suite.studies}
    assert set(published["method"]) == {choice.label for choice in suite.studies[0].study.methods}


def test_regularisation_gains_nothing(published: pl.DataFrame) -> None:
    """What the page says of it: cross-validation leaves generalized IV where it is."""
    for method in ("Tikhonov, GCV", "Tikhonov TLS, GCV", "implicit iteration, GCV"):
        over = over_plain(published, method)["over"]
        assert over.min() > 0.95
        assert over.max() < 1.05
    white = published.filter(pl.col("scenario") == "white", pl.col("parameter") == "input_gain")
    rmse = {row["method"]: row["rmse"] for row in white.filter(samples=4000).iter_rows(named=True)}
    assert rmse["extended IV, Tikhonov to least squares, GCV"] < rmse["extended_iv"]
    assert rmse["generalized_iv"] < 0.5 * rmse["extended IV, Tikhonov to least squares, GCV"]


@pytest.mark.thorough
def test_a_small_suite_fills_a_page(tmp_path: Path) -> None:
    (tmp_path / "suite.toml").write_text(SUITE, encoding="utf-8")
    page, out = tmp_path / "page.md", tmp_path / "rows.parquet"
    page.write_text("\n".join(marks(PART)), encoding="utf-8")
    arguments = [str(tmp_path / "suite.toml"), "--workers", "1", "--out", str(out), "--page", str(page)]
    assert main(arguments) == 0
    rows = read_rows(out, COLUMNS, "regularisation")
    assert (over_plain(rows, "pulled")["over"] > 2.0).all()
    assert "| pulled |" in page.read_text(encoding="utf-8")
