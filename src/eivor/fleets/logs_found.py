"""Which logs a fleet has: the files of a folder, of a glob or of a list that are logs.

A log is a file whose content a reader knows, or whose name ends like a log. Text can be anything, so a table
counts by its content only when its columns are canonical or those of a shipped map. Files that are one log
together (of a ROS 2 bag, of `ulog2csv`) count once: the folder is the log.
"""

from __future__ import annotations

import glob
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

import polars as pl

from eivor.errors import EivorError, InputError, UsageError
from eivor.logs.formats import TEXTS, folder_parts, format_at, log_formats
from eivor.logs.log_format import FolderParts

#: Ends of names of logs of formats that are recognised, or that others read: the reader says what to do.
FURTHER_ENDINGS = (".bag", ".bbl", ".bfl", ".db3", ".db3.zstd", ".mcap", ".mcap.zstd", ".tlog")
#: Ends of the names of lists, and the column of paths in a list that is a table.
LINES, TABLE, PATH_COLUMN = ".txt", ".csv", "path"


@dataclass(frozen=True, slots=True)
class Log:
    """A log of a fleet.

    Parameters
    ----------
    path : str
        Where it is.
    name : str
        What it is called in the table: its path from the folder that was given, with ``/``.
    told : mapping of str to str
        What the list says of it, by column.
    sha256 : str
        Hash of its bytes; empty until it was hashed, and when it could not be opened.
    problem : str
        Why it could not be opened.
    """

    path: str
    name: str
    told: Mapping[str, str]
    sha256: str = ""
    problem: str = ""


@dataclass(frozen=True, slots=True)
class LogsFound:
    """Logs among files.

    Parameters
    ----------
    logs : tuple of Log
        In the order of their names.
    others : int
        Files that are no logs.
    unread_folders : tuple of str
        Folders that could not be looked into, and why.
    """

    logs: tuple[Log, ...]
    others: int
    unread_folders: tuple[str, ...] = ()


def logs_found(given: str) -> LogsFound:
    """Logs of a folder and the folders in it, of a glob, of a list, or one log.

    Parameters
    ----------
    given : str
        A folder; a pattern such as ``logs/**/*.ulg``; a text file (.txt) with a path in each line; a table
        (.csv) with a column `path` and further columns; or a log. Paths of a list are from its folder, and
        all of them are logs.

    Raises
    ------
    InputError
        When there is no such folder or file, or it cannot be read.
    UsageError
        When a list names no file.
    """
    path = Path(given)
    try:
        if path.is_dir():
            os.scandir(path).close()
            return _among_folder(path)
        if path.is_file():
            listed = _listed(path)
            if listed is None:
                return LogsFound((_log(str(path), path.name),), 0)
            return LogsFound(tuple(listed), 0)
    except (OSError, pl.exceptions.PolarsError, UnicodeDecodeError) as error:
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


def _log(path: str, name: str, told: Mapping[str, str] | None = None) -> Log:
    readable = name.encode("utf-8", "backslashreplace").decode("utf-8")
    return Log(path, readable, told or {})


def _among_folder(folder: Path) -> LogsFound:
    closed: list[str] = []

    def note(error: OSError) -> None:
        closed.append(f"{error.filename}: {error.strerror or error}")

    def files() -> Iterator[tuple[str, str]]:
        for place, _, names in os.walk(folder, onerror=note):
            inside = Path(place).relative_to(folder)
            for name in names:
                yield str(Path(place, name)), (inside / name).as_posix()

    found = _among(files())
    return LogsFound(found.logs, found.others, tuple(sorted(closed)))


def _globbed(pattern: str) -> Iterator[tuple[str, str]]:
    """Files of a pattern, by their names from the last folder before its first wild part."""
    fixed: list[str] = []
    for part in Path(pattern).parts[:-1]:
        if glob.has_magic(part):
            break
        fixed.append(part)
    folder = Path(*fixed)
    for path in glob.iglob(pattern, recursive=True):  # noqa: PTH207
        yield path, Path(path).relative_to(folder).as_posix()


def _among(found: Iterator[tuple[str, str]]) -> LogsFound:
    logs: dict[str, Log] = {}
    others = 0
    parts = cache(_parts)
    for path, name in found:
        file = Path(path)
        if file.is_dir():
            if parts(file).members:
                logs[name] = _log(path, name)
            continue
        beside = parts(file.parent)
        if file.name in beside.members:
            folder = PurePosixPath(name).parent.as_posix()
            folder = file.parent.resolve().name if folder == "." else folder
            logs[folder] = _log(str(file.parent), folder)
        elif file.name not in beside.derived and is_log(file):
            logs[name] = _log(path, name)
        else:
            others += 1
    return LogsFound(tuple(sorted(logs.values(), key=lambda log: log.name)), others)


def _parts(folder: Path) -> FolderParts:
    try:
        return folder_parts(folder)
    except OSError:
        return FolderParts()


def is_log(path: Path) -> bool:
    """Whether a file is a log: its name ends like one's, or a reader knows its content."""
    if path.name.lower().endswith((*FURTHER_ENDINGS, *(end for one in log_formats() for end in one.endings))):
        return True
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            return False
        found = format_at(path)
    except (OSError, EivorError):
        return False
    return found.is_read and (found not in TEXTS or _is_known_table(path))


def _is_known_table(path: Path) -> bool:
    """Whether the columns of a text are those of a log."""
    from eivor.logs.mapping import fitting_map

    try:
        fitting_map(_columns(path), path.name)
    except EivorError:
        return False
    return True


def _columns(path: Path) -> tuple[str, ...]:
    """Columns of a table; none of what is no table."""
    from eivor.logs.table.delimited import open_csv

    try:
        return open_csv(path).names
    except EivorError:
        return ()


def _listed(path: Path) -> list[Log] | None:
    """Logs of a list; None when the file is none."""
    if path.suffix.lower() == LINES:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        rows = [{PATH_COLUMN: line.strip()} for line in lines if line.strip() and not line.startswith("#")]
    elif path.suffix.lower() == TABLE and PATH_COLUMN in _columns(path):
        table = pl.read_csv(path, infer_schema=False)
        rows = [{key: text or "" for key, text in row.items()} for row in table.iter_rows(named=True)]
    else:
        return None
    if not any(row[PATH_COLUMN] for row in rows):
        raise UsageError("a list of logs", f"'{path}', which names none", "Write a path into each line.")
    logs = {}
    for row in rows:
        name = row.pop(PATH_COLUMN)
        if name:
            logs[name] = _log(
                str(path.parent / name), PurePosixPath(name.replace(os.sep, "/")).as_posix(), row
            )
    return sorted(logs.values(), key=lambda log: log.name)
