"""The flight study as Markdown: tables made from its trials, put into a page between two marks."""

from __future__ import annotations

import numpy as np
import polars as pl

from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import BEYOND_DOUBT
from eivor.inference.verdict import Status
from eivor.lab.experiments import markdown
from validation.flight_recipe.metrics import Score, accepted, accepted_share, flown, score
from validation.flight_recipe.requirements import error_text, requirements, share_text
from validation.flight_recipe.trial_table import PACKAGES, TrialTable
from validation.flight_recipe.trials import LAG_IGNORED, NONLINEAR, QUANTITIES, RECIPE

#: Name of the generated part of the page.
PART = "flight study"
COMMAND = "python -m validation.flight_recipe.study"
ESTIMATOR_NAMES = {RECIPE: "the recipe", LAG_IGNORED: "lag ignored", NONLINEAR: "nonlinear least squares"}
#: Lags that count as one group [s]; the grid of the recipe has steps of 10 ms.
LAG_EDGES = (0.01, 0.025, 0.06)
LAG_BANDS = ("below 10 ms", "10 to 25 ms", "25 to 60 ms", "60 ms and more")


def study_tables(table: TrialTable) -> str:
    """All tables of a run, as Markdown."""
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
            requirement_table(rows, allow_chance=origin["size"] != "full"),
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


def requirement_table(rows: pl.DataFrame, *, allow_chance: bool) -> str:
    """One row for each requirement."""
    lines = [
        (item.what, item.asked, item.measured, "yes" if item.met else "**no**")
        for item in requirements(rows, allow_chance=allow_chance)
    ]
    return markdown(("what", "asked", "measured", "met"), lines)


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
                *_errors("viscous_friction", friction, bias=True),
                *_errors("input_gain", gain),
                *_errors("effective_lag", lag),
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
    """The recipe beside the controls, calm and gusty."""
    excited = rows.filter(pl.col("kind") == "excited")
    lines = []
    for label, part in (
        ("calm", excited.filter(pl.col("calm"))),
        ("gusty", excited.filter(~pl.col("calm"))),
    ):
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
    """Coverage by noise, trajectory, lag, delay, gusts and simulator."""
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


def _errors(quantity: str, result: Score, *, bias: bool = False) -> list[str]:
    if not result.coverage.count:
        return ["-"] * (4 if bias else 3)
    displayed = [result.median, result.ninetieth, *([result.bias] if bias else [])]
    return [*(error_text(quantity, value) for value in displayed), _covered(result)]


def _covered(result: Score) -> str:
    return f"{result.coverage.value:.3f}" if result.coverage.count else "-"
