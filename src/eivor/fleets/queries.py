"""What is asked of a fleet's table again and again, as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import polars as pl

from eivor.errors import UsageError, did_you_mean
from eivor.fleets.table import COPY, FAILED, NUMBERS, VERDICT, quantity_names

#: Seconds of an hour.
HOUR_S = 3600.0


def _verdicts(table: pl.DataFrame) -> pl.DataFrame:
    """How many logs have which verdict."""
    return table.group_by("motion", "verdict").agg(pl.len().alias("logs")).sort("motion", "logs", "verdict")


def _vehicles(table: pl.DataFrame) -> pl.DataFrame:
    """Each vehicle: its logs, those with a result, the hours they hold, days of the first and the last."""
    told = pl.col("verdict").is_in((COPY, FAILED)).not_()
    return (
        table.group_by("motion", "type", "vehicle")
        .agg(
            pl.len().alias("logs"),
            told.sum().alias("told"),
            (pl.col("verdict") == "identified").sum().alias("identified"),
            (pl.col("duration_s").sum() / HOUR_S).alias("hours"),
            pl.col("start").min().dt.date().alias("first"),
            pl.col("start").max().dt.date().alias("last"),
        )
        .sort("motion", "type", "vehicle", nulls_last=True)
    )


def _failed(table: pl.DataFrame) -> pl.DataFrame:
    """Logs without a result, and why."""
    return table.filter(pl.col("verdict") == FAILED).select("motion", "name", "reason")


def _refused(table: pl.DataFrame) -> pl.DataFrame:
    """Flights that were refused, and why."""
    return table.filter(pl.col("verdict") == "refused").select("motion", "name", "reason")


def _copies(table: pl.DataFrame) -> pl.DataFrame:
    """Logs that are copies, and what of."""
    firsts = table.filter(pl.col("verdict") != COPY).select(
        "motion", pl.col("sha256").alias("copy_of"), pl.col("name").alias("first")
    )
    copies = table.filter(pl.col("verdict") == COPY).select("motion", "name", "copy_of")
    return copies.join(firsts, on=["motion", "copy_of"], how="left").select("motion", "name", "first")


#: Queries by name.
QUERIES: Mapping[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
    "verdicts": _verdicts,
    "vehicles": _vehicles,
    "failed": _failed,
    "refused": _refused,
    "copies": _copies,
}


def query(table: pl.DataFrame, what: str) -> pl.DataFrame:
    """Answer of a query.

    Parameters
    ----------
    table : polars.DataFrame
        Rows of a fleet.
    what : str
        A name out of `QUERIES`, or a quantity: its value in every flight, by vehicle and time.

    Raises
    ------
    UsageError
        When it is neither.
    """
    if what in QUERIES:
        return QUERIES[what](table)
    names = quantity_names(table)
    if what not in names:
        raise UsageError(
            f"a query out of {', '.join(QUERIES)}, or a quantity of the fleet ({', '.join(names)})",
            f"'{what}'",
            did_you_mean(what, [*QUERIES, *names], "Name one of them."),
        )
    return (
        table.filter(pl.col(f"{what}.{VERDICT}").is_not_null())
        .sort("motion", "type", "vehicle", "start", "name", nulls_last=True)
        .select(
            "motion",
            "vehicle",
            "start",
            "name",
            *(pl.col(f"{what}.{part}").alias(part) for part in (*NUMBERS, VERDICT)),
        )
    )
