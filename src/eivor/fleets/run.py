"""Running a fleet: every log once, each with a row, whatever happens on the way.

Logs are told apart by the hash of their bytes; the first of several with the same bytes is identified and
the others name it. Rows that are there are not made again. The parent hands out names of logs and takes
receipts; rows are written where they are made.
"""

from __future__ import annotations

import hashlib
import stat
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import polars as pl

from eivor.errors import InputError
from eivor.fleets.fleet_folder import FleetFolder, SupersededError, fleet_errors_told
from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.flight_row import copy_row, failed_row, named_row
from eivor.fleets.folder_lock import folder_lock
from eivor.fleets.logs_found import Log, LogsFound
from eivor.fleets.own_reports import PageOf, reports_there
from eivor.fleets.shard import Shard, close_kept_guards
from eivor.fleets.table import COPY, FAILED
from eivor.logs.folders import folder_sha256, folder_size
from eivor.logs.formats import folder_parts
from eivor.logs.read import DEFAULT_MAX_BYTES
from eivor.studies.executors import Executor, InProcess

#: Logs of a task: as few as give the number of tasks that progress is told by, and at most so many.
TASKS, MOST_LOGS = 100, 200
#: Logs that are hashed, and copies that are written, in one go.
HASHED, COPIES = 500, 10_000

#: Called with the number of logs that are done, and that of all; first with what was there already.
Progress = Callable[[int, int], None]


def no_progress(_done: int, _total: int, /) -> None:
    """Tell nobody how much is done."""


@dataclass(frozen=True, slots=True)
class FleetRun:
    """What a run has done.

    Parameters
    ----------
    folder : Path
        Of the fleet.
    logs : int
        Logs that were found, each of which has a row.
    before : int
        Those whose row was there already.
    verdicts : mapping of str to int
        Verdicts of the rows of all these logs.
    others : int
        Files that are no logs.
    unread_folders : tuple of str
        Folders that could not be looked into, and why.
    elsewhere : int
        Further rows of the motion in the folder, of logs that were not among these.
    """

    folder: Path
    logs: int
    before: int
    verdicts: Mapping[str, int]
    others: int
    unread_folders: tuple[str, ...]
    elsewhere: int


@dataclass(frozen=True, slots=True)
class Hashed:
    """The task of hashing: logs with the hash of their bytes, or why they cannot be opened."""

    def __call__(self, logs: tuple[Log, ...]) -> tuple[Log, ...]:
        """The same logs, hashed."""
        return tuple(map(hashed, logs))


def run_fleet(
    found: LogsFound,
    folder: Path,
    options: FleetOptions,
    *,
    executor: Executor | None = None,
    guarded: bool = True,
    shared: bool = False,
    shard_logs: int | None = None,
    progress: Progress = no_progress,
    page_of: PageOf | None = None,
) -> FleetRun:
    """Make the rows of a fleet that are not there yet.

    Parameters
    ----------
    found : LogsFound
        The logs, see `logs_found`.
    folder : Path
        A new folder, or one in which a fleet was begun with these options.
    options : FleetOptions
        What is asked of every log.
    executor : Executor, optional
        Where to compute. Default: in this process. The rows do not depend on it.
    guarded : bool
        Whether each log is kept to its limits, in a process beside.
    shared : bool
        Whether the executor's workers see the logs and should hash them, too.
    shard_logs : int, optional
        Logs of a task. Default: by their number.
    progress : callable
        See `Progress`.
    page_of : callable, optional
        What makes the report of a flight from its result: every log with a result gets one, also those whose
        rows are there already.

    Returns
    -------
    FleetRun
        With every log's row written.

    Raises
    ------
    UsageError
        When the folder is one of other options.
    InputError
        When there are no logs, another run works on the folder, it cannot be written, it was made by other
        versions, or a worker is lost. What was written is kept.
    """
    if not found.logs:
        raise InputError(
            "a folder, a pattern or a list with logs in it",
            f"none ({found.others} other files)",
            "Check the path; a log of a table with names of its own needs the ending .csv or .parquet.",
        )
    folder = folder.absolute()
    with fleet_errors_told(folder):
        if not folder.exists() or folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
    place = FleetFolder(folder)
    place.check(options)
    with fleet_errors_told(folder), folder_lock(folder):
        run = _Run(place.begin(), options, executor or InProcess(), shared, progress, page_of)
        try:
            return run.done(found, guarded=guarded, shard_logs=shard_logs)
        except SupersededError as error:
            raise _taken_over(folder) from error
        finally:
            close_kept_guards()


@dataclass(frozen=True, slots=True)
class _Run:
    """A run on a folder that it holds."""

    folder: FleetFolder
    options: FleetOptions
    executor: Executor
    shared: bool
    progress: Progress
    page_of: PageOf | None

    def done(self, found: LogsFound, *, guarded: bool, shard_logs: int | None) -> FleetRun:
        """Everything, from hashing to copies."""
        there = self.folder.there(self.options.motion)
        logs = self._hashed(found.logs)
        opened = [log for log in logs if log.sha256]
        firsts = _firsts(opened, there)
        keys = set(there.select("name", "sha256").rows())
        work = [log for log in opened if log.sha256 not in firsts.there and firsts.is_first(log)]
        copies = [log for log in opened if not firsts.is_first(log) and (log.name, log.sha256) not in keys]
        if work or copies:
            self.folder.state(self.options)
        before = len(opened) - len(work) - len(copies)
        self._unopened([log for log in logs if not log.sha256], {log.name for log in logs})
        self._identify(work, before, len(logs), guarded=guarded, shard_logs=shard_logs)
        self._write_copies(copies, firsts)
        if self.page_of is not None:
            self._report(opened, guarded=guarded)
        self.progress(len(logs), len(logs))
        return self._summary(found, logs, before)

    def _hashed(self, logs: Sequence[Log]) -> list[Log]:
        executor = self.executor if self.shared else InProcess()
        found: dict[int, tuple[Log, ...]] = {}
        with closing(executor.map(Hashed(), _parts(logs, HASHED))) as results:
            found.update(results)
        return [log for place in sorted(found) for log in found[place]]

    def _unopened(self, logs: Sequence[Log], names: set[str]) -> None:
        rows = [failed_row(named_row(log, self.options.marks()), log.problem) for log in logs]
        if rows:
            self.folder.state(self.options)
        self.folder.replace_unopened(rows, names, self.options)

    def _identify(
        self, work: Sequence[Log], done: int, total: int, *, guarded: bool, shard_logs: int | None
    ) -> None:
        self.progress(done, total)
        size = shard_logs or min(MOST_LOGS, max(1, len(work) // TASKS))
        task = Shard(self.folder, self.options, guarded, self.page_of)
        with closing(self.executor.map(task, _parts(work, size))) as receipts:
            for _, receipt in receipts:
                done += receipt.rows
                self.progress(done, total)

    def _report(self, logs: Sequence[Log], *, guarded: bool) -> None:
        """Reports of logs whose rows were there before."""
        told = self.folder.there(self.options.motion).filter(pl.col("verdict").is_in((COPY, FAILED)).not_())
        keys, there = set(told.select("name", "sha256").rows()), reports_there(self.folder.folder)
        work = [log for log in logs if (log.name, log.sha256) in keys and log.sha256 not in there]
        task = Shard(self.folder, self.options, guarded, self.page_of, only_reports=True)
        with closing(self.executor.map(task, _parts(work, max(1, len(work) // TASKS)))) as receipts:
            for _ in receipts:
                pass

    def _write_copies(self, copies: Sequence[Log], firsts: _Firsts) -> None:
        marks = self.options.marks()
        for part in _parts(copies, COPIES):
            self.folder.write([copy_row(log, firsts.name(log), marks) for log in part], self.options.hash())

    def _summary(self, found: LogsFound, logs: Sequence[Log], before: int) -> FleetRun:
        there = self.folder.there(self.options.motion)
        opened = [log for log in logs if log.sha256]
        these = pl.DataFrame(
            {
                "name": pl.Series([log.name for log in opened], dtype=pl.String),
                "sha256": pl.Series([log.sha256 for log in opened], dtype=pl.String),
            }
        )
        rows = there.join(these, on=["name", "sha256"], how="semi")
        if rows.height != these.height:
            raise _taken_over(self.folder.folder)
        unopened = len(logs) - these.height
        verdicts = Counter(rows["verdict"].to_list())
        verdicts[FAILED] += unopened
        return FleetRun(
            self.folder.folder,
            len(logs),
            before,
            +verdicts,
            found.others,
            found.unread_folders,
            there.height - rows.height,
        )


def _taken_over(folder: Path) -> InputError:
    return InputError(
        "a folder that is this run's until it is done",
        f"'{folder}', in which rows are missing that were written, or which another run has begun on",
        "Run the same again: what is there is kept.",
    )


@dataclass(frozen=True, slots=True)
class _Firsts:
    """For each hash the log whose row has the numbers."""

    there: Mapping[str, str]
    given: Mapping[str, str]

    def name(self, log: Log) -> str:
        """Name of the log that a log is, or is a copy of."""
        return self.there.get(log.sha256) or self.given[log.sha256]

    def is_first(self, log: Log) -> bool:
        """Whether a log has the numbers itself."""
        return self.name(log) == log.name


def _firsts(logs: Sequence[Log], there: pl.DataFrame) -> _Firsts:
    """Those whose row is there, else the first of the given ones by name."""
    numbers = there.filter(pl.col("verdict") != COPY).select("sha256", "name").rows()
    given: dict[str, str] = {}
    for log in logs:
        given.setdefault(log.sha256, log.name)
    return _Firsts(dict(numbers), given)


def _parts(logs: Sequence[Log], size: int) -> Iterator[tuple[Log, ...]]:
    for start in range(0, len(logs), size):
        yield tuple(logs[start : start + size])


def hashed(log: Log) -> Log:
    """A log with the hash of its bytes, or with the reason why it cannot be opened."""
    path = Path(log.path)
    try:
        status = path.stat()
        is_folder = stat.S_ISDIR(status.st_mode) and bool(folder_parts(path).members)
        if not is_folder and not stat.S_ISREG(status.st_mode):
            return replace(log, problem="It is no regular file.")
        size = folder_size(path) if is_folder else status.st_size
        if size > DEFAULT_MAX_BYTES:
            return replace(
                log, problem=f"It has {size} bytes, more than the {DEFAULT_MAX_BYTES} that are read."
            )
        if is_folder:
            return replace(log, sha256=folder_sha256(path))
        with path.open("rb") as stream:
            return replace(log, sha256=hashlib.file_digest(stream, "sha256").hexdigest())
    except (OSError, ValueError) as error:
        return replace(log, problem=f"It cannot be opened: {getattr(error, 'strerror', None) or error}.")
