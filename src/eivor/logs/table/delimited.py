"""Delimited tables, formats of tables, and reading in chunks."""

from __future__ import annotations

import codecs
import csv
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import msgspec
import numpy as np

from eivor import checks, errors
from eivor.logs.common import Columns, element_of, noted
from eivor.logs.mapping import known_unit
from eivor.signals.noise import MeasurementNoise
from eivor.signals.recording import Finding
from eivor.signals.signals import Signals

if TYPE_CHECKING:
    import polars as pl


DELIMITERS = (",", ";", "\t", "|")


def is_delimited(text: str) -> bool:
    """Say whether the first line of a text that is not blank holds a delimiter."""
    header = next((line for line in text.splitlines() if line.strip()), "")
    return any(mark in header for mark in DELIMITERS)


CHUNK_ROWS = 1_000_000


def read_chunks(
    path: str | os.PathLike[str],
    *,
    rate_hz: float,
    channels: Mapping[str, str] | None = None,
    noise: Mapping[str, MeasurementNoise] | None = None,
    rows: int = CHUNK_ROWS,
) -> Iterator[Signals]:
    """Read successive stretches of a Parquet table whose rows are samples at a uniform rate.

    Parameters
    ----------
    path : str or Path
        Parquet file.
    rate_hz : float
        Samples per second [Hz].
    channels : mapping of str to str, optional
        Channel to the column that holds it. Default: every column but `time`, under its own name.
    noise : mapping of str to MeasurementNoise, optional
        Declared noises.
    rows : int
        Rows of a chunk; memory is that of one chunk.

    Returns
    -------
    iterator of Signals
        In the order of the file, which is opened when the first is requested.

    Raises
    ------
    InputError
        When the file, or a stretch of it, cannot be read, or a column has no numbers.
    ChannelMapError
        When a column is not in the table.
    UsageError
        At once, when an argument is of another type.
    """
    checks.path("path", path)
    checks.number("rate_hz", rate_hz)
    if channels is not None:
        checks.mapping("channels", channels, str, "columns")
    if noise is not None:
        checks.mapping("noise", noise, MeasurementNoise, "noises")
    checks.counted("rows", rows, 1, "one row or more in a chunk", "A million are the default.")
    return _chunks(path, rate_hz, channels, dict(noise or {}), rows)


def _chunks(
    path: str | os.PathLike[str],
    rate_hz: float,
    channels: Mapping[str, str] | None,
    noise: dict[str, MeasurementNoise],
    rows: int,
) -> Iterator[Signals]:
    import polars as pl

    with polars_errors(partial(_unread_chunk, path)):
        frame = pl.scan_parquet(Path(path))
        available = frame.collect_schema().names()
    wanted = dict(channels) if channels is not None else {name: name for name in available if name != "time"}
    missing = [column for column in wanted.values() if column not in available]
    if missing:
        expected = f"columns out of {', '.join(available)}"
        raise errors.ChannelMapError(expected, f"{', '.join(missing)}", "Name columns of the table.")
    first = 0
    while True:
        with polars_errors(partial(_unread_chunk, path)):
            table = frame.select(list(wanted.values())).slice(first, rows).collect()
            values = {
                name: table[column].cast(pl.Float64).to_numpy().astype(np.float64, copy=False)
                for name, column in wanted.items()
            }
        if table.height == 0:
            return
        yield Signals(rate_hz, values, noise=noise, start_s=first / rate_hz)
        first += table.height


def _unread_chunk(path: str | os.PathLike[str], error: BaseException) -> errors.InputError:
    reason = f"{Path(path).name}: {error}"
    return errors.InputError(
        "a Parquet file whose columns are numbers", reason, "Check the path and the file."
    )


#: The process that has polars' threads: a fork of it waits for them for ever.
_POLARS_OF: dict[str, int] = {}


@contextmanager
def polars_errors(raised: Callable[[BaseException], errors.EivorError]) -> Iterator[None]:
    """Turn what polars raises for a file, its panics too, into one error; refuse in a forked process."""
    import polars as pl

    if _POLARS_OF.setdefault("process", os.getpid()) != os.getpid():
        raise errors.InputError(
            "a process in which polars can read tables",
            "one that was forked from a process that had read one, whose threads it has not",
            "Begin it by multiprocessing.get_context('spawn') or 'forkserver', or read tables there only.",
        )
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise raised(error) from error


#: More columns than any log has; a header beyond it is not one.
MAX_COLUMNS = 4096


class TableSource(msgspec.Struct, frozen=True):
    """A table whose header has been read."""

    names: tuple[str, ...]  # Columns, in their order
    read: Callable[[Sequence[str]], Columns]  # Reads some columns, by name
    findings: tuple[Finding, ...] = ()
    metadata: str = ""
    units: Mapping[str, str] = msgspec.field(default_factory=dict)  # By column, of a line below the names


def table_columns(
    columns: Sequence[str],
    names: Sequence[str],
    convert: Callable[[str, int | None], tuple[np.ndarray, int, str]],
) -> Columns:
    """Columns, by a function that gives numbers, the count of cells that are none, and how lists look."""
    converted = {column: convert(*(element_of(column, names) or (column, None))) for column in columns}
    return Columns(
        {column: values for column, (values, _, _) in converted.items()},
        {column: bad for column, (_, bad, _) in converted.items() if bad},
        lists={column: text for column, (_, _, text) in converted.items() if text},
    )


def corrupt_table(name: str, reason: str, remedy: str) -> errors.CorruptLogError:
    """Return the error for a table that cannot be read."""
    return errors.CorruptLogError("a readable table", f"'{name}', {reason}", remedy)


MAX_LINE_BYTES = 1 << 20
#: What is looked at at once [bytes], and most blank lines.
BLOCK_BYTES, MAX_BLANK = 1 << 19, 1_000_000
#: A cell that is a list, and what stands in it.
_INSIDE = re.compile(r"^\s*(?:array\((?:'\w', *)?)?[\[(]([^\[\]()]*)[\])]+\s*$")
_LIST = re.compile(r"(?s)\s*(?:array)?[\[(].*[\])]\s*")
_THOUSANDS = r"^[+-]?\d{1,3}(,\d{3})+$"
_NO_VALUE = ("", "na", "n/a", "null", "none", "-", "--")
_WORDS = {"true": "1", "false": "0"}


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the lines are made: where the rows begin, how many there are, and what splits them."""

    names: tuple[str, ...]
    delimiter: str
    header_lines: int
    units: Mapping[str, str]
    rows: int = 0
    cut: bool = False
    open_end: bool = False
    trailing: bool = False
    quoted: bool = False


def open_csv(file: Path) -> TableSource:
    """Check the lines of a delimited text and name its columns."""
    with file.open("rb") as stream:
        layout = _layout(_Lines(stream, file.name))
    findings = (
        *noted("cut_row", layout.cut),
        *noted("open_end", f"'{layout.names[-1]}'" if layout.open_end else ""),
        *noted("units_row", [f"{name} {unit or 1}" for name, unit in layout.units.items()]),
    )
    return TableSource(layout.names, partial(_read, file, layout), findings, units=layout.units)


@dataclass(slots=True)
class _Lines:
    stream: BinaryIO
    name: str
    number: int = 0
    blank: int = 0  # How many of them were
    delimiter: str = ""
    around_cells: re.Pattern[bytes] = re.compile(b"")  # Rows with quotes around whole cells only
    left_open: re.Pattern[bytes] = re.compile(b"")  # Rows whose last cell is left open

    def split_by(self, delimiter: str) -> None:
        """Say what stands between cells; quotes in them are doubled."""
        mark, quoted = re.escape(delimiter.encode()), rb'"[^"]*(?:""[^"]*)*'
        cell = rb"(?:" + quoted + rb'"|[^"' + mark + rb"]*)"
        self.delimiter = delimiter
        self.around_cells = re.compile(cell + rb"(?:" + mark + cell + rb")*")
        self.left_open = re.compile(rb"(?:" + cell + mark + rb")*" + quoted)

    def line(self) -> bytes:
        """Return the next line with its end, empty after the last."""
        line = self.stream.readline(MAX_LINE_BYTES + 1)
        self.number += 1
        if len(line) > MAX_LINE_BYTES:
            raise self.corrupt(f"is longer than {MAX_LINE_BYTES} bytes", "Check that it is a table.")
        if b"\x00" in line:
            remedy = "A power cut leaves them; remove the lines that hold them."
            raise corrupt_table(self.name, f"with NUL bytes in line {self.number}", remedy)
        return line

    def pass_plain_rows(self, width: int) -> tuple[int, bytes]:
        """Pass over blocks of rows of so many cells without quotes; their number, and the last of them."""
        rows, last = 0, b""
        while True:
            begin = self.stream.tell()
            block = self.stream.read(BLOCK_BYTES)
            block = block[: block.rfind(b"\n") + 1]
            letters = np.frombuffer(block, np.uint8)
            ends = np.flatnonzero(letters == ord("\n"))
            marks = np.searchsorted(np.flatnonzero(letters == ord(self.delimiter)), ends)
            if not block or b'"' in block or b"\0" in block or np.any(np.diff(marks, prepend=0) != width - 1):
                self.stream.seek(begin)
                return rows, last
            self.stream.seek(begin + len(block))
            rows, last = rows + ends.size, block[block.rfind(b"\n", 0, -1) + 1 :]
            self.number += ends.size

    def whole_row(self, row: bytes) -> bytes:
        """Return a line that has been read, with those that follow as long as a quoted cell is open."""
        if not self.left_open.fullmatch(row):
            return row
        number, parts, size, quote_count = self.number, [row], len(row), row.count(b'"')
        while quote_count % 2:
            more = self.line()
            if not more and len(parts) == 1:
                break  # the last line, cut
            size += len(more)
            if not more or size > MAX_LINE_BYTES:
                self.number = number
                raise self.corrupt("opens a quote that is not closed", "Close it, or remove it.")
            parts.append(more)
            quote_count += more.count(b'"')
        return b"".join(parts)

    def fields(self, row: bytes) -> list[str]:
        try:
            cells = csv.reader([row.decode("utf-8", "replace")], delimiter=self.delimiter, strict=False)
            return next(cells, [])
        except csv.Error as error:
            raise self.corrupt(f"cannot be split: {error}", "Correct it.") from error

    def corrupt(self, what: str, remedy: str) -> errors.CorruptLogError:
        return corrupt_table(self.name, f"whose line {self.number} {what}", remedy)


def _layout(lines: _Lines) -> _Layout:
    line = lines.line()
    while line and not line.strip():
        line = lines.line()
    header = line.removeprefix(codecs.BOM_UTF8)
    lines.split_by(max(DELIMITERS, key=lambda mark: header.count(mark.encode())))
    names = [field.strip() for field in lines.fields(lines.whole_row(header).rstrip(b"\r\n"))]
    if len(names) > MAX_COLUMNS:
        remedy = f"At most {MAX_COLUMNS} are read; cut the table."
        raise corrupt_table(lines.name, f"with {len(names)} columns", remedy)
    if names and all(map(_is_number, names)):
        expected = "a table whose first line holds the names of the columns"
        received = f"'{lines.name}', whose first line holds numbers only"
        raise errors.UnknownFormatError(expected, received, "Put a line of column names on top.")
    units = _units_row(lines, names)
    layout = _check_rows(lines, _Layout(tuple(names), lines.delimiter, lines.number, units))
    if layout.rows == 0:
        remedy = "Check that logging was on during the flight."
        raise errors.EmptyLogError("a table with rows", f"'{lines.name}' with a header only", remedy)
    return layout


def _units_row(lines: _Lines, names: Sequence[str]) -> dict[str, str]:
    """Units of the columns by the next line, which is read where it holds one of them and no number."""
    begin, number = lines.stream.tell(), lines.number
    texts = lines.line().decode("utf-8", "replace").split(lines.delimiter)  # no unit needs quotes
    cells = [text.strip(' "[]()\r\n') for text in texts]
    units = {name: cell for name, cell in zip(names, cells, strict=False) if cell}
    if any(map(known_unit, units.values())) and not any(map(_is_number, cells)):
        return {name: known_unit(cell) or cell for name, cell in units.items()}
    lines.stream.seek(begin)
    lines.number = number
    return {}


def _check_rows(lines: _Lines, header: _Layout) -> _Layout:
    """Return the layout with the number of rows (blank ones included), once every line has been checked."""
    mark, width = header.delimiter.encode(), len(header.names)
    cut = trailing = False
    quoted_line = stray_line = singly = 0
    rows, last = lines.pass_plain_rows(width)
    while row := lines.line():
        singly += len(row)
        count = row.count(mark) + 1
        if b'"' in row:
            row = lines.whole_row(row)
            if lines.around_cells.fullmatch(row.rstrip(b"\r\n")):
                quoted_line, count = lines.number, len(lines.fields(row))
            elif lines.left_open.fullmatch(row):
                count = 0
            else:
                stray_line = lines.number
        if count != width:
            cut = _odd_row(lines, row, count, width)
            if cut:
                break
            trailing |= count > width
        rows += 1
        last = row
        if singly > BLOCK_BYTES:
            singly, (plain, end) = 0, lines.pass_plain_rows(width)
            rows, last = rows + plain, end or last
    if quoted_line and stray_line:
        lines.number = stray_line
        what = "has a quote inside a cell without quotes around it, where other cells have them"
        raise lines.corrupt(what, "Quote the cell, and double the quote.")
    open_end = not cut and not last.endswith((b"\n", b'"', mark))
    return replace(header, rows=rows, cut=cut, open_end=open_end, trailing=trailing, quoted=quoted_line > 0)


def _odd_row(lines: _Lines, row: bytes, count: int, width: int) -> bool:
    """Whether a row of another number of cells is the last one, cut; raise unless that can be."""
    if not row.strip():
        lines.blank += 1
        if lines.blank > MAX_BLANK:
            raise lines.corrupt(f"is blank, as {MAX_BLANK} before it", "Remove them.")
        return False
    if count < width and (count == 0 or not row.endswith(b"\n")):
        return True
    if count != width + 1 or not row.rstrip(b"\r\n").endswith(lines.delimiter.encode()):
        remedy = "Correct the line, or cut the table before it."
        raise lines.corrupt(f"has {count} fields where the header has {width}", remedy)
    return False


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read(file: Path, layout: _Layout, columns: Sequence[str]) -> Columns:
    import polars as pl

    # one column more, for the lines that end with a delimiter
    every = [f"c{i}" for i in range(len(layout.names) + layout.trailing)]
    position = {name: f"c{i}" for i, name in reversed(list(enumerate(layout.names)))}
    wanted = dict.fromkeys((element_of(name, layout.names) or (name, None))[0] for name in columns)
    chosen = [position[name] for name in wanted]

    def scanned(kind: type[pl.DataType]) -> pl.DataFrame:
        scan = pl.scan_csv(
            file.resolve(),
            has_header=False,
            separator=layout.delimiter,
            quote_char='"' if layout.quoted else None,
            skip_lines=layout.header_lines,
            n_rows=layout.rows,
            schema={name: kind if name in chosen else pl.String for name in every},
            glob=False,
        )
        frame = scan.select(chosen).collect()
        if frame.height != layout.rows:
            raise ValueError(f"{frame.height} rows where {layout.rows} were counted")
        return frame

    encoding = "Check the table's encoding (UTF-8)."
    with polars_errors(
        lambda error: corrupt_table(file.name, f"which cannot be converted: {error}", encoding)
    ):
        frame = None
        if wanted.keys() >= set(columns):  # most tables hold numbers only, and no lists of them
            with suppress(pl.exceptions.ComputeError):
                frame = scanned(pl.Float64)
        if frame is None:
            frame = scanned(pl.String).with_columns(pl.all().str.strip_chars())
            if layout.delimiter == ";" and _has_decimal_commas(frame):
                frame = frame.with_columns(pl.all().str.replace(",", ".", literal=True))
        series = dict(zip(wanted, frame.iter_columns(), strict=True))

        def convert(base: str, index: int | None) -> tuple[np.ndarray, int, str]:
            cells = series[base]
            values, bad = _numbers(cells if index is None else _element(cells, index))
            if layout.open_end and base == layout.names[-1]:
                values[-1] = np.nan
            first = _first(cells) if bad and index is None else ""
            return values, bad, first if _LIST.fullmatch(first) else ""

        return table_columns(columns, layout.names, convert)


def _first(texts: pl.Series) -> str:
    filled = texts.filter(texts != "")
    return str(filled[0])[:200] if filled.len() else ""


def _element(texts: pl.Series, index: int) -> pl.Series:
    """One number of each cell that holds a list: ``[1, 2]``, ``(1 2)``, ``array([1, 2])``."""
    inside = texts.str.extract(_INSIDE.pattern, 1).str.strip_chars()
    return inside.str.replace_all(r"[,;\s]+", ",").str.split(",").list.get(index, null_on_oob=True)


def _has_decimal_commas(frame: pl.DataFrame) -> bool:
    """Whether commas in cells are decimal ones: not those of "1,234" where "0.5" stands elsewhere."""
    import polars as pl

    cells = pl.concat([column.alias("") for column in frame.iter_columns()])
    commas = cells.filter(cells.str.contains(",", literal=True))
    thousands = bool(commas.str.contains(_THOUSANDS).all())
    return commas.len() > 0 and not (thousands and bool(cells.str.contains(".", literal=True).any()))


def _numbers(texts: pl.Series) -> tuple[np.ndarray, int]:
    import polars as pl

    if texts.dtype == pl.Float64:
        return texts.fill_null(np.nan).to_numpy(writable=True), 0
    numbers = texts.cast(pl.Float64, strict=False)
    if numbers.null_count() == 0:
        return numbers.to_numpy().copy(), 0
    words = texts.str.to_lowercase().replace(_WORDS)
    numbers = numbers.fill_null(words.cast(pl.Float64, strict=False))
    bad = numbers.is_null() & words.is_not_null() & ~words.is_in(_NO_VALUE)
    return numbers.fill_null(np.nan).to_numpy().copy(), int(bad.sum())
