"""Lists of logs: a text with a path in each line, or a table with a column `path`. Read line by line."""

from __future__ import annotations

import csv
import os
from collections.abc import Generator, Iterator
from pathlib import Path, PurePosixPath

from eivor.errors import InputError, UsageError
from eivor.fleets.log_list import Log
from eivor.logs.table.formats import DELIMITERS

#: Ends of the names of lists, and the column of paths in a list that is a table.
LINES, TABLE, PATH_COLUMN = ".txt", ".csv", "path"
#: More bytes than a line of column names has.
HEADER_BYTES = 1 << 16


def is_list(path: Path) -> bool:
    """Whether a file is a list of logs, and not a log itself; raises OSError where it cannot be opened."""
    return path.suffix.lower() == LINES or _delimiter(path) != ""


def listed(path: Path) -> Generator[Log, None, None]:
    """Logs of a list, in its order; their paths are from its folder.

    Raises
    ------
    InputError
        When a line of a table has more or fewer columns than its first.
    UsageError
        When two columns have one name.
    UnicodeDecodeError
        When it is no text.
    OSError
        When it cannot be read.
    """
    rows = _lines(path) if path.suffix.lower() == LINES else _rows(path, _delimiter(path))
    for row in rows:
        name = row.pop(PATH_COLUMN)
        if name:
            called = PurePosixPath(name.replace(os.sep, "/")).as_posix()
            yield named_log(str(path.parent / name), called, row)


def named_log(path: str, name: str, told: dict[str, str] | None = None) -> Log:
    """A log by its path, whose name becomes text that can be written."""
    return Log(path, name.encode("utf-8", "backslashreplace").decode("utf-8"), told or {})


def _lines(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8-sig") as lines:
        for line in lines:
            if not line.startswith("#"):
                yield {PATH_COLUMN: line.strip()}


def _delimiter(path: Path) -> str:
    """What separates the columns of a table that is a list; empty for any other file."""
    if path.suffix.lower() != TABLE:
        return ""
    with path.open("rb") as stream:
        line = stream.readline(HEADER_BYTES)
    try:
        header = line.decode("utf-8-sig")
        delimiter = max(DELIMITERS, key=header.count)
        return delimiter if PATH_COLUMN in next(csv.reader([header], delimiter=delimiter), ()) else ""
    except (UnicodeDecodeError, csv.Error):
        return ""


def _rows(path: Path, delimiter: str) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        rows = csv.reader(stream, delimiter=delimiter, strict=True)
        header = next(rows)
        if len(set(header)) < len(header):
            raise UsageError(
                "a list whose columns have different names",
                f"'{path}', with {', '.join(header)}",
                "Rename those that are alike.",
            )
        try:
            for row in rows:
                if row and len(row) != len(header):
                    raise InputError(
                        f"{len(header)} columns in each line of '{path}', as in its first",
                        f"{len(row)} in line {rows.line_num}",
                        "Correct the line.",
                    )
                if row:
                    yield dict(zip(header, row, strict=True))
        except csv.Error as error:
            raise InputError(
                f"a table of logs '{path}' that can be read",
                f"line {rows.line_num}: {error}",
                "Correct the line.",
            ) from error
