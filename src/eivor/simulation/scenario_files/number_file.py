"""A user's own numbers: a column of a CSV or Parquet file that stands beside a scenario.

    values = { file = "input.csv", column = "u" }

The file is looked for beside the scenario, or in a folder below it, and nowhere else: a scenario that
somebody sent can read what came with it. What a study depends on is the numbers, not the file's name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eivor.errors import did_you_mean
from eivor.toml_table import LARGEST_NUMBER, TomlTable

if TYPE_CHECKING:
    import polars as pl

#: Endings of files that can be read.
FORMATS = (".csv", ".parquet")
#: Larger files, and longer columns, are no excitation: they would be held whole in every process.
LARGEST_BYTES, MOST_NUMBERS = 200_000_000, 10_000_000


def numbers_in_file(table: TomlTable) -> tuple[float, ...]:
    """Numbers of a table ``{ file = ..., column = ... }``.

    Parameters
    ----------
    table : TomlTable
        Its two keys; it knows the folder of the scenario.

    Raises
    ------
    InputError
        When a key is missing or unknown, the file is elsewhere or cannot be read, the column does not
        exist, or one of its values is no finite number.
    """
    path = _path(table, table.text("file"))
    name = table.text("column")
    table.finish()
    import polars as pl

    column = _column(table, path, name)
    table.files.add(path)
    numbers = column.str.strip_chars().cast(pl.Float64, strict=False) if column.dtype == pl.String else column
    numbers = numbers.cast(pl.Float64, strict=False)
    bad = numbers.is_null() | ~numbers.is_finite() | (numbers.abs() > LARGEST_NUMBER)
    if bad.any():
        row = bad.arg_max()
        value = column[row] if row is not None else None
        raise table.wrong(
            "column",
            f"finite numbers in column '{name}' of {path.name}, up to {LARGEST_NUMBER:g} in size",
            "no value" if value is None else repr(value)[:60],
            f"See its row {0 if row is None else row + 1}, not counting the header.",
        )
    return tuple(numbers.to_list())


def _path(table: TomlTable, text: str) -> Path:
    """File that a text names, which is inside the folder of the scenario."""
    relative = Path(text)
    inside = not relative.is_absolute() and ".." not in relative.parts
    path = table.folder / relative
    try:
        inside = inside and path.resolve().is_relative_to(table.folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a loop of links, a name that no system has
        inside = False
    if not inside:
        raise table.wrong(
            "file", "a file beside the scenario or in a folder below it", f"'{text}'", "Put it there."
        )
    if path.suffix.lower() not in FORMATS:
        raise table.wrong("file", f"a file that ends in {' or '.join(FORMATS)}", f"'{text}'")
    if not path.is_file():
        raise table.wrong("file", "a file that exists", f"'{text}', which does not", "Check the name.")
    if path.stat().st_size > LARGEST_BYTES:
        raise table.wrong("file", f"a file of {LARGEST_BYTES} bytes or fewer", f"'{text}', larger than that")
    return path


def _column(table: TomlTable, path: Path, name: str) -> pl.Series:
    """Column as it is stored; as texts from CSV, so that what is no number can be shown."""
    import polars as pl

    try:
        if path.suffix.lower() == ".csv":
            lazy = pl.read_csv(path, infer_schema=False).lazy()  # the whole of it: every row is checked
        else:
            lazy = pl.scan_parquet(path, hive_partitioning=False)
        names = lazy.collect_schema().names()
        found = lazy.select(name).head(MOST_NUMBERS + 1).collect()[name] if name in names else None
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise table.wrong(
            "file", f"a table as {path.suffix.lower()[1:].upper()}", f"'{path.name}', which is not: {reason}"
        ) from error
    if found is None:
        remedy = did_you_mean(name, names, "Name one of its columns.")
        shown = ", ".join(names[:20]) or "none"
        raise table.wrong("column", f"a column out of {shown}", f"'{name}', not in {path.name}", remedy)
    if not (found.dtype.is_numeric() or found.dtype == pl.String):
        raise table.wrong("column", f"numbers in column '{name}' of {path.name}", f"values of {found.dtype}")
    if found.len() > MOST_NUMBERS:
        raise table.wrong("column", f"{MOST_NUMBERS} numbers or fewer", "more", "Cut the file.")
    return found
