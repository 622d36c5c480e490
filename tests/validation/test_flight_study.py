"""The flight study: its grid, its scores on made-up trials, and its small size judged by binomial bounds."""

from __future__ import annotations

import os
import subprocess
import sys

import polars as pl
import pytest
from scipy.stats import binom

from validation.flight_recipe.study import PART, accepted, accepted_share, flown, requirements, score
from validation.flight_recipe.trials import LAG_IGNORED, NONLINEAR, QUANTITIES, read_trial_table

BEGIN, END = f"<!-- generated: {PART} -->", f"<!-- end: {PART} -->"

pytest.importorskip("rotorpy")
#: 85 s of what the full size does with every class: its figures are in `docs/studies/coverage.md`, and
#: `test_published_pages.py` holds them against what is required.
pytestmark = pytest.mark.long
CHANCE = 1e-3


@pytest.fixture(scope="module")
def calm(trials):
    return trials.rows.filter(pl.col("calm"))


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    """Trials and tables of the command, in a process of its own."""
    folder = tmp_path_factory.mktemp("study")
    trials, page = folder / "trials.parquet", folder / "page.md"
    page.write_text(f"Before.\n\n{BEGIN}\n{END}\n\nAfter.\n", encoding="utf-8")
    command = [sys.executable, "-m", "validation.flight_recipe.study", "--size", "small"]
    done = subprocess.run(
        [*command, "--out", str(trials), "--page", str(page)],
        capture_output=True,
        check=False,
        encoding="utf-8",
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUTF8": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    filled = f"Before.\n\n{BEGIN}\n\n{done.stdout.strip()}\n\n{END}\n\nAfter."
    assert filled in page.read_text(encoding="utf-8")
    return read_trial_table(trials), done.stdout


@pytest.fixture(scope="module")
def trials(small_run):
    return small_run[0]


@pytest.mark.calibration
def test_the_small_grid_is_flown_and_meets_what_is_required(small_run, trials, calm):
    assert "| constant-reference hovers accepted | none | 0 of 3 | yes |" in small_run[1]
    assert trials.rows.height == flown(trials.rows).height == 36
    assert set(trials.rows["simulator"]) == {"vertical", "rotorpy"}
    assert all(item.met for item in requirements(trials.rows, allow_chance=True))
    share = accepted_share(calm)
    assert share.hits >= least(share.count, 0.75)
    hovers = accepted_share(trials.rows.filter(pl.col("kind") == "hover"))
    assert hovers.count >= 3
    assert hovers.hits == 0
    far = score(accepted(trials.rows), "viscous_friction").beyond_half
    assert far.hits <= most(far.count, 0.04)


def least(count, share):
    """So many of `count` trials succeed at least, unless a rare chance has it otherwise."""
    return int(binom.ppf(CHANCE, count, share))


def most(count, share):
    return int(binom.isf(CHANCE, count, share))


@pytest.mark.calibration
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_intervals_of_accepted_flights_hold_the_truth(trials, quantity):
    coverage = score(accepted(trials.rows), quantity).coverage
    assert coverage.count >= 20
    assert coverage.hits >= least(coverage.count, 0.92)


@pytest.mark.calibration
def test_controls_fail(trials, calm):
    ignored = score(calm, "viscous_friction", LAG_IGNORED)
    assert ignored.bias < -0.2
    assert ignored.coverage.hits < least(ignored.coverage.count, 0.8)
    gusty = trials.rows.filter((pl.col("kind") == "excited") & ~pl.col("calm"))
    direct = score(gusty, "viscous_friction", NONLINEAR)
    assert direct.coverage.hits <= most(direct.coverage.count, 0.8)
    assert direct.bias < -0.05
    assert direct.bias < score(gusty, "viscous_friction").bias
