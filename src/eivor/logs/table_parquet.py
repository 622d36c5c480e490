"""Parquet tables: numbers, logical values, and points in time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eivor.errors import EmptyLogError, LogTooLargeError
from eivor.logs.parquet_probe import probe_parquet
from eivor.logs.table_source import MAX_COLUMNS, Columns, TableSource, corrupt_table

if TYPE_CHECKING:
    import polars as pl

#: Most rows that are read: a Parquet file may say much more than its size holds.
MAX_ROWS = 50_000_000
#: Most numbers that are converted, 1.6 GB of them.
MAX_CELLS = 200_000_000
#: Key of the file's metadata under which `write_recording` keeps what is not a number.
METADATA_KEY = "eivor"
_DAMAGED = "The file is damaged or incomplete; write it again."


def open_parquet(file: Path) -> TableSource:
    """Read the footer of a Parquet file.

    Raises
    ------
    CorruptLogError
        When the footer cannot be read.
    EmptyLogError
        When there are no rows.
    LogTooLargeError
        When the footer states more rows than `MAX_ROWS`.
    """
    import polars as pl

    probe_parquet(file, MAX_ROWS)
    try:
        frame = pl.scan_parquet(file.resolve(), glob=False, hive_partitioning=False)
        schema = frame.collect_schema()
        rows = int(frame.select(pl.len()).collect().item())
        metadata = pl.read_parquet_metadata(file.resolve())
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise corrupt_table(file.name, f"whose Parquet footer cannot be read: {error}", _DAMAGED) from error
    if len(schema) > MAX_COLUMNS:
        raise corrupt_table(
            file.name, f"with {len(schema)} columns", f"At most {MAX_COLUMNS} are read; select some."
        )
    if rows == 0:
        raise EmptyLogError("a table with rows", f"'{file.name}' without one", "Check the export.")
    if rows > MAX_ROWS:
        raise LogTooLargeError(
            f"at most {MAX_ROWS} rows",
            f"'{file.name}' with {rows}",
            "Cut the log to the manoeuvre of interest.",
        )

    def read(columns: Sequence[str]) -> Columns:
        return _read(file, frame, columns, rows)

    return TableSource(tuple(schema), read, (), metadata.get(METADATA_KEY, ""))


def _read(file: Path, frame: pl.LazyFrame, columns: Sequence[str], rows: int) -> Columns:
    import polars as pl

    if rows * len(columns) > MAX_CELLS:
        raise LogTooLargeError(
            f"at most {MAX_CELLS} numbers",
            f"'{file.name}' with {rows} rows of {len(columns)} needed columns",
            "Cut the log to the manoeuvre of interest.",
        )
    try:
        table = frame.select([pl.col(name) for name in columns]).head(rows).collect()
        converted = {name: _numbers(table[name]) for name in columns}
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise corrupt_table(file.name, f"whose pages cannot be read: {error}", _DAMAGED) from error
    return Columns(
        {name: values for name, (values, _, _) in converted.items()},
        {name: count for name, (_, count, _) in converted.items() if count},
        frozenset(name for name, (_, _, seconds) in converted.items() if seconds),
    )


def _numbers(series: pl.Series) -> tuple[np.ndarray, int, bool]:
    """Numbers of a column, the count of cells that are none, and whether they are seconds now."""
    import polars as pl

    seconds = series.dtype in (pl.Datetime, pl.Duration)
    if seconds:
        unit = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[str(getattr(series.dtype, "time_unit", "us"))]
        numbers = series.to_physical().cast(pl.Float64) * unit
    elif series.dtype.is_numeric() or series.dtype in (pl.Boolean, pl.Null):
        numbers = series.cast(pl.Float64)
    elif series.dtype == pl.String:
        numbers = series.str.strip_chars().cast(pl.Float64, strict=False)
    else:
        return np.full(len(series), np.nan), len(series), False
    bad = int((numbers.is_null() & series.is_not_null()).sum())
    return numbers.fill_null(np.nan).to_numpy().copy(), bad, seconds
