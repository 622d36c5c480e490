"""Lists of a fleet's logs: found in folders, given in files, named by their paths."""

from __future__ import annotations

import csv
import glob
import json
import os
import re
import sqlite3
import stat
import weakref
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any

import polars as pl

from eivor.errors import EivorError, InputError, UsageError
from eivor.logs.common import FolderParts
from eivor.logs.mapping import fitting_map
from eivor.logs.read import FURTHER_ENDINGS, TEXTS, folder_parts, format_at, log_formats
from eivor.logs.table.delimited import DELIMITERS, open_csv

# -- Covariates from a file --

#: Columns by which rows belong to flights: the first that is there.
COVARIATE_KEYS = ("sha256", "name")


def given_covariates(file: Path) -> pl.DataFrame:
    """Read a table of covariates."""
    try:
        table = pl.read_csv(file, infer_schema_length=None)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(
            f"a CSV of covariates in '{file}'", f"{type(error).__name__}: {error}", "Check the path."
        ) from error
    key = next((name for name in COVARIATE_KEYS if name in table.columns), None)
    numbers = [name for name, kind in table.schema.items() if kind.is_numeric() and name != key]
    if key is None or not numbers:
        raise InputError(
            f"a column {' or '.join(COVARIATE_KEYS)}, and columns of numbers",
            f"'{file}' with the columns {', '.join(table.columns)}",
            "Write a table such as name,mass with a row for each flight.",
        )
    drop_nulls = table.select(pl.col(key).cast(pl.String), pl.col(numbers).cast(pl.Float64)).drop_nulls(key)
    if drop_nulls[key].n_unique() < drop_nulls.height:
        twice = drop_nulls.filter(drop_nulls[key].is_duplicated())[key][0]
        raise InputError("every flight once", f"'{twice}' twice in '{file}'", "Leave one of its rows out.")
    return drop_nulls


def with_covariates(table: pl.DataFrame, given: pl.DataFrame) -> pl.DataFrame:
    """Rows of a fleet with what is given of them, in place of what is logged where both are there."""
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


# -- Temporary database --

#: Memory that a database keeps pages in [KiB], negative as SQLite wants it.
CACHE = "PRAGMA cache_size = -8192"


class PrivateDatabase:
    """A database with these tables; not to be used by a process that was forked from the one that made it."""

    def __init__(self, *tables: str) -> None:
        # a log's list may be made by one thread and dropped by another, never used by two at a time
        connection = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        self.execute = connection.execute
        self.executemany = connection.executemany
        for statement in ("PRAGMA temp_store = FILE", "PRAGMA journal_mode = OFF", CACHE, "BEGIN", *tables):
            connection.execute(statement)
        weakref.finalize(self, connection.close)

    def number(self, query: str, *given: object) -> int:
        """The one number that a query determines."""
        (fetchone,) = self.execute(query, given).fetchone()
        return int(fetchone)


@contextmanager
def report_database_errors() -> Iterator[None]:
    """Turn what the database says where it finds no room into an error of Eivor's."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(
            "room for the list of the logs, some 500 bytes each, where temporary files are kept",
            f"what the database says: {error}",
            "Make room there, or name another folder: TMPDIR=FOLDER. Rows that were written are kept.",
        ) from error


# -- Log list --

#: Logs that are taken from the list in one go.
PAGE_LOGS = 500
#: What is known of a log: see `Log`; `task` and `share` are those of a run, see `eivor.fleet.table`.
LOG_TABLE = """CREATE TABLE logs (
    name TEXT PRIMARY KEY, path BLOB NOT NULL, told TEXT NOT NULL, sha256 BLOB,
    problem TEXT NOT NULL DEFAULT '', task INTEGER NOT NULL DEFAULT 0, share INTEGER
) WITHOUT ROWID"""
ALL = "SELECT * FROM logs WHERE name > ? ORDER BY name LIMIT ?"


@dataclass(frozen=True, slots=True)
class Log:
    """A log of a fleet."""

    path: str
    name: str
    metadata: Mapping[str, str]
    sha256: str = ""
    problem: str = ""


class LogList:
    """Logs, each by its name once: of several with one name the last counts."""

    def __init__(self, logs: Iterable[Log] = ()) -> None:
        self.database = PrivateDatabase(LOG_TABLE)
        self.database.executemany(
            "INSERT OR REPLACE INTO logs (name, path, told) VALUES (?, ?, ?)",
            ((log.name, os.fsencode(log.path), json.dumps(dict(log.metadata))) for log in logs),
        )

    def __len__(self) -> int:
        return self.database.number("SELECT count(*) FROM logs")

    def __iter__(self) -> Iterator[Log]:
        return chain.from_iterable(self.pages(ALL))

    def pages(self, query: str, *given: object, size: int = PAGE_LOGS) -> Iterator[tuple[Log, ...]]:
        """Logs of a query, so many at a time, in the order of their names; they may be changed meanwhile."""
        name = ""
        while rows := self.database.execute(query, (*given, name, size)).fetchall():
            yield tuple(map(_log, rows))
            name = rows[-1][0]


def _log(row: tuple[Any, ...]) -> Log:
    name, path, reported, sha256, problem, *_ = row
    return Log(os.fsdecode(path), name, json.loads(reported), (sha256 or b"").hex(), problem)


# -- List of logs from a file --

#: Ends of the names of lists, and the column of paths in a list that is a table.
LINES, GIVEN_LIST_TABLE, PATH_COLUMN = ".txt", ".csv", "path"
#: More bytes than a line of column names has.
HEADER_BYTES = 1 << 16


def is_list(path: Path) -> bool:
    """Whether a file is a list of logs, and not a log itself; raises OSError where it cannot be opened."""
    return path.suffix.lower() == LINES or _delimiter(path) != ""


def listed(path: Path) -> Generator[Log, None, None]:
    """Logs of a list, in its order; their paths are from its folder."""
    rows = _lines(path) if path.suffix.lower() == LINES else _rows(path, _delimiter(path))
    for row in rows:
        name = row.pop(PATH_COLUMN)
        if name:
            called = PurePosixPath(name.replace(os.sep, "/")).as_posix()
            yield named_log(str(path.parent / name), called, row)


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


# -- Walk through folders --


def files_below(folder: Path, note: Callable[[OSError], None]) -> Generator[tuple[str, str], None, None]:
    """Files, folder after folder."""
    waiting = PrivateDatabase("CREATE TABLE folders (number INTEGER PRIMARY KEY, inside BLOB)")
    waiting.execute("INSERT INTO folders (inside) VALUES (?)", (b"",))
    number = 0
    while fetchone := waiting.execute("SELECT * FROM folders WHERE number > ? LIMIT 1", (number,)).fetchone():
        number, inside = fetchone[0], os.fsdecode(fetchone[1])
        path = folder / inside
        try:
            with os.scandir(path) as entries:
                for entry in entries:
                    name = f"{inside}/{entry.name}" if inside else entry.name
                    if _is_folder(entry):
                        if not entry.is_symlink():
                            waiting.execute("INSERT INTO folders (inside) VALUES (?)", (os.fsencode(name),))
                    else:
                        yield str(path / entry.name), name
        except OSError as error:
            note(error)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    """Whether it is a folder or a link to one; what cannot be identified is a file."""
    with suppress(OSError):
        return entry.is_dir()
    return False


# -- Search for logs --

#: Folders whose parts are known at a time: files come folder after folder.
FOLDERS = 64


@dataclass(frozen=True, slots=True)
class LogsFound:
    """Logs among files."""

    logs: LogList
    others: int  # Files that are no logs
    unread_folders: tuple[str, ...] = ()  # Folders that could not be looked into, and why


@report_database_errors()
def logs_found(given: str) -> LogsFound:
    """Logs of a folder and the folders in it, of a glob, of a list, or one log."""
    path = Path(given)
    try:
        if path.is_dir():
            os.scandir(path).close()
            return _among_folder(path)
        if path.is_file():
            return LogsFound(
                _logs_of_list(path) if is_list(path) else LogList([named_log(str(path), path.name)]), 0
            )
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            "a folder or a list of logs that can be read",
            f"'{given}', for which the system says: {reason}",
            "Change its permissions, or give another.",
        ) from error
    if glob.has_magic(given):
        return _among(_globbed(given))
    raise InputError(
        "a folder of logs, a pattern such as 'logs/**/*.ulg', or a list of them",
        f"'{given}', which does not exist",
        "Check the name.",
    )


def _among_folder(folder: Path) -> LogsFound:
    closed: list[str] = []

    def note(error: OSError) -> None:
        closed.append(f"{error.filename}: {error.strerror or error}")

    among = _among(files_below(folder, note))
    return LogsFound(among.logs, among.others, tuple(sorted(closed)))


def _globbed(pattern: str) -> Generator[tuple[str, str], None, None]:
    """Files of a pattern, by their names from the last folder before its first wild part."""
    fixed: list[str] = []
    for part in Path(pattern).parts[:-1]:
        if glob.has_magic(part):
            break
        fixed.append(part)
    folder = Path(*fixed)
    for path in glob.iglob(pattern, recursive=True):  # noqa: PTH207
        yield path, Path(path).relative_to(folder).as_posix()


def _among(generator: Generator[tuple[str, str], None, None]) -> LogsFound:
    others = 0
    parts = lru_cache(maxsize=FOLDERS)(_parts_of_folder)

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
        return LogsFound(LogList(given), others)


def _parts_of_folder(folder: Path) -> FolderParts:
    try:
        return folder_parts(folder)
    except OSError:
        return FolderParts()


def is_log(path: Path) -> bool:
    """Whether a file is a log: its name ends like one's, or a reader knows its content."""
    if path.name.lower().endswith(
        (*FURTHER_ENDINGS, *(end for log_format in log_formats() for end in log_format.endings))
    ):
        return True
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            return False
        result = format_at(path)
    except (OSError, EivorError):
        return False
    return result.is_read and (result not in TEXTS or _is_known_table(path))


def _is_known_table(path: Path) -> bool:
    """Whether the columns of a text are those of a log."""
    try:
        fitting_map(_columns(path), path.name)
    except EivorError:
        return False
    return True


def _columns(path: Path) -> tuple[str, ...]:
    """Columns of a table; none of what is no table."""
    try:
        return open_csv(path).names
    except EivorError:
        return ()


def _logs_of_list(path: Path) -> LogList:
    with closing(listed(path)) as given:
        logs = LogList(given)
    if not logs:
        raise UsageError("a list of logs", f"'{path}', which names none", "Write a path into each line.")
    return logs


# -- Vehicles named by paths --

#: What a pattern may ask of a path, by the name of the table's column.
PATH_KEYS = ("vehicle", "type")
_TOKENS = re.compile(r"\{(\w+)\}|(\*\*/?)|(\*)|(\?)|([^*?{]+|\{)")


def is_pattern(text: str) -> bool:
    """Whether a text is a pattern, and not the name of a column."""
    return "{" in text


@dataclass(frozen=True, slots=True)
class PathPattern:
    """A pattern of paths that says whose log one is."""

    text: str

    def __post_init__(self) -> None:
        match = re.findall(r"\{(\w*)\}", self.text)
        if not match or set(match) - set(PATH_KEYS) or len(set(match)) < len(match):
            raise UsageError(
                "a pattern with {vehicle}, and {type} where the path has it, each once",
                f"'{self.text}'",
                "Write one such as '{vehicle}/*.ulg' or '**/{type}_{vehicle}_*.csv'.",
            )

    def fields_of(self, name: str) -> Mapping[str, str]:
        """What a path says, by `PATH_KEYS`; nothing when it does not match."""
        match = _compiled(self.text).fullmatch(name if "/" in self.text else name.rpartition("/")[2])
        return {key: text for key, text in match.groupdict().items() if text} if match else {}


@cache
def _compiled(text: str) -> re.Pattern[str]:
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
