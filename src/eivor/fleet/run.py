"""Identification of many logs in several processes."""

from __future__ import annotations

import hashlib
import stat
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eivor.atomic_file import folder_lock
from eivor.errors import InputError
from eivor.fleet.logs import Log, LogsFound, report_database_errors
from eivor.fleet.table import (
    FAILED,
    PAGE,
    SHARES,
    FleetFolder,
    FleetOptions,
    Ledger,
    NamedRow,
    PageOf,
    RowOfLog,
    SupersededError,
    Task,
    copy_row,
    failed_row,
    report_fleet_errors,
    reports_there,
    write_report,
)
from eivor.logs.common import folder_sha256, folder_size
from eivor.logs.read import DEFAULT_MAX_BYTES, folder_parts
from eivor.process_pool import (
    AbandonedError,
    Executor,
    InProcess,
    LimitError,
    Limits,
    WorkerProcess,
    abandoned,
)

# -- Shard --


@dataclass(frozen=True, slots=True)
class Receipt:
    """What comes back of a task."""

    rows: int  # rows that were written
    verdicts: Mapping[str, int]  # how many of them have which verdict


@dataclass(frozen=True, slots=True)
class Shard:
    """The task."""

    folder: FleetFolder  # where the rows go
    options: FleetOptions  # what is asked of every log
    # whether each log has its limits, in a process that may die of it; else it is read in this one
    guarded: bool = True
    page_of: PageOf | None = None  # what makes the report of a flight; without one there are no reports
    only_reports: bool = False  # whether rows are there already and reports are missing

    def __call__(self, logs: tuple[Log, ...]) -> Receipt:
        """Write the rows of some logs; fewer of them when nobody waits for them any more."""
        rows: list[dict[str, Any]] = []
        try:
            for log in logs:
                if abandoned():
                    break
                self.folder.check_run()
                rows.append(self._row(log))
        except AbandonedError:
            pass
        except SupersededError:
            return Receipt(0, {})
        finally:  # an interrupt keeps what was done, too
            self._write(rows)
        return Receipt(len(rows), Counter(row["verdict"] for row in rows))

    def _write(self, rows: list[dict[str, Any]]) -> None:
        if rows and not self.only_reports:
            try:
                self.folder.write(rows, self.options.hash())
            except SupersededError:
                rows.clear()

    def _row(self, log: Log) -> dict[str, Any]:
        """Row of a log, whose report is written here: what fails at that is not the log's fault."""
        row = self._made(log)
        page = row.pop(PAGE, None)
        if page is not None:
            write_report(self.folder.folder, log.sha256, page)
        return row

    def _made(self, log: Log) -> dict[str, Any]:
        function = RowOfLog(self.options, self.page_of)
        if not self.guarded:
            return function(log)
        try:
            row: dict[str, Any] = kept_process(function, self.options.limits)(log)
        except LimitError as error:
            return failed_row(NamedRow(self.options)(log), str(error))
        return row


#: Process of each thread, which lives from one task to the next, and what it was made for.
_KEPT: dict[int, tuple[WorkerProcess, tuple[Any, Limits]]] = {}


def kept_process(function: Callable[[Any], Any], limits: Limits) -> WorkerProcess:
    """Process of this thread for a function: that of the task before, when it was for the same."""
    thread = threading.get_ident()
    process, made_for = _KEPT.get(thread, (None, None))
    if process is not None and made_for == (function, limits):
        return process
    if process is not None:
        process.close()
    _KEPT[thread] = WorkerProcess(function, limits), (function, limits)
    return _KEPT[thread][0]


def close_kept_processes() -> None:
    """End all processes that are kept here; one that is wanted again begins another."""
    while _KEPT:
        _KEPT.popitem()[1][0].close()


# -- Run --

#: Logs of a task: as few as give the number of tasks that progress is reported by, and at most so many.
TASKS, MOST_LOGS = 100, 200
#: Copies whose rows are one part.
COPIES = 2_000

#: Called with the number of logs that are done, and that of all; first with what was there already.
Progress = Callable[[int, int], None]


def no_progress(_done: int, _total: int, /) -> None:
    """Report to no one how much is done."""


@dataclass(frozen=True, slots=True)
class FleetRun:
    """What a run has done."""

    folder: Path  # of the fleet
    logs: int  # logs that were found, each of which has a row
    before: int  # those whose row was there already
    verdicts: Mapping[str, int]  # verdicts of the rows of all these logs
    others: int  # files that are no logs
    unread_folders: tuple[str, ...]  # folders that could not be looked into, and why
    elsewhere: int  # further rows of the motion in the folder, of logs that were not among these


def all_hashed(logs: tuple[Log, ...]) -> tuple[Log, ...]:
    """Logs with the hash of their bytes, or why they cannot be opened."""
    return tuple(map(hashed, logs))


def run_fleet(
    logs_found: LogsFound,
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
    """Make the rows of a fleet that are not there yet."""
    if not logs_found.logs:
        raise InputError(
            "a folder, a pattern or a list with logs in it",
            f"none ({logs_found.others} other files)",
            "Check the path; a log of a table with names of its own needs the ending .csv or .parquet.",
        )
    folder = folder.absolute()
    with report_fleet_errors(folder):
        if not folder.exists() or folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
    fleet_folder = FleetFolder(folder)
    fleet_folder.check(options)
    with report_fleet_errors(folder), report_database_errors(), folder_lock(folder):
        run = _Run(fleet_folder.begin(), options, executor or InProcess(), shared, progress, page_of)
        try:
            return run.done(logs_found, guarded=guarded, shard_logs=shard_logs)
        except SupersededError as error:
            raise _taken_over(folder) from error
        finally:
            close_kept_processes()


@dataclass(frozen=True, slots=True)
class _Run:
    """A run on a folder that it holds."""

    folder: FleetFolder
    options: FleetOptions
    executor: Executor
    shared: bool
    progress: Progress
    page_of: PageOf | None

    def done(self, logs_found: LogsFound, *, guarded: bool, shard_logs: int | None) -> FleetRun:
        """Everything, from hashing to copies."""
        ledger, logs = Ledger(logs_found.logs), len(logs_found.logs)
        ledger.take_rows(self.folder.there(self.options.motion))
        self._hash(ledger)
        ledger.settle()
        opened, work, copies = ledger.opened(), ledger.count(Task.IDENTIFY), ledger.count(Task.TELL_COPY)
        before = opened - work - copies
        if before < logs:
            self.folder.state(self.options)
        self._write_unopened(ledger)
        self._identify(ledger, work, before, logs, guarded=guarded, shard_logs=shard_logs)
        self._write_copies(ledger)
        ledger.take_rows(self.folder.there(self.options.motion))
        if self.page_of is not None:
            self._report(ledger, guarded=guarded)
        self.progress(logs, logs)
        return self._summary(logs_found, ledger, logs, before)

    def _hash(self, ledger: Ledger) -> None:
        executor = self.executor if self.shared else InProcess()
        with closing(executor.map(all_hashed, ledger.logs())) as results:
            for _, logs in results:
                ledger.note(logs)

    def _write_unopened(self, ledger: Ledger) -> None:
        named = NamedRow(self.options)
        for share in range(SHARES):
            rows = [failed_row(named(log), log.problem) for log in ledger.unopened(share)]
            self.folder.replace_unopened(share, rows, ledger.has, self.options)

    def _identify(
        self,
        ledger: Ledger,
        work: int,
        done: int,
        total: int,
        *,
        guarded: bool,
        shard_logs: int | None,
    ) -> None:
        self.progress(done, total)
        task = Shard(self.folder, self.options, guarded, self.page_of)
        logs = ledger.of_task(Task.IDENTIFY, shard_logs or _task_logs(work))
        with closing(self.executor.map(task, logs)) as receipts:
            for _, receipt in receipts:
                done += receipt.rows
                self.progress(done, total)

    def _report(self, ledger: Ledger, *, guarded: bool) -> None:
        """Reports of logs whose rows were there before."""
        with closing(reports_there(self.folder.folder)) as there:
            ledger.settle_reports(there)
        task = Shard(self.folder, self.options, guarded, self.page_of, only_reports=True)
        logs = ledger.of_task(Task.REPORT, _task_logs(ledger.count(Task.REPORT)))
        with closing(self.executor.map(task, logs)) as receipts:
            for _ in receipts:
                pass

    def _write_copies(self, ledger: Ledger) -> None:
        named = NamedRow(self.options)
        for copies in ledger.of_task(Task.TELL_COPY, COPIES):
            rows = [copy_row(named(log), ledger.first(log)) for log in copies]
            self.folder.write(rows, self.options.hash())

    def _summary(self, logs_found: LogsFound, ledger: Ledger, logs: int, before: int) -> FleetRun:
        verdicts, opened = Counter(ledger.verdicts()), ledger.opened()
        rows = verdicts.total()
        if rows != opened:
            raise _taken_over(self.folder.folder)
        verdicts[FAILED] += logs - opened
        return FleetRun(
            self.folder.folder,
            logs,
            before,
            +verdicts,
            logs_found.others,
            logs_found.unread_folders,
            ledger.rows() - rows,
        )


def _task_logs(work: int) -> int:
    return min(MOST_LOGS, max(1, work // TASKS))


def _taken_over(folder: Path) -> InputError:
    return InputError(
        "a folder that is this run's until it is done",
        f"'{folder}', in which rows are missing that were written, or which another run has begun on",
        "Run the same again: what is there is kept.",
    )


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
