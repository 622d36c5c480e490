"""The table of a fleet's flights, for work in Python."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from eivor import checks
from eivor.fleet.table import NUMBERS, VERDICT, quantity_names, read_flights

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Fleet:
    """A fleet that `eivor fleet run` made.

    Parameters
    ----------
    folder : Path
        Where its files are.
    """

    folder: Path

    @cached_property
    def flights(self) -> pl.DataFrame:
        """Every row: one for each log and motion, see `eivor.fleet.table`.

        Raises
        ------
        InputError
            When there is no such table, or it cannot be read.
        """
        return read_flights(self.folder)

    @property
    def quantities(self) -> pl.DataFrame:
        """Every quantity of every flight that has a result, one below the other.

        Returns
        -------
        polars.DataFrame
            `name`, `sha256`, `vehicle`, `type`, `motion`, `start`, `quantity`, `value`, `std_error`, `low`,
            `high` (SI units, 95 %; null where there is no number) and `verdict`.
        """
        import polars as pl

        table = self.flights
        about = ["name", "sha256", "vehicle", "type", "motion", "start"]
        parts = [
            table.filter(pl.col(f"{name}.{VERDICT}").is_not_null()).select(
                *about,
                pl.lit(name).alias("quantity"),
                *(pl.col(f"{name}.{part}").alias(part) for part in (*NUMBERS, VERDICT)),
            )
            for name in quantity_names(table)
        ]
        if parts:
            return pl.concat(parts).sort("motion", "name", "sha256", "quantity", nulls_last=True)
        numbers = dict.fromkeys(NUMBERS, pl.Float64)
        return (
            table.select(about)
            .clear()
            .with_columns(
                pl.lit(None, pl.String).alias("quantity"),
                *(pl.lit(None, kind).alias(name) for name, kind in numbers.items()),
                pl.lit(None, pl.String).alias(VERDICT),
            )
        )


def open(folder: str | PathLike[str]) -> Fleet:
    """Open a fleet.

    Parameters
    ----------
    folder : str or path
        That `eivor fleet run` made.

    Returns
    -------
    Fleet
        Its tables, read when they are first asked for.

    Raises
    ------
    InputError
        When the folder has no table of flights.
    UsageError
        When `folder` is no path.
    """
    checks.path("folder", folder)
    fleet = Fleet(Path(folder))
    read_flights(fleet.folder, ["name"])
    return fleet
