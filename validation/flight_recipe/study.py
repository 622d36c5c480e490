"""The study that validates the flight recipe on simulated truth, and the command that runs it.

    python -m validation.flight_recipe.study [--size small|full] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`flight_grid.toml`), runs the recipe and its controls on every flight, and
prints the tables. `--from FILE.parquet` makes them anew from a finished run. A full run takes about
half an hour on one core, a small one half a minute; `--workers` says how many are used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool

from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import BEYOND_DOUBT
from eivor.inference.verdict import Status
from eivor.lab.study import Share
from eivor.process_pool import local_executor
from validation.flight_recipe.trials import (
    LAG_IGNORED,
    LOST,
    NONLINEAR,
    PACKAGES,
    QUANTITIES,
    RECIPE,
    TrialTable,
    flown_together,
    published_grid,
    read_trial_table,
    run_trials,
    trial_table,
)
from validation.pages import markdown
from validation.studies import (
    FINISHED,
    OUT,
    SIZE,
    WORKERS,
    Answer,
    Requirement,
    StudyCommand,
    requirement_table,
    share_text,
    with_bar,
)

#: Confidence level of the intervals of shares.
LEVEL = 0.99


@dataclass(frozen=True, slots=True)
class Score:
    """How one estimator did on one quantity over some flights."""

    median: float  # Quantiles of the absolute error
    ninetieth: float
    bias: float  # Mean error
    coverage: Share  # Intervals that hold the truth
    beyond_half: Share  # Estimates off by more than half of the truth


def accepted(rows: pl.DataFrame) -> pl.DataFrame:
    return rows.filter(pl.col("verdict") == Status.IDENTIFIED.value)


def flown(rows: pl.DataFrame) -> pl.DataFrame:
    return rows.filter(pl.col("verdict") != LOST)


def accepted_share(rows: pl.DataFrame) -> Share:
    return Share(accepted(rows).height, flown(rows).height, LEVEL)


def score(rows: pl.DataFrame, quantity: str, estimator: str = RECIPE) -> Score:
    """Errors and coverage over all flights of a table that have an estimate."""
    value, low, high = (
        rows[f"{estimator}.{quantity}.{part}"].to_numpy() for part in ("value", "low", "high")
    )
    truth = rows[f"truth.{quantity}"].to_numpy()
    known = np.isfinite(value) & np.isfinite(truth)
    error = value[known] - truth[known]
    if quantity != "effective_lag":
        error = error / truth[known]
    inside = (low[known] <= truth[known]) & (truth[known] <= high[known])
    half = np.abs(value[known] - truth[known]) > 0.5 * truth[known]
    if not known.any():
        nan = float("nan")
        return Score(nan, nan, nan, Share(0, 0, LEVEL), Share(0, 0, LEVEL))
    return Score(
        float(np.median(np.abs(error))),
        float(np.quantile(np.abs(error), 0.9)),
        float(error.mean()),
        _share(inside),
        _share(half),
    )


def _share(hits: Bool[np.ndarray, " n"]) -> Share:
    return Share(int(hits.sum()), int(hits.size), LEVEL)


#: Largest median and 90th percentile of the errors on calm accepted flights: relative, and [s] for the lag.
ERROR_BOUNDS = {
    "viscous_friction": (0.07, 0.22),
    "input_gain": (0.012, 0.05),
    "effective_lag": (0.005, 0.020),
}
#: What the 99 % interval of the coverage of a 95 % interval must meet.
COVERAGE_BOUNDS = (0.92, 0.98)
COVERED = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
LEAST_ACCEPTED = 0.75
MOST_BEYOND_HALF = 0.04
#: A control fails when its coverage is below this, or its mean error on calm flights below the other.
CONTROL_COVERAGE = 0.8
CONTROL_BIAS = -0.2

NAMES = {
    "viscous_friction": "K",
    "input_gain": "K_u",
    "effective_lag": "effective lag",
    "hover_input": "hover input",
}


def requirements(rows: pl.DataFrame, *, allow_chance: bool = False) -> tuple[Requirement, ...]:
    return tuple(_requirements(rows, allow_chance))


def _requirements(rows: pl.DataFrame, allow_chance: bool) -> Iterator[Requirement]:
    calm, excited = rows.filter(pl.col("calm")), rows.filter(pl.col("kind") == "excited")
    yield from (_small_errors(accepted(calm), quantity) for quantity in ERROR_BOUNDS)
    yield from (_coverage(accepted(rows), quantity) for quantity in COVERED)
    share = accepted_share(calm)
    reached = share.interval[1] if allow_chance else share.value
    met = reached >= LEAST_ACCEPTED
    yield Requirement("calm excited flights accepted", f"at least {LEAST_ACCEPTED}", share_text(share), met)
    share = accepted_share(rows.filter(pl.col("kind") == "hover"))
    what = "constant-reference hovers accepted"
    yield Requirement(what, "none", f"{share.hits} of {share.count}", share.hits == 0)
    share = score(accepted(rows), "viscous_friction").beyond_half
    reached = share.interval[0] if allow_chance else share.value
    yield Requirement(
        "accepted flights whose K is off by more than half",
        f"at most {MOST_BEYOND_HALF}",
        share_text(share),
        share.count > 0 and reached <= MOST_BEYOND_HALF,
    )
    result = score(calm, "viscous_friction", LAG_IGNORED)
    yield Requirement(
        "control that must fail: lag ignored, calm flights",
        f"bias of K below {CONTROL_BIAS:.0%}, or coverage below {CONTROL_COVERAGE}".replace("%", " %"),
        f"bias {result.bias:.1%}, coverage {share_text(result.coverage)}".replace("%", " %"),
        result.bias < CONTROL_BIAS or result.coverage.interval[1] < CONTROL_COVERAGE,
    )
    result = score(excited.filter(~pl.col("calm")), "viscous_friction", NONLINEAR)
    reached = result.coverage.interval[0] if allow_chance else result.coverage.value
    yield Requirement(
        "control that must fail: nonlinear least squares, gusty flights",
        f"coverage of K below {CONTROL_COVERAGE}",
        f"bias {result.bias:.1%}, coverage {share_text(result.coverage)}".replace("%", " %"),
        reached < CONTROL_COVERAGE,
    )


def error_text(quantity: str, value: float) -> str:
    """Error in per cent, or in milliseconds for the lag."""
    return f"{value * 1e3:.1f} ms" if quantity == "effective_lag" else f"{value:.1%}".replace("%", " %")


def _small_errors(rows: pl.DataFrame, quantity: str) -> Requirement:
    median, ninetieth = ERROR_BOUNDS[quantity]
    result = score(rows, quantity)
    return Requirement(
        f"error of {NAMES[quantity]}, calm accepted flights: median, 90th percentile",
        f"at most {error_text(quantity, median)}, {error_text(quantity, ninetieth)}",
        f"{error_text(quantity, result.median)}, {error_text(quantity, result.ninetieth)}",
        result.median <= median and result.ninetieth <= ninetieth,
    )


def _coverage(rows: pl.DataFrame, quantity: str) -> Requirement:
    low, high = COVERAGE_BOUNDS
    coverage = score(rows, quantity).coverage
    least, most = coverage.interval
    return Requirement(
        f"coverage of the 95 % interval of {NAMES[quantity]}, all accepted flights",
        f"99 % interval meets [{low}, {high}]",
        share_text(coverage),
        least <= high and most >= low,
    )


PART = "flight study"
COMMAND = "python -m validation.flight_recipe.study"
ESTIMATOR_NAMES = {RECIPE: "the recipe", LAG_IGNORED: "lag ignored", NONLINEAR: "nonlinear least squares"}
#: Lags that count as one group [s]; the grid of the recipe has steps of 10 ms.
LAG_EDGES = (0.01, 0.025, 0.06)
LAG_BANDS = ("below 10 ms", "10 to 25 ms", "25 to 60 ms", "60 ms and more")


def study_tables(table: TrialTable) -> str:
    rows, origin = table.rows, table.origin
    option = "" if origin["size"] == "full" else f" --size {origin['size']}"
    made = ", ".join(f"{package} {origin[package]}" for package in PACKAGES)
    lost = rows.height - flown(rows).height
    return "\n\n".join(
        [
            f"Made by `{COMMAND}{option}` with {made}, Python {origin['python']}: grid "
            f"*{origin['grid']}*, size {origin['size']}, {rows.height} flights, of which {lost} lost their "
            "vehicle in the simulator and are left out. Brackets hold the 99 % Wilson interval of a share.",
            "## What is asked, and what came out",
            requirement_table(requirements(rows, allow_chance=origin["size"] != "full"), not_met="**no**"),
            "## By class",
            "Errors and coverage of accepted flights; relative errors for K and K_u.",
            class_table(rows),
            "## Verdicts",
            verdict_table(rows),
            "## Against the controls",
            "K on every excited flight that has an estimate, accepted or not.",
            control_table(rows),
            "## Where the coverage stands",
            "Coverage of the 95 % intervals of accepted flights, by what the flight was.",
            group_table(accepted(rows)),
            "## Bias of the lag",
            "Mean error of the effective lag with its standard error, over accepted calm flights of the own "
            "simulator.",
            lag_table(accepted(rows.filter(pl.col("calm"), pl.col("simulator") == "vertical"))),
        ]
    )


def class_table(rows: pl.DataFrame) -> str:
    """One row for each class of the grid, in the grid's order."""
    header = ["class", "flown", "accepted", "K median", "K p90", "K bias", "K cover", "K_u median", "K_u p90"]
    header += ["K_u cover", "lag median", "lag p90", "lag cover", "hover cover"]
    lines = []
    for name in rows["class"].unique(maintain_order=True):
        part = rows.filter(pl.col("class") == name)
        friction, gain, lag, hover = (score(accepted(part), quantity) for quantity in QUANTITIES)
        lines.append(
            [
                name,
                str(flown(part).height),
                str(accepted_share(part).hits),
                *_error_cells("viscous_friction", friction, bias=True),
                *_error_cells("input_gain", gain),
                *_error_cells("effective_lag", lag),
                _covered(hover),
            ]
        )
    return markdown(header, lines)


def verdict_table(rows: pl.DataFrame) -> str:
    """How often each verdict was given, and how often each test of the instruments failed."""
    header = [
        "class",
        "flown",
        *(status.value for status in Status),
        "first-stage F below 10",
        "J p-value below .001",
    ]
    lines = []
    for name in rows["class"].unique(maintain_order=True):
        part = flown(rows).filter(pl.col("class") == name)
        counts = [part.filter(pl.col("verdict") == status.value).height for status in Status]
        weak = part.filter(pl.col("recipe.first_stage_F") < STRONG_FIRST_STAGE).height
        disagree = part.filter(pl.col("recipe.p_value") < BEYOND_DOUBT).height
        lines.append([name, *(str(count) for count in (part.height, *counts, weak, disagree))])
    return markdown(header, lines)


def control_table(rows: pl.DataFrame) -> str:
    excited = rows.filter(pl.col("kind") == "excited")
    lines = []
    for label, part in (("calm", excited.filter(pl.col("calm"))), ("gusty", excited.filter(~pl.col("calm")))):
        for estimator, name in ESTIMATOR_NAMES.items():
            result = score(part, "viscous_friction", estimator)
            lines.append(
                [
                    label,
                    name,
                    error_text("viscous_friction", result.median),
                    error_text("viscous_friction", result.bias),
                    share_text(result.coverage),
                ]
            )
    return markdown(("flights", "estimator", "median error of K", "bias of K", "coverage of K"), lines)


def group_table(rows: pl.DataFrame) -> str:
    banded = rows.with_columns(
        pl.Series("lag", _lag_bands(rows), dtype=pl.String),
        (pl.col("delay") * 1e3).round(0).cast(pl.Int64).cast(pl.String).alias("delay [ms]"),
        pl.col("gust_rms").cast(pl.String).alias("gusts [m/s]"),
    )
    lines = []
    for column in ("simulator", "trajectory", "noise", "lag", "delay [ms]", "gusts [m/s]"):
        present = set(banded[column].to_list())
        order = LAG_BANDS if column == "lag" else sorted(present)
        for value in (label for label in order if label in present):
            part = banded.filter(pl.col(column) == value)
            shares = [f"{score(part, quantity).coverage.value:.3f}" for quantity in QUANTITIES]
            lines.append([column, value, str(part.height), *shares])
    return markdown(("group", "", "flights", "K", "K_u", "effective lag", "hover input"), lines)


def lag_table(rows: pl.DataFrame) -> str:
    """Mean error of the effective lag by lag and gusts."""
    banded = rows.with_columns(pl.Series("lag", _lag_bands(rows), dtype=pl.String))
    lines = []
    for band in LAG_BANDS:
        for label, windy in (("none", False), ("some", True)):
            here = banded.filter(pl.col("lag") == band, (pl.col("gust_rms") > 0.0) == windy)
            error = 1e3 * (here["recipe.effective_lag.value"] - here["truth.effective_lag"]).to_numpy()
            text = "-"
            if error.size > 1:
                text = f"{error.mean():.2f} +- {error.std(ddof=1) / np.sqrt(error.size):.2f} ms"
            lines.append([band, label, str(error.size), text])
    return markdown(("lag", "gusts", "flights", "bias of the effective lag"), lines)


def _lag_bands(rows: pl.DataFrame) -> list[str]:
    lag = (rows["truth.effective_lag"] - rows["delay"]).to_numpy()
    return [LAG_BANDS[band] for band in np.digitize(lag, LAG_EDGES)]


def _error_cells(quantity: str, result: Score, *, bias: bool = False) -> list[str]:
    if not result.coverage.count:
        return ["-"] * (4 if bias else 3)
    displayed = [result.median, result.ninetieth, *([result.bias] if bias else [])]
    return [*(error_text(quantity, value) for value in displayed), _covered(result)]


def _covered(result: Score) -> str:
    return f"{result.coverage.value:.3f}" if result.coverage.count else "-"


def run_grid(size: str, workers: int | None = None) -> TrialTable:
    grid = published_grid() if size == "full" else published_grid().small()
    executor = local_executor(workers, len(flown_together(grid)))
    trials = with_bar(run_trials(grid, executor), "flights", len(grid.cases))
    return trial_table(trials, grid=grid.name, size=size)


def answer(chosen: argparse.Namespace) -> Answer:
    table = read_trial_table(chosen.source) if chosen.source else run_grid(chosen.size, chosen.workers)
    if chosen.out:
        table.write(chosen.out)
    return study_tables(table), requirements(table.rows, allow_chance=table.origin["size"] != "full")


OPTIONS = {"--size": {**SIZE, "default": "full"}, "--workers": WORKERS, "--out": OUT, "--from": FINISHED}
main = StudyCommand("validation.flight_recipe.study", __doc__, PART, answer, OPTIONS).main

if __name__ == "__main__":
    sys.exit(main())
