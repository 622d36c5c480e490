"""Delimited text: one line of column names, then one line per instant.

The lines are counted and checked before they are converted, so that a ragged or damaged table is told
by its line and never filled up in silence. The delimiter is the one that splits the header most often
(comma, semicolon, tab, bar); with semicolons, decimal commas are understood.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError, UnknownFormatError
from eivor.logs.sniff import DELIMITERS
from eivor.logs.table_source import MAX_COLUMNS, Columns, TableSource, corrupt_table
from eivor.signals.recording import Finding

if TYPE_CHECKING:
    import polars as pl

MAX_LINE_BYTES = 1 << 20
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+")
_NO_VALUE = ("", "na", "n/a", "null", "none", "-", "--")
_WORDS = {"true": "1", "false": "0"}


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the lines are made: where the rows begin, how many there are, and what splits them."""

    names: tuple[str, ...]
    delimiter: str
    header_lines: int
    rows: int
    decimal_comma: bool = False
    cut: bool = False
    trailing: bool = False


def open_csv(file: Path) -> TableSource:
    """Check the lines of a delimited text and name its columns.

    Raises
    ------
    CorruptLogError
        When a line is too long, holds NUL bytes, or has another number of fields than the header.
    EmptyLogError
        When there is a header only.
    UnknownFormatError
        When there is no line of column names.
    """
    try:
        with file.open("rb") as stream:
            layout = _layout(stream, file.name)
    except OSError as error:
        raise corrupt_table(file.name, f"which cannot be read: {error}", "Copy it again.") from error
    findings = []
    if layout.cut:
        findings.append(Finding("truncated", "The last line is incomplete; it was left out."))

    def read(columns: Sequence[str]) -> Columns:
        return _read(file, layout, columns)

    return TableSource(layout.names, read, tuple(findings))


def _line(stream: BinaryIO, number: int, name: str) -> bytes:
    line = stream.readline(MAX_LINE_BYTES + 1)
    if len(line) > MAX_LINE_BYTES:
        raise corrupt_table(
            name, f"whose line {number} is longer than {MAX_LINE_BYTES} bytes", "Check that it is a table."
        )
    if b"\x00" in line:
        raise corrupt_table(
            name,
            f"with NUL bytes in line {number}",
            "A power cut leaves them; remove the lines that hold them.",
        )
    return line


def _fields(line: str, delimiter: str, number: int, name: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=False), [])
    except csv.Error as error:
        raise corrupt_table(name, f"whose line {number} cannot be split: {error}", "Correct it.") from error


def _layout(stream: BinaryIO, name: str) -> _Layout:
    """Read the header, then count and check the rows."""
    number, line = 1, _line(stream, 1, name)
    while line and not line.strip():
        number, line = number + 1, _line(stream, number + 1, name)
    header = line.decode("utf-8-sig", "replace").rstrip("\r\n")
    delimiter = max(DELIMITERS, key=header.count)
    names = [field.strip() for field in _fields(header, delimiter, number, name)]
    if len(names) > MAX_COLUMNS:
        raise corrupt_table(
            name, f"with {len(names)} columns", f"At most {MAX_COLUMNS} are read; cut the table."
        )
    if names and all(_is_number(field) for field in names):
        raise UnknownFormatError(
            "a table whose first line holds the names of the columns",
            f"'{name}', whose first line holds numbers only",
            "Put a line of column names on top.",
        )
    layout = _check_rows(stream, _Layout(tuple(names), delimiter, number, 0), name)
    if layout.rows == 0:
        raise EmptyLogError(
            "a table with rows",
            f"'{name}' with a header only",
            "Check that logging was on during the flight.",
        )
    return layout


def _check_rows(stream: BinaryIO, header: _Layout, name: str) -> _Layout:
    """Return the layout with the number of rows (blank ones included), once every line has been checked."""
    mark, width = header.delimiter.encode(), len(header.names)
    number, rows, decimal_comma, trailing = header.header_lines, 0, False, False
    while line := _line(stream, number + 1, name):
        number += 1
        text = line.rstrip(b"\r\n")
        if not text.strip():
            rows += 1
            continue
        count = text.count(mark) + 1
        if b'"' in text:
            count = len(_fields(text.decode("utf-8", "replace"), header.delimiter, number, name))
        if count < width and not line.endswith(b"\n"):
            return replace(header, rows=rows, decimal_comma=decimal_comma, cut=True, trailing=trailing)
        if count == width + 1 and text.endswith(mark):
            trailing = True
        elif count != width:
            raise corrupt_table(
                name,
                f"whose line {number} has {count} fields where the header has {width}",
                "Correct the line, or cut the table before it.",
            )
        if rows == 0 and header.delimiter == ";":
            fields = text.decode("utf-8", "replace").split(header.delimiter)
            decimal_comma = any(_DECIMAL_COMMA.fullmatch(field) for field in fields)
        rows += 1
    return replace(header, rows=rows, decimal_comma=decimal_comma, trailing=trailing)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read(file: Path, layout: _Layout, columns: Sequence[str]) -> Columns:
    """Convert some columns; a cell that is no number becomes NaN and is counted."""
    import polars as pl

    # one column more, for the lines that end with a delimiter
    schema = {f"c{i}": pl.String for i in range(len(layout.names) + layout.trailing)}
    position = {name: f"c{i}" for i, name in reversed(list(enumerate(layout.names)))}
    try:
        frame = (
            pl.scan_csv(
                file.resolve(),
                has_header=False,
                separator=layout.delimiter,
                skip_lines=layout.header_lines,
                n_rows=layout.rows,
                schema=schema,
                glob=False,
            )
            .select([pl.col(position[name]).alias(name) for name in columns])
            .collect()
        )
        values, unreadable = {}, {}
        for name in columns:
            values[name], unreadable[name] = _numbers(frame[name], decimal_comma=layout.decimal_comma)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise _unreadable(file, error) from error
    return Columns(values, {name: count for name, count in unreadable.items() if count})


def _numbers(texts: pl.Series, *, decimal_comma: bool) -> tuple[np.ndarray, int]:
    import polars as pl

    trimmed = texts.str.strip_chars()
    if decimal_comma:
        trimmed = trimmed.str.replace(",", ".", literal=True)
    numbers = trimmed.cast(pl.Float64, strict=False)
    if numbers.null_count() == 0:
        return numbers.to_numpy().copy(), 0
    words = trimmed.str.to_lowercase().replace(_WORDS)
    numbers = numbers.fill_null(words.cast(pl.Float64, strict=False))
    bad = numbers.is_null() & words.is_not_null() & ~words.is_in(_NO_VALUE)
    return numbers.fill_null(np.nan).to_numpy().copy(), int(bad.sum())


def _unreadable(file: Path, error: BaseException) -> CorruptLogError:
    return corrupt_table(
        file.name, f"which cannot be converted: {error}", "Check the table's encoding (UTF-8)."
    )
