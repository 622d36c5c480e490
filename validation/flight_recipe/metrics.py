"""What the flight study measures: errors, coverage, and the requirements they must meet.

Relative errors for the friction, the gain and the hover input; seconds for the lag. Shares come with the
99 % Wilson interval of their binomial error, so that nobody reads more into them than is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool, Float

from eivor.inference.verdict import Status
from eivor.lab.study_run import Share
from validation.flight_recipe.trials import LOST, RECIPE

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
    """Flights that the recipe calls identified."""
    return rows.filter(pl.col("verdict") == Status.IDENTIFIED.value)


def flown(rows: pl.DataFrame) -> pl.DataFrame:
    """Flights whose vehicle was not lost in the simulator."""
    return rows.filter(pl.col("verdict") != LOST)


def accepted_share(rows: pl.DataFrame) -> Share:
    """Share of the flights flown that are called identified."""
    return Share(accepted(rows).height, flown(rows).height, LEVEL)


def score(rows: pl.DataFrame, quantity: str, estimator: str = RECIPE) -> Score:
    """Errors and coverage over all flights of a table that have an estimate."""
    value, low, high = (
        rows[f"{estimator}.{quantity}.{part}"].to_numpy() for part in ("value", "low", "high")
    )
    truth = rows[f"truth.{quantity}"].to_numpy()
    known = np.isfinite(value) & np.isfinite(truth)
    error = _errors(value[known], truth[known], quantity)
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


def _errors(
    value: Float[np.ndarray, " n"], truth: Float[np.ndarray, " n"], quantity: str
) -> Float[np.ndarray, " n"]:
    return value - truth if quantity == "effective_lag" else value / truth - 1.0


def _share(hits: Bool[np.ndarray, " n"]) -> Share:
    return Share(int(hits.sum()), int(hits.size), LEVEL)
