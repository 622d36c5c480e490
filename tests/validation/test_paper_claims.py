"""The paper's sentences: the page is what was measured, and answers what it says."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from eivor.lab.experiments import marks, page_with
from validation.paper.claims import COLUMNS, PART, claims_suite, claims_tables, main
from validation.studies import read_rows

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def published() -> pl.DataFrame:
    return read_rows(DOCS / "studies" / "claims.parquet", COLUMNS, "claims")


def test_published_page_is_made_of_the_published_table(published: pl.DataFrame) -> None:
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    assert page_with(page, {PART: claims_tables(published)}) == page
    suite = claims_suite()
    assert set(published["scenario"]) == {study.scenario for study in suite.studies}
    assert set(published["method"]) == {choice.label for choice in suite.studies[0].study.methods}


@pytest.mark.thorough
def test_a_small_suite_fills_a_page(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "validation" / "paper" / "claims.toml").read_text(encoding="utf-8")
    text = text.replace("[60, 150, 500, 4000]", "[150]").replace('["v", "p", "rich", "white"]', '["white"]')
    (tmp_path / "suite.toml").write_text(text, encoding="utf-8")
    page, out = tmp_path / "page.md", tmp_path / "rows.parquet"
    page.write_text("\n".join(marks(PART)), encoding="utf-8")
    arguments = [str(tmp_path / "suite.toml"), "--runs", "3", "--workers", "1", "--out", str(out)]
    assert main([*arguments, "--page", str(page)]) == 0
    rows = read_rows(out, COLUMNS, "claims")
    assert (rows["failed"] == 0).all()
    assert (rows.filter(method="extended_iv")["weak"] == 3).all()
    assert (rows["condition"] >= 1.0).all()
    assert "white noise" in page.read_text(encoding="utf-8")
