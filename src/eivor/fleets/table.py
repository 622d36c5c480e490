"""The table of a fleet's flights: one row for each log and motion, in Parquet files that every reader takes.

    fleet/flights/part-*.parquet

| column | what |
|---|---|
| `sha256` | hash of the log's bytes; null of one that could not be opened |
| `name` | path of the log, from the folder that was given |
| `copy_of` | of a copy the hash that it shares with the first log of these bytes, whose row has the numbers |
| `vehicle`, `type` | which vehicle (its board's id) and which kind (its airframe), or what the user says |
| `motion` | what was identified |
| `firmware` | name and version |
| `start` | first second of the log, UTC; null where it does not know the time |
| `duration_s` | from the first to the last stamp |
| `verdict` | identified, weak, provisional, refused; `FAILED` of a log without a result, `COPY` of a copy |
| `reason` | in sentences: why no better |
| `Q.value`, `Q.std_error`, `Q.low`, `Q.high`, `Q.verdict` | of every quantity Q, in SI units, 95 % |
| `covariance`, `covariance_names` | joint covariance at the best candidate, row by row, and its names |
| `diagnostic.NAME` | every diagnostic of the result |
| `battery_voltage`, `temperature`, `air_density` | means over the log in V, degrees Celsius and kg/m^3 |
| `eivor_version`, `options_hash` | what made the row |

What is not known, and what is no finite number, is null. Which quantities there are follows from the motion:
a part has the rows of one motion and the columns of that motion, so readers put parts together by the names
of their columns (`union_by_name` in DuckDB); columns that a part does not have are null.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import polars as pl

from eivor.errors import InputError

#: Folder of the parts, and how they are called.
FLIGHTS, PART = "flights", "part-*.parquet"
#: Verdicts of rows without a result, beside those of `eivor.inference.verdict.Status`.
FAILED, COPY = "failed", "copy"
#: Columns of a quantity, after its name and a dot.
NUMBERS, VERDICT = ("value", "std_error", "low", "high"), "verdict"
#: Before the name of a diagnostic.
DIAGNOSTIC = "diagnostic."

#: Columns before those of the quantities, and after them.
LEADING: Mapping[str, Any] = {
    **dict.fromkeys(("sha256", "name", "copy_of", "vehicle", "type", "motion", "firmware"), pl.String()),
    "start": pl.Datetime("us", "UTC"),
    "duration_s": pl.Float64(),
    "verdict": pl.String(),
    "reason": pl.String(),
}
TRAILING: Mapping[str, Any] = {
    "covariance": pl.List(pl.Float64()),
    "covariance_names": pl.List(pl.String()),
    **dict.fromkeys(("battery_voltage", "temperature", "air_density"), pl.Float64()),
    "eivor_version": pl.String(),
    "options_hash": pl.String(),
}
#: By which rows are sorted: a log has one row for each motion.
ORDER = ("motion", "name", "sha256")

Row = Mapping[str, Any]


def flight_frame(rows: Sequence[Row]) -> pl.DataFrame:
    """Rows as a table: every column that all fleets have, and those that these rows bring.

    Parameters
    ----------
    rows : sequence of mapping
        Values by column; what a row does not name, and numbers that are not finite, are null.
    """
    own = {name for row in rows for name in row if name not in LEADING and name not in TRAILING}
    schema = {name: LEADING.get(name) or TRAILING.get(name) or _type(name) for name in _in_order(own)}
    known = [{name: _known(row.get(name)) for name in schema} for row in rows]
    # a hundred columns of few rows: at once, which is three times as quick as one after the other
    return pl.from_dicts(known, schema=schema).sort(ORDER, nulls_last=True)


def _in_order(own: set[str]) -> list[str]:
    """Every column that all fleets have, quantities by their names between them, diagnostics at the end."""
    parts = {part: place for place, part in enumerate((*NUMBERS, VERDICT))}

    def place(name: str) -> tuple[str, int]:
        quantity, _, part = name.rpartition(".")
        return quantity, parts.get(part, len(parts))

    diagnostics = sorted(name for name in own if name.startswith(DIAGNOSTIC))
    return [*LEADING, *sorted(own.difference(diagnostics), key=place), *TRAILING, *diagnostics]


def _type(name: str) -> Any:
    return pl.String() if name.endswith(f".{VERDICT}") else pl.Float64()


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def part_files(folder: Path) -> list[Path]:
    """Parts of a fleet, in the order of their names."""
    return sorted((folder / FLIGHTS).glob(PART))


def read_flights(folder: Path, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Table of all rows of a fleet, sorted by `ORDER`.

    Parameters
    ----------
    folder : Path
        That `eivor fleet run` made.
    columns : sequence of str, optional
        Those that are read, default all; null where no part has one.

    Raises
    ------
    InputError
        When there is no such table, or it cannot be read.
    """
    parts = _parts(folder, None if columns is None else {*columns, *ORDER})
    table = pl.concat(parts, how="diagonal", rechunk=True)
    if columns is not None:
        absent = [name for name in columns if name not in table.columns]
        table = table.with_columns(pl.lit(None, pl.Float64).alias(name) for name in absent)
    if columns is None:
        columns = _in_order({name for name in table.columns if name not in LEADING and name not in TRAILING})
    return table.sort(ORDER, nulls_last=True).select(columns)


def motions_there(folder: Path) -> list[str]:
    """Motions of which a fleet has rows, sorted by name; raises as `read_flights` does."""
    found = (part["motion"].drop_nulls().unique().to_list() for part in _parts(folder, {"motion"}))
    return sorted({name for names in found for name in names})


def _parts(folder: Path, columns: Set[str] | None) -> list[pl.DataFrame]:
    files = part_files(folder)
    if not files:
        raise InputError(
            "the folder of a fleet, with its table of flights",
            f"'{folder}', which has no {FLIGHTS}/{PART}",
            "Make one: eivor fleet run LOGS -o FOLDER.",
        )
    try:
        return [_part(file, columns) for file in files]
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(
            f"a table of flights in '{folder}' that can be read",
            f"{type(error).__name__}: {error}",
            "Run `eivor fleet run` on it again, which sets damaged parts aside and makes them anew.",
        ) from error


def _part(file: Path, columns: Set[str] | None) -> pl.DataFrame:
    """Those of some columns that a part has; no key of another folder is read as a column."""
    content = pl.scan_parquet(file, hive_partitioning=False)
    if columns is None:
        return content.collect()
    there = content.collect_schema().names()
    return content.select([name for name in there if name in columns]).collect()


def quantity_names(table: pl.DataFrame) -> list[str]:
    """Quantities that a table of flights has columns of, in their order."""
    ending = f".{VERDICT}"
    return [name.removesuffix(ending) for name in table.columns if name.endswith(ending)]
