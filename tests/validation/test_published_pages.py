"""Pages of the documentation are made of the published runs, and these meet what is required of them."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from eivor import methods
from validation.coverage.study import coverage_tables, read_coverage
from validation.coverage.study import requirements as coverage_requirements
from validation.efficiency import study as efficiency
from validation.flight_methods import study as flight_methods
from validation.flight_recipe.study import requirements as flight_requirements
from validation.flight_recipe.study import study_tables as flight_tables
from validation.flight_recipe.trials import published_grid, read_trial_table
from validation.paper.claims import COLUMNS as CLAIMS_COLUMNS
from validation.paper.claims import claims_suite, claims_tables
from validation.studies import read_as, read_rows
from validation.suite_files import coverage_suite
from validation.unknown_noise import study as unknown_noise

DOCS = Path(__file__).parents[2] / "docs"
STUDIES = DOCS / "studies"


def part_of(page, part):
    """Generated part of a page of the documentation."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return text.partition(f"<!-- generated: {part} -->")[2].partition(f"<!-- end: {part} -->")[0]


@pytest.fixture(scope="module")
def coverage():
    return read_coverage(STUDIES / "coverage.parquet")


@pytest.fixture(scope="module")
def efficiencies():
    return read_rows(STUDIES / "efficiency.parquet", efficiency.COLUMNS, "efficiency")


@pytest.fixture(scope="module")
def claims():
    return read_rows(STUDIES / "claims.parquet", CLAIMS_COLUMNS, "claims")


def is_of(rows, suite, *more):
    """Whether the rows have the scenarios and methods of a suite, and more methods."""
    labels = {choice.label for choice in suite.studies[0].study.methods}
    scenarios = {study.scenario for study in suite.studies}
    return set(rows["scenario"]) == scenarios and set(rows["method"]) == labels | set(more)


def test_pages_are_made_of_the_published_tables(coverage, efficiencies, claims):
    assert part_of("studies/coverage.md", "coverage").strip() == coverage_tables(coverage)
    assert part_of("efficiency.md", "efficiency").strip() == efficiency.efficiency_tables(efficiencies)
    assert part_of("paper.md", "claims").strip() == claims_tables(claims)
    assert set(coverage["runs"]) == {1000}
    assert is_of(coverage, coverage_suite())
    assert is_of(efficiencies, efficiency.efficiency_suite(), efficiency.KNOWN)
    assert is_of(claims, claims_suite())


def test_the_page_of_the_flight_study_has_the_flights_of_the_grid():
    trials = read_trial_table(STUDIES / "flight-recipe.parquet")
    assert trials.origin["size"] == "full"
    assert part_of("studies/coverage.md", "flight study").strip() == flight_tables(trials)
    seeds = {case.name: case.spec.seed for case in published_grid().cases}
    assert dict(zip(trials.rows["flight"], trials.rows["seed"], strict=True)) == seeds
    assert all(item.met for item in flight_requirements(trials.rows))
    assert (STUDIES / "flight-recipe.parquet").stat().st_size < 150 * 1024


def test_coverage_is_as_required_and_need_not_be(coverage):
    assert all(item.met for item in coverage_requirements(coverage))
    low = pl.when(pl.col("scenario") == "rich").then(900).otherwise(pl.col("hits"))
    each, mean, short = coverage_requirements(coverage.with_columns(low.alias("hits")))
    assert [each.met, mean.met, short.met] == [False, True, True]
    assert "rich, viscous_friction 0.900" in each.measured
    always = coverage_requirements(coverage.with_columns(pl.col("count").alias("hits")))
    assert [item.met for item in always] == [False, False, False]


def test_pages_have_every_row_of_their_grids():
    grid = read_as(flight_methods.Grid, flight_methods.STUDY.grid)
    text = part_of("efficiency.md", flight_methods.STUDY.part)
    for regime in grid.regimes:
        assert f"{regime.full} of {regime.name}" in text
        for method in grid.methods:
            assert hasattr(methods, method)
            assert f"| {regime.name} | {method} | {regime.full} |" in text
    for path in (unknown_noise.SUITE, unknown_noise.SUITE.with_name("spectral.toml")):
        suite = read_as(unknown_noise.Suite, path)
        text = part_of("efficiency.md", suite.part)
        assert suite.runs >= 1000
        assert f"{suite.runs} records of each case, seed {suite.seed}" in text
        for name, case in suite.cases.items():
            assert all(f"| {name} | {method} |" in text for method in case.methods)
