"""Rows of a fleet's table that are pooled, in the order of types, vehicles and time, and what is left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from eivor.fleets.table import COPY, DIAGNOSTIC, FAILED
from eivor.flights.across import AcrossFlights, Covariate
from eivor.flights.motion import Motion
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.quantiles import normal_quantile
from eivor.inference.random_effects.groups import Groups
from eivor.inference.verdict import Status

#: Type of a flight whose type is not known, and what stands before the name of a log that has no vehicle.
UNKNOWN, LOG = "unknown", "log "
HOUR_S = 3600.0
#: Columns by which rows belong together.
VEHICLE = ("type", "vehicle")
#: Columns of ordered rows: with which vehicles a vehicle is pooled, which is its type where both are known
#: and the vehicle alone elsewhere; and whether the log has no vehicle.
TOGETHER, SINGLE = "together", "single"
#: Column of rows of a quantity: whether it is a share, below `AcrossFlights.largest`.
SHARE = "is_share"
#: Why rows are left out, in this order.
NO_RESULT, NO_NUMBER, NO_REFERENCE, NOT_EXCITED, NOT_POSITIVE = (
    "the log gave no result",
    "the flight tells no value with a standard error",
    "no reference: the value may be biased more than its interval says",
    f"too little excitation: a first-stage F below {STRONG_FIRST_STAGE:.0f}",
    "not positive",
)
#: What a share is above that is left out.
NOT_BELOW = "not below {:g}, the largest share"


def across_of(motion: Motion[Any], further: Sequence[str] = ()) -> tuple[AcrossFlights, ...]:
    """What a motion compares over flights; its headline as it is where it says nothing.

    Parameters
    ----------
    motion : Motion
        Which.
    further : sequence of str
        Columns of covariates that are given, of whose slopes nothing is known where the motion says nothing.
    """
    quantities = motion.across or tuple(AcrossFlights(name, told_by=(name,)) for name in motion.headline)
    return tuple(
        replace(
            one, covariates=(*one.covariates, *(Covariate(name) for name in further if not _goes(one, name)))
        )
        for one in quantities
    )


def _goes(across: AcrossFlights, name: str) -> bool:
    return any(one.name == name for one in across.covariates)


def wanted_columns(across: Sequence[AcrossFlights]) -> list[str]:
    """Columns of a fleet's table that its report reads."""
    numbers = [
        f"{one.name}.{part}" for one in across for part in ("value", "std_error", "low", "high", "verdict")
    ]
    told = [f"{DIAGNOSTIC}first_stage_F_{name}" for one in across for name in one.told_by]
    about = ["sha256", "name", "motion", *VEHICLE, "start", "duration_s", "verdict"]
    return list(
        dict.fromkeys([*about, *numbers, *told, *(with_.name for one in across for with_ in one.covariates)])
    )


def in_order(table: pl.DataFrame) -> pl.DataFrame:
    """Rows by type, vehicle and time, without copies, with the hours flown before the middle of each flight.

    A log without a vehicle is a vehicle of its own, named after the log: two such logs may be of one vehicle
    or of two, so that neither its flights nor its type are pooled.

    Parameters
    ----------
    table : polars.DataFrame
        Rows of one motion.
    """
    duration = pl.col("duration_s").fill_null(0.0)
    kind, vehicle = (pl.col(name).cast(pl.String) for name in VEHICLE)
    earlier = pl.when(pl.col("name").is_duplicated()).then(pl.format(" {}", pl.col("sha256").str.head(12)))
    log = pl.concat_str(pl.lit(LOG), "name", earlier.fill_null(""))  # of a log that changed
    own = pl.concat_str(pl.col("type"), pl.lit("\n"), pl.col("vehicle"))
    return (
        table.filter(pl.col("verdict") != COPY)
        .with_columns(
            kind.fill_null(UNKNOWN),
            vehicle.fill_null(log),
            vehicle.is_null().alias(SINGLE),
            (kind.is_null() | vehicle.is_null()).alias(TOGETHER),
        )
        .sort(SINGLE, "type", TOGETHER, "vehicle", "start", "name", nulls_last=True)
        .with_columns(pl.when(TOGETHER).then(own).otherwise("type").alias(TOGETHER))
        .with_columns(((duration.cum_sum() - 0.5 * duration) / HOUR_S).over(VEHICLE).alias("hours"))
    )


def why_left_out(across: AcrossFlights, columns: Sequence[str]) -> pl.Expr:
    """Why a row does not say anything of a quantity; null where it does.

    Parameters
    ----------
    across : AcrossFlights
        The quantity.
    columns : sequence of str
        Of the table.
    """
    value, error = pl.col(f"{across.name}.value"), _error(across)
    told = [f"{DIAGNOSTIC}first_stage_F_{name}" for name in across.told_by]
    weak = pl.any_horizontal(
        [pl.lit(False), *(pl.col(name) < STRONG_FIRST_STAGE for name in told if name in columns)]
    )
    provisional = pl.col(f"{across.name}.verdict").cast(pl.String) == Status.PROVISIONAL.value
    return (
        pl.when(pl.col("verdict") == FAILED)
        .then(pl.lit(NO_RESULT))
        .when(value.is_null() | error.is_null() | (error <= 0.0))
        .then(pl.lit(NO_NUMBER))
        .when(provisional)
        .then(pl.lit(NO_REFERENCE))
        .when(weak)
        .then(pl.lit(NOT_EXCITED))
        .when((value <= 0.0) & across.logarithm)
        .then(pl.lit(NOT_POSITIVE))
        .when(pl.col(SHARE) & (value >= across.largest))
        .then(pl.lit(NOT_BELOW.format(across.largest)))
        .otherwise(None)
    )


def is_share(across: AcrossFlights) -> pl.Expr:
    """`SHARE` of ordered rows: whether half of the positive values of those that are pooled are below it."""
    value = pl.col(f"{across.name}.value")
    share = value.filter(value > 0.0).median().over(TOGETHER) < across.largest
    return (share.fill_null(value=False) & math.isfinite(across.largest)).alias(SHARE)


def compared(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """The number of which changes are compared, and its variance."""
    value, error = pl.col(f"{across.name}.value"), _error(across)
    return (value.log(), (error / value) ** 2) if across.logarithm else (value, error**2)


def pooled(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """The number that is pooled, and its variance: as `compared`, of a share its logit."""
    y, v = compared(across)
    left = across.largest - pl.col(f"{across.name}.value")
    return (
        pl.when(SHARE).then(y - left.log()).otherwise(y),
        pl.when(SHARE).then(v * (across.largest / left) ** 2).otherwise(v),
    )


def own_interval(across: AcrossFlights) -> tuple[pl.Expr, pl.Expr]:
    """`low` and `high` that a flight tells by itself, or by its standard error; within the bounds."""
    reach = normal_quantile(0.95) * _error(across)
    low, high = (
        pl.coalesce(
            pl.col(f"{across.name}.{end}").fill_nan(None), pl.col(f"{across.name}.value") + sign * reach
        ).alias(end)
        for end, sign in (("low", -1.0), ("high", 1.0))
    )
    if across.logarithm:
        top = pl.when(SHARE).then(across.largest).otherwise(math.inf)
        low, high = low.clip(lower_bound=0.0), pl.min_horizontal(high, top).alias("high")
    return low, high


def _error(across: AcrossFlights) -> pl.Expr:
    """Standard error, or that of an interval where there is none."""
    half = 0.5 * (pl.col(f"{across.name}.high") - pl.col(f"{across.name}.low"))
    return pl.coalesce(pl.col(f"{across.name}.std_error"), half / normal_quantile(0.95))


def groups_of(rows: pl.DataFrame, *by: str) -> tuple[pl.DataFrame, Groups]:
    """Groups of rows that stand together already, with what they go by."""
    begins = [pl.col(name).ne_missing(pl.col(name).shift()) for name in by]
    first = rows.select(pl.any_horizontal(begins) | (pl.int_range(pl.len()) == 0)).to_series().arg_true()
    ends = np.append(first.to_numpy()[1:], rows.height)
    return rows.select(by)[first], Groups((ends - first.to_numpy()).astype(np.int64))
