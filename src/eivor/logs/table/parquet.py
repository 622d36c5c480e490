"""Parquet tables: numbers, logical values, and points in time.

Only the columns that are needed are decoded, one after the other, so that memory is that of their numbers
and of one column as the file has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError, LogTooLargeError
from eivor.logs.columns import Columns
from eivor.logs.elements import element_of
from eivor.logs.table.parquet_probe import exactly, probe_parquet
from eivor.logs.table.source import MAX_COLUMNS, TableSource, corrupt_table

if TYPE_CHECKING:
    import polars as pl

#: Most rows that are read: a Parquet file may say much more than its size holds.
MAX_ROWS = 50_000_000
#: Most numbers that are converted, 0.8 GB of them.
MAX_CELLS = 100_000_000
#: Most numbers for each byte of a file, and those that are free: a flight does not repeat itself more often.
MAX_CELLS_PER_BYTE = 25
FREE_CELLS = 10_000_000
#: Memory that the decoding of one column may take [bytes]: for the decoder itself, and for each row.
DECODER_BYTES = 512 << 20
ROW_BYTES = 64
#: Key of the file's metadata under which `write_recording` keeps what is not a number.
METADATA_KEY = "eivor"
_DAMAGED = "The file is damaged or incomplete; write it again."
_CUT = "Cut the log to the manoeuvre of interest."


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

    try:
        frame = pl.scan_parquet(file.resolve(), glob=False, hive_partitioning=False)
        schema = frame.collect_schema()
        rows = int(frame.select(pl.len()).collect().item())
        metadata = pl.read_parquet_metadata(file.resolve())
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise _unreadable(file, error) from error
    if len(schema) > MAX_COLUMNS:
        raise corrupt_table(
            file.name, f"with {len(schema)} columns", f"At most {MAX_COLUMNS} are read; select some."
        )
    if rows == 0:
        raise EmptyLogError("a table with rows", f"'{file.name}' without one", "Check the export.")
    if rows > MAX_ROWS:
        raise LogTooLargeError(f"at most {MAX_ROWS} rows", f"'{file.name}' with {rows}", _CUT)

    def read(columns: Sequence[str]) -> Columns:
        return _read(file, frame, schema, columns, rows)

    return TableSource(tuple(schema), read, (), metadata.get(METADATA_KEY, ""))


def _unreadable(file: Path, error: BaseException) -> CorruptLogError:
    return corrupt_table(file.name, f"a Parquet file that cannot be decoded: {error}", _DAMAGED)


def _read(file: Path, frame: pl.LazyFrame, schema: pl.Schema, columns: Sequence[str], rows: int) -> Columns:
    """Decode columns; those that hold no numbers (lists, structures, bytes) are not touched."""
    import polars as pl

    elements = {name: found for name in columns if (found := element_of(name, list(schema))) is not None}
    base = {name: elements[name][0] if name in elements else name for name in columns}
    held = [
        name
        for name in columns
        if (_holds_lists(schema[base[name]]) if name in elements else _holds_numbers(schema[name]))
    ]
    _check_size(file, rows, len(columns))
    values, unreadable, seconds, lists = {}, {}, set(), {}
    if not _comes_with_eivor(file):
        probe_parquet(file, [*dict.fromkeys(base[name] for name in held)], DECODER_BYTES + ROW_BYTES * rows)
    for name in columns:
        if name not in held:
            values[name], unreadable[name] = np.full(rows, np.nan), rows
            if _holds_lists(schema[base[name]]):
                lists[name] = f"{schema[base[name]]}"
            continue
        try:
            # under a name of our own, as an operation on a series may take its name as a pattern too
            series = frame.select(pl.col(exactly(base[name])).alias("c")).head(rows).collect().to_series()
            if name in elements:
                series = _element(series, elements[name][1])
            values[name], bad = _numbers(series)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
            raise _unreadable(file, error) from error
        if values[name].size != rows:
            raise _unreadable(file, ValueError(f"{values[name].size} values of '{name}' in {rows} rows"))
        unreadable |= {name: bad} if bad else {}
        seconds |= {name} if schema[base[name]] in (pl.Datetime, pl.Duration) else set()
    return Columns(values, unreadable, frozenset(seconds), lists)


def _element(series: pl.Series, index: int) -> pl.Series:
    """One number of each list."""
    import polars as pl

    if series.dtype == pl.Array:
        series = series.arr.to_list()
    return series.list.get(index, null_on_oob=True)


def _holds_lists(kind: pl.DataType) -> bool:
    """Whether it is a type of lists of numbers."""
    import polars as pl

    inner = getattr(kind, "inner", None)
    return kind in (pl.List, pl.Array) and inner is not None and inner.is_numeric()


def _comes_with_eivor(file: Path) -> bool:
    """Whether a file is the package's own: it is known to be whole, and a probe takes a process."""
    return file.resolve().parent == Path(str(resources.files("eivor.data"))).resolve()


def _check_size(file: Path, rows: int, columns: int) -> None:
    """Refuse what the numbers of a file would take, before one is decoded."""
    cells = rows * columns
    counted = f"'{file.name}' with {rows} rows of {columns} needed columns"
    if cells > MAX_CELLS:
        raise LogTooLargeError(f"at most {MAX_CELLS} numbers", counted, _CUT)
    size = file.stat().st_size
    if cells > max(FREE_CELLS, MAX_CELLS_PER_BYTE * size):
        raise LogTooLargeError(
            f"at most {MAX_CELLS_PER_BYTE} numbers for each byte of a Parquet file",
            f"{counted} in {size} bytes",
            "Such a file repeats itself, which no flight does; check what wrote it.",
        )


def _holds_numbers(kind: pl.DataType) -> bool:
    import polars as pl

    return kind.is_numeric() or kind in (pl.Boolean, pl.Null, pl.String, pl.Datetime, pl.Duration)


def _numbers(series: pl.Series) -> tuple[np.ndarray, int]:
    """Numbers of a column, points in time in seconds, and the count of cells that are none."""
    import polars as pl

    missing = series.null_count()
    if series.dtype in (pl.Datetime, pl.Duration):
        unit = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[str(getattr(series.dtype, "time_unit", "us"))]
        series = series.to_physical().cast(pl.Float64) * unit
    elif series.dtype == pl.String:
        series = series.str.strip_chars().cast(pl.Float64, strict=False)
    else:
        series = series.cast(pl.Float64)
    bad = series.null_count() - missing
    return series.fill_null(np.nan).to_numpy().copy(), bad
