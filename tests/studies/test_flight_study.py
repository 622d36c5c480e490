"""The small size of the flight study, judged with binomial bounds, and the command that runs it.

The bounds are crossed by chance once in a thousand runs of a recipe that is exactly as good as it must be;
this one is the same in every run.
"""

from __future__ import annotations

import polars as pl
import pytest
from scipy.stats import binom

from eivor.studies import flight_study
from eivor.studies.flight_metrics import accepted, accepted_share, flown, score
from eivor.studies.flight_page import BEGIN, END
from eivor.studies.flight_requirements import ERROR_BOUNDS, requirements
from eivor.studies.flight_trials import LAG_IGNORED, NONLINEAR, QUANTITIES
from eivor.studies.trial_table import TrialTable

pytest.importorskip("rotorpy")

CHANCE = 1e-3


@pytest.fixture(scope="module")
def table() -> TrialTable:
    return flight_study.run_study("small")


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
    found = score(accepted(calm), quantity)
    assert found.median <= ERROR_BOUNDS[quantity][0]
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


def test_command_writes_table_and_page_and_makes_them_anew(table, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(flight_study, "run_study", lambda size: {"small": table}[size])
    stored, page = tmp_path / "trials.parquet", tmp_path / "page.md"
    page.write_text(f"# Study\n\nBefore.\n\n{BEGIN}\n{END}\n\nAfter.\n", encoding="utf-8")
    assert flight_study.main(["--size", "small", "--out", str(stored), "--page", str(page)]) == 0
    printed = capsys.readouterr().out
    assert "| constant-reference hovers accepted | none | 0 of 3 | yes |" in printed
    assert f"{BEGIN}\n\n{printed.strip()}\n\n{END}\n\nAfter." in page.read_text(encoding="utf-8")
    assert flight_study.main(["--from", str(stored)]) == 0
    assert capsys.readouterr().out == printed
