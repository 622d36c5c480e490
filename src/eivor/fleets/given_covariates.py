"""What users know of flights and logs do not: a table such as `name,mass`, by which changes are explained."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from eivor.errors import InputError

#: Columns by which rows belong to flights: the first that is there.
KEYS = ("sha256", "name")


def given_covariates(file: Path) -> pl.DataFrame:
    """Read a table of covariates.

    Parameters
    ----------
    file : Path
        CSV with a row for each flight: `sha256` or `name` as in the fleet's table, and columns of numbers.
        Those that are no numbers are left out.

    Returns
    -------
    polars.DataFrame
        One of `KEYS`, and the columns of numbers.

    Raises
    ------
    InputError
        When it cannot be read, names no flights, names one twice, or has no numbers.
    """
    try:
        table = pl.read_csv(file, infer_schema_length=None)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(
            f"a CSV of covariates in '{file}'", f"{type(error).__name__}: {error}", "Check the path."
        ) from error
    key = next((name for name in KEYS if name in table.columns), None)
    numbers = [name for name, kind in table.schema.items() if kind.is_numeric() and name != key]
    if key is None or not numbers:
        raise InputError(
            f"a column {' or '.join(KEYS)}, and columns of numbers",
            f"'{file}' with the columns {', '.join(table.columns)}",
            "Write a table such as name,mass with a row for each flight.",
        )
    told = table.select(pl.col(key).cast(pl.String), pl.col(numbers).cast(pl.Float64)).drop_nulls(key)
    if told[key].n_unique() < told.height:
        twice = told.filter(told[key].is_duplicated())[key][0]
        raise InputError("every flight once", f"'{twice}' twice in '{file}'", "Leave one of its rows out.")
    return told


def with_covariates(table: pl.DataFrame, given: pl.DataFrame) -> pl.DataFrame:
    """Rows of a fleet with what is given of them, in place of what is logged where both are there.

    Raises
    ------
    InputError
        When it is given of no flight of the fleet, or of a column that is no covariate.
    """
    key, *names = given.columns
    taken = [name for name in names if name in table.columns and not table.schema[name].is_numeric()]
    if taken or any("." in name for name in names):
        raise InputError(
            "names of covariates, such as mass",
            f"{', '.join(taken or names)}, which are columns of the fleet's own",
            "Give these columns other names.",
        )
    if not table[key].is_in(given[key].to_list()).any():
        raise InputError(
            f"covariates of flights of the fleet, by their {key}",
            f"none of {given.height} rows is of one",
            "Compare with the output of eivor fleet query FLEET QUANTITY --csv FILE.",
        )
    joined = table.join(given, on=key, how="left", suffix=".given", maintain_order="left")
    both = [name for name in names if f"{name}.given" in joined.columns]
    return joined.with_columns(pl.coalesce(f"{name}.given", name).alias(name) for name in both).drop(
        f"{name}.given" for name in both
    )
