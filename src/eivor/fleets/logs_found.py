"""Which logs a fleet has: the files of a folder, of a glob or of a list that are logs.

A log is a file whose content a reader knows, or whose name ends like a log. Text can be anything, so a table
counts by its content only when its columns are canonical or those of a shipped map. Files that are one log
together (of a ROS 2 bag, of `ulog2csv`) count once: the folder is the log.
"""

from __future__ import annotations

import glob
import os
import stat
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

from eivor.errors import EivorError, InputError, UsageError
from eivor.fleets.given_list import is_list, listed, named_log
from eivor.fleets.log_list import Log, LogList
from eivor.fleets.private_database import database_errors_told
from eivor.fleets.walked import files_below
from eivor.logs.formats import TEXTS, folder_parts, format_at, log_formats
from eivor.logs.log_format import FolderParts

#: Ends of names of logs of formats that are recognised, or that others read: the reader says what to do.
FURTHER_ENDINGS = (".bag", ".bbl", ".bfl", ".db3", ".db3.zstd", ".mcap", ".mcap.zstd", ".tlog")
#: Folders whose parts are known at a time: files come folder after folder.
FOLDERS = 64


@dataclass(frozen=True, slots=True)
class LogsFound:
    """Logs among files.

    Parameters
    ----------
    logs : LogList
        In the order of their names.
    others : int
        Files that are no logs.
    unread_folders : tuple of str
        Folders that could not be looked into, and why.
    """

    logs: LogList
    others: int
    unread_folders: tuple[str, ...] = ()


@database_errors_told()
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
        When there is no such folder or file, it cannot be read, or there is no room for the list of logs.
    UsageError
        When a list names no file, or two columns of it have one name.
    """
    path = Path(given)
    try:
        if path.is_dir():
            os.scandir(path).close()
            return _among_folder(path)
        if path.is_file():
            return LogsFound(
                _listed(path) if is_list(path) else LogList([named_log(str(path), path.name)]), 0
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

    found = _among(files_below(folder, note))
    return LogsFound(found.logs, found.others, tuple(sorted(closed)))


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


def _among(found: Generator[tuple[str, str], None, None]) -> LogsFound:
    others = 0
    parts = lru_cache(maxsize=FOLDERS)(_parts)

    def logs() -> Generator[Log, None, None]:
        nonlocal others
        for path, name in found:
            file = Path(path)
            if file.is_dir():
                if parts(file).members:
                    yield named_log(path, name)
                continue
            beside = parts(file.parent)
            if file.name in beside.members:
                folder = PurePosixPath(name).parent.as_posix()
                folder = file.parent.resolve().name if folder == "." else folder
                yield named_log(str(file.parent), folder)
            elif file.name not in beside.derived and is_log(file):
                yield named_log(path, name)
            else:
                others += 1

    with closing(found), closing(logs()) as given:
        return LogsFound(LogList(given), others)


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


def _listed(path: Path) -> LogList:
    with closing(listed(path)) as given:
        logs = LogList(given)
    if not logs:
        raise UsageError("a list of logs", f"'{path}', which names none", "Write a path into each line.")
    return logs
