"""Lists of a fleet's logs: found in folders, given in files, named by their paths."""

from __future__ import annotations

import csv
import glob
import json
import os
import re
import stat
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import chain, islice, takewhile
from pathlib import Path, PurePosixPath
from typing import Any, cast

import polars as pl

from eivor.errors import EivorError, InputError, UsageError
from eivor.logs.common import FolderParts
from eivor.logs.mapping import fitting_map
from eivor.logs.read import FURTHER_ENDINGS, folder_parts, format_at, is_address, log_formats, path_of
from eivor.logs.table.delimited import DELIMITERS, open_csv


def _elsewhere(given: str) -> LogsFound:
    """Logs below an address, of a pattern or one of them, by the ends of their names."""
    root = path_of(given)
    system: Any = cast("Any", root).fs
    fixed = list(takewhile(lambda part: not glob.has_magic(part), given.split("/")[:-1]))
    start = "/".join(fixed) if glob.has_magic(given) else given.rstrip("/")
    try:
        files = system.glob(given) if glob.has_magic(given) else system.find(given)
    except Exception as error:
        received = f"'{given}', for which {type(error).__name__} says: {error}"
        remedy = "Check the address, and the credentials of this machine."
        raise InputError("an address whose files can be listed", received, remedy) from error
    logs = [system.unstrip_protocol(file) for file in files if file.lower().endswith(_endings())]
    named = [named_log(log, log.removeprefix(start).lstrip("/") or log.rpartition("/")[2]) for log in logs]
    if not files:
        raise InputError("an address with files", f"'{given}', where there are none", "Check the address.")
    return LogsFound(LogList.of(named), len(files) - len(logs))


#: Columns by which rows belong to flights: the first that is there.
COVARIATE_KEYS = ("sha256", "name")


def given_covariates(file: Path) -> pl.DataFrame:
    """Read a table of covariates."""
    try:
        table = pl.read_csv(file, infer_schema_length=None)
    except (OSError, pl.exceptions.PolarsError) as error:
        received = f"{type(error).__name__}: {error}"
        raise InputError(f"a CSV of covariates in '{file}'", received, "Check the path.") from error
    key = next((name for name in COVARIATE_KEYS if name in table.columns), None)
    numbers = [name for name, kind in table.schema.items() if kind.is_numeric() and name != key]
    if key is None or not numbers:
        expected = f"a column {' or '.join(COVARIATE_KEYS)}, and columns of numbers"
        remedy = "Write a table such as name,mass with a row for each flight."
        raise InputError(expected, f"'{file}' with the columns {', '.join(table.columns)}", remedy)
    covariates = table.select(pl.col(key).cast(pl.String), pl.col(numbers).cast(pl.Float64)).drop_nulls(key)
    if covariates[key].n_unique() < covariates.height:
        twice = covariates.filter(covariates[key].is_duplicated())[key][0]
        raise InputError("every flight once", f"'{twice}' twice in '{file}'", "Leave one of its rows out.")
    return covariates


def with_covariates(table: pl.DataFrame, given: pl.DataFrame) -> pl.DataFrame:
    """Rows of a fleet with what is given of them, in place of what is logged where both are there."""
    key, *names = given.columns
    taken = [name for name in names if name in table.columns and not table.schema[name].is_numeric()]
    if taken or any("." in name for name in names):
        received = f"{', '.join(taken or names)}, which are columns of the fleet's own"
        raise InputError("names of covariates, such as mass", received, "Give these columns other names.")
    if not table[key].is_in(given[key].to_list()).any():
        expected = f"covariates of flights of the fleet, by their {key}"
        remedy = "Compare with the output of eivor fleet query FLEET QUANTITY --csv FILE."
        raise InputError(expected, f"none of {given.height} rows is of one", remedy)
    joined = table.join(given, on=key, how="left", suffix=".given", maintain_order="left")
    both = [name for name in names if f"{name}.given" in joined.columns]
    joined = joined.with_columns(pl.coalesce(f"{name}.given", name).alias(name) for name in both)
    return joined.drop(f"{name}.given" for name in both)


#: Logs that are taken from the list in one go.
PAGE_LOGS = 500
#: A path is bytes, since not every one is text.
LOG_SCHEMA = dict.fromkeys(("name", "path", "metadata", "sha256", "problem"), pl.String) | {"path": pl.Binary}


@dataclass(frozen=True, slots=True)
class Log:
    """A log of a fleet."""

    path: str
    name: str
    metadata: Mapping[str, str]
    sha256: str = ""
    problem: str = ""


@dataclass(frozen=True)
class LogList:
    """Logs in the order of their names, each once."""

    table: pl.DataFrame  # Columns of `LOG_SCHEMA`, and others; `sha256` is null where it is not known

    @classmethod
    def of(cls, logs: Iterable[Log]) -> LogList:
        """List of logs in any order: of several with one name the last counts."""
        rows = (
            (log.name, os.fsencode(log.path), json.dumps(dict(log.metadata)), log.sha256 or None, log.problem)
            for log in logs
        )
        parts = [pl.DataFrame(schema=LOG_SCHEMA)]
        while page := list(islice(rows, PAGE_LOGS)):
            parts.append(pl.DataFrame(page, schema=LOG_SCHEMA, orient="row"))
        return cls(pl.concat(parts).unique("name", keep="last", maintain_order=True).sort("name"))

    def __len__(self) -> int:
        return self.table.height

    def __iter__(self) -> Iterator[Log]:
        return chain.from_iterable(self.pages())

    def pages(self, size: int = PAGE_LOGS) -> Iterator[tuple[Log, ...]]:
        for part in self.table.select(*LOG_SCHEMA).iter_slices(size):
            yield tuple(
                Log(os.fsdecode(path), name, json.loads(metadata), sha256 or "", problem)
                for name, path, metadata, sha256, problem in part.iter_rows()
            )


#: Ends of the names of lists, and the column of paths in a list that is a table.
LINES, GIVEN_LIST_TABLE, PATH_COLUMN = ".txt", ".csv", "path"


def listed(path: Path) -> Generator[Log, None, None]:
    """Logs of a list, in its order; their paths are from its folder."""
    rows = _lines(path) if path.suffix.lower() == LINES else _rows(path, _delimiter(path))
    for row in rows:
        name = row.pop(PATH_COLUMN)
        if is_address(name):
            yield named_log(name, name, row)
        elif name:
            yield named_log(str(path.parent / name), PurePosixPath(name.replace(os.sep, "/")).as_posix(), row)


def named_log(path: str, name: str, record: dict[str, str] | None = None) -> Log:
    """A log by its path, whose name becomes text that can be written."""
    return Log(path, name.encode("utf-8", "backslashreplace").decode("utf-8"), record or {})


def _lines(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8-sig") as lines:
        for line in lines:
            if not line.startswith("#"):
                yield {PATH_COLUMN: line.strip()}


def _delimiter(path: Path) -> str:
    """What separates the columns of a table that is a list; empty for any other file."""
    if path.suffix.lower() != GIVEN_LIST_TABLE:
        return ""
    with path.open("rb") as stream:
        line = stream.readline(1 << 16)  # more than one of column names has
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
            received, remedy = f"'{path}', with {', '.join(header)}", "Rename those that are alike."
            raise UsageError("a list whose columns have different names", received, remedy)
        try:
            for row in rows:
                if row and len(row) != len(header):
                    expected = f"{len(header)} columns in each line of '{path}', as in its first"
                    raise InputError(expected, f"{len(row)} in line {rows.line_num}", "Correct the line.")
                if row:
                    yield dict(zip(header, row, strict=True))
        except csv.Error as error:
            expected = f"a table of logs '{path}' that can be read"
            raise InputError(expected, f"line {rows.line_num}: {error}", "Correct the line.") from error


def files_below(folder: Path, note: Callable[[OSError], None]) -> Generator[tuple[str, str], None, None]:
    """Files, folder after folder; what cannot be identified is a file, and a link to a folder is left out."""
    for path, _, names in os.walk(folder, onerror=note):
        inside = Path(path).relative_to(folder)
        for name in names:
            yield str(folder / inside / name), (inside / name).as_posix()


@dataclass(frozen=True, slots=True)
class LogsFound:
    """Logs among files."""

    logs: LogList
    others: int  # Files that are no logs
    unread_folders: tuple[str, ...] = ()  # Folders that could not be looked into, and why


def logs_found(given: str) -> LogsFound:
    """Logs of a folder and the folders in it, of a glob, of a list, or one log."""
    if is_address(given):
        return _elsewhere(given)
    path = path_of(given)
    try:
        if path.is_dir():
            os.scandir(path).close()
            closed: list[OSError] = []
            among = _among(files_below(path, closed.append))
            reasons = sorted(f"{error.filename}: {error.strerror or error}" for error in closed)
            return replace(among, unread_folders=tuple(reasons))
        if path.is_file():
            is_list = path.suffix.lower() == LINES or _delimiter(path) != ""
            logs = LogList.of(listed(path) if is_list else [named_log(str(path), path.name)])
            if not logs:
                missing = f"'{path}', which names none"
                raise UsageError("a list of logs", missing, "Write a path into each line.")
            return LogsFound(logs, 0)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        expected = "a folder or a list of logs that can be read"
        remedy = "Change its permissions, or give another."
        raise InputError(expected, f"'{given}', for which the system says: {reason}", remedy) from error
    if glob.has_magic(given):
        return _among(_globbed(given))
    expected = "a folder of logs, a pattern such as 'logs/**/*.ulg', or a list of them"
    raise InputError(expected, f"'{given}', which does not exist", "Check the name.")


def _globbed(pattern: str) -> Generator[tuple[str, str], None, None]:
    """Files of a pattern, by their names from the last folder before its first wild part."""
    folder = Path(*takewhile(lambda part: not glob.has_magic(part), Path(pattern).parts[:-1]))
    for path in glob.iglob(pattern, recursive=True):  # noqa: PTH207
        yield path, Path(path).relative_to(folder).as_posix()


def _among(generator: Generator[tuple[str, str], None, None]) -> LogsFound:
    others, parts = 0, lru_cache(maxsize=64)(_parts_of_folder)  # files come folder after folder

    def logs() -> Generator[Log, None, None]:
        nonlocal others
        for path, name in generator:
            file = Path(path)
            if file.is_dir():
                if parts(file).members:
                    yield named_log(path, name)
                continue
            neighbours = parts(file.parent)
            if file.name in neighbours.members:
                folder = PurePosixPath(name).parent.as_posix()
                folder = file.parent.resolve().name if folder == "." else folder
                yield named_log(str(file.parent), folder)
            elif file.name not in neighbours.derived and is_log(file):
                yield named_log(path, name)
            else:
                others += 1

    with closing(generator), closing(logs()) as given:
        return LogsFound(LogList.of(given), others)


def _parts_of_folder(folder: Path) -> FolderParts:
    with suppress(OSError):
        return folder_parts(folder)
    return FolderParts()


def _endings() -> tuple[str, ...]:
    return (*FURTHER_ENDINGS, *(end for log_format in log_formats() for end in log_format.endings))


def is_log(path: Path) -> bool:
    """Whether a file is a log: its name ends like one's, or a reader knows its content."""
    if path.name.lower().endswith(_endings()):
        return True
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            return False
        result = format_at(path)
        if result.name == "csv":
            fitting_map(open_csv(path).names, path.name, [])  # refuses what is no log
    except (OSError, EivorError):
        return False
    return result.is_read


#: What a pattern may ask of a path, by the name of the table's column.
PATH_KEYS = ("vehicle", "type")
_TOKENS = re.compile(r"\{(\w+)\}|(\*\*/?)|(\*)|(\?)|([^*?{]+|\{)")


def path_fields(pattern: str, name: str = "") -> dict[str, str]:
    """What the path of a log says by `PATH_KEYS`; nothing when it does not match the pattern."""
    match = _compiled(pattern).fullmatch(name if "/" in pattern else name.rpartition("/")[2])
    return {key: text for key, text in match.groupdict().items() if text} if match else {}


@cache
def _compiled(text: str) -> re.Pattern[str]:
    keys = re.findall(r"\{(\w*)\}", text)
    if not keys or set(keys) - set(PATH_KEYS) or len(set(keys)) < len(keys):
        expected = "a pattern with {vehicle}, and {type} where the path has it, each once"
        remedy = "Write one such as '{vehicle}/*.ulg' or '**/{type}_{vehicle}_*.csv'."
        raise UsageError(expected, f"'{text}'", remedy)
    parts: list[str] = []
    for key, deep, star, mark, plain in _TOKENS.findall(text):
        if key:
            parts.append(f"(?P<{key}>[^/]+?)")
        elif deep:
            parts.append("(?:.*/)?" if deep.endswith("/") else ".*")
        elif star or mark:
            parts.append("[^/]*" if star else "[^/]")
        else:
            parts.append(re.escape(plain))
    return re.compile("".join(parts))
