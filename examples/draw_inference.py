"""Draw what inference says of one simulated record, and of the coverage study.

    PYTHONPATH=. python examples/draw_inference.py [FOLDER]

writes the pictures of the documentation: intervals of several methods beside each other, the joint region
of friction and gain, the residual of generalized IV, and the coverage of the default intervals. The record
is the first of the scenario `rich-high` with the seed of the coverage study.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import polars as pl

import eivor as ev
from eivor.lab.figures import coverage_figure
from eivor.lab.study import Share
from eivor.report.figure_panels import estimates_figure, pair_figure
from eivor.report.figures import residual_figure
from validation.coverage.study import BOUNDS, JUDGED, read_coverage
from validation.suite_files import coverage_suite

ROOT = Path(__file__).resolve().parents[1]
COVERAGE = ROOT / "docs" / "studies" / "coverage.parquet"
SYMBOLS = {"viscous_friction": "K", "input_gain": "K_u"}
SCENARIO, SAMPLES = "rich-high", 4000


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (item,) = (
        study for study in coverage_suite().studies if (study.scenario, study.samples) == (SCENARIO, SAMPLES)
    )
    truth = dict(item.study.experiment.truth)
    record = item.study.experiment.record(item.study.rng(0))
    motion = ev.VerticalMotion(intercept=False)
    lagged = motion.regression(record, ev.lags("input", 0, 10))
    past = motion.regression(record, ev.lags("input", 1, 10))
    generalized = ev.identify(lagged, ev.methods.generalized_iv())
    replicates = ev.bootstrap(lagged, ev.methods.generalized_iv(), seed=1)
    estimates = {
        "least squares": ev.identify(motion.regression(record), ev.methods.least_squares()),
        "extended IV": ev.identify(past, ev.methods.extended_iv()),
        "generalized IV": generalized,
        "generalized IV, bootstrap": replicates,
    }
    figures = {
        "intervals": estimates_figure(estimates, truth=truth, title="One record, 95 % intervals"),
        "pair": pair_figure(
            generalized,
            "viscous_friction",
            "input_gain",
            truth=truth,
            replicates=replicates,
            title="Generalized IV: joint region, intervals, bootstrap",
        ),
        "residual": residual_figure(generalized.residuals, rate_hz=record.rate_hz, unit="m/s^2"),
        "coverage": coverage_of_the_study(),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=110)
        print(folder / f"{name}.png")


def coverage_of_the_study() -> object:
    """Default intervals beside those that ignore autocorrelation, at the shorter length."""
    rows = read_coverage(COVERAGE).filter(
        pl.col("samples") == min(BOUNDS), pl.col("method").is_in([JUDGED, "newey_west", "classical"])
    )
    shares: dict[str, dict[str, Share]] = {}
    for row in rows.iter_rows(named=True):
        group = f"{row['scenario']}, {SYMBOLS[row['parameter']]}"
        shares.setdefault(row["method"].replace("_", " "), {})[group] = Share(row["hits"], row["count"])
    return coverage_figure(shares, title=f"Coverage at N = {min(BOUNDS)}")


if __name__ == "__main__":
    with np.errstate(all="raise", under="ignore"):
        main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs" / "images" / "inference"))
