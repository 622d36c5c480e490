"""Identification of many logs in several processes."""

from __future__ import annotations

import hashlib
import stat
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl

from eivor import process_pool
from eivor.atomic_file import folder_lock
from eivor.errors import InputError
from eivor.fleet import table
from eivor.fleet.logs import Log, LogList, LogsFound
from eivor.logs.common import folder_sha256, folder_size
from eivor.logs.read import DEFAULT_MAX_BYTES, folder_parts, is_address, is_local, path_of
from eivor.tools import ItemsDone, no_items_callback


@dataclass(frozen=True, slots=True)
class Shard:
    """The task."""

    folder: table.FleetFolder  # where the rows go
    options: table.FleetOptions  # what is asked of every log
    page_of: table.PageOf | None = None  # what makes the report of a flight; without one there are no reports
    only_reports: bool = False  # whether rows are there already and reports are missing

    def __call__(self, logs: tuple[Log, ...]) -> int:
        """Write the rows of some logs, and count them; fewer when nobody waits for them any more."""
        rows: list[dict[str, Any]] = []
        try:
            for log in logs:
                if process_pool.abandoned():
                    break
                self.folder.check_run()
                rows.append(self._row(log))
        except process_pool.AbandonedError:
            pass
        except table.SupersededError:
            return 0
        finally:  # an interrupt keeps what was done, too
            with suppress(table.SupersededError):
                if rows and not self.only_reports:
                    self.folder.write(rows)
        return len(rows)

    def _row(self, log: Log) -> dict[str, Any]:
        """Row of a log, whose report is written here: what fails at that is not the log's fault."""
        function = table.RowOfLog(self.options, self.page_of)
        try:  # in a process that may die of it
            row: dict[str, Any] = kept_process(function, self.options.limits)(log)
        except process_pool.LimitError as error:
            return table.failed_row(self.options.row_of(log), str(error))
        page = row.pop(table.PAGE, None)
        if page is not None:
            table.write_report(self.folder.folder, log.sha256, page)
        return row


#: Process of each thread, which lives from one task to the next, and what it was made for.
_KEPT: dict[int, tuple[process_pool.WorkerProcess, tuple[Any, process_pool.Limits]]] = {}


def kept_process(function: Callable[[Any], Any], limits: process_pool.Limits) -> process_pool.WorkerProcess:
    """Process of this thread for a function: that of the task before, when it was for the same."""
    thread = threading.get_ident()
    process, made_for = _KEPT.get(thread, (None, None))
    if process is not None and made_for == (function, limits):
        return process
    if process is not None:
        process.close()
    _KEPT[thread] = process_pool.WorkerProcess(function, limits), (function, limits)
    return _KEPT[thread][0]


#: Columns that identify the log and content of a row, and those that hashing a log fills.
KEY, HASHED = ["sha256", "name"], ("sha256", "problem")


def _work_of(logs: pl.DataFrame, rows: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame, pl.DataFrame]:
    """Logs that could be opened; of each content without a row the first by name; copies without a row."""
    opened = logs.filter(pl.col("sha256").is_not_null())
    existing = rows.filter(pl.col("verdict") != table.COPY).unique("sha256", keep="last", maintain_order=True)
    firsts = pl.concat(
        [
            existing.select("sha256", first="name", is_there=True),
            opened.group_by("sha256").agg(first=pl.col("name").min()).with_columns(is_there=False),
        ]
    ).unique("sha256", keep="first", maintain_order=True)
    opened = opened.join(firsts, on="sha256", how="left", maintain_order="left")
    is_first = pl.col("name") == pl.col("first")
    copies = opened.filter(~is_first).join(rows, on=KEY, how="anti", maintain_order="left")
    return opened, opened.filter(is_first & ~pl.col("is_there")), copies


#: Logs of a task: as few as give the number of tasks that progress is reported by, and at most so many.
TASKS, MOST_LOGS = 100, 200
#: Rows are taken into the table again after so many seconds, and so many times as long as it took.
MERGE_S, MERGE_TIMES = 60.0, 20.0


@dataclass(frozen=True, slots=True)
class FleetRun:
    """Result of a run."""

    logs: int  # logs that were found, each of which has a row
    before: int  # those whose row was there already
    verdicts: Mapping[str, int]  # verdicts of the rows of all these logs
    others: int  # files that are no logs
    unread_folders: tuple[str, ...]  # folders that could not be looked into, and why
    elsewhere: int  # further rows of the motion in the folder, of logs that were not among these


def _hash_page(logs: tuple[Log, ...]) -> tuple[Log, ...]:
    return tuple(map(hashed, logs))


def run_fleet(
    logs_found: LogsFound,
    folder: Path,
    options: table.FleetOptions,
    *,
    executor: process_pool.Executor | None = None,
    shared: bool = False,
    progress: ItemsDone = no_items_callback,
    page_of: table.PageOf | None = None,
) -> FleetRun:
    """Make the rows of a fleet that are not there yet."""
    if not logs_found.logs:
        expected = "a folder, a pattern or a list with logs in it"
        remedy = "Check the path; a log of a table with names of its own needs the ending .csv or .parquet."
        raise InputError(expected, f"none ({logs_found.others} other files)", remedy)
    folder = folder.absolute()
    with table.report_fleet_errors(folder):
        if not folder.exists() or folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
    fleet_folder = table.FleetFolder(folder)
    fleet_folder.check(options)
    with table.report_fleet_errors(folder), hold(folder):
        shard, local = Shard(fleet_folder.begin(), options, page_of), process_pool.InProcess()
        try:
            logs = _hash_logs(logs_found.logs, executor if shared and executor else local)
            return _run_shard(shard, logs_found, logs, executor or local, progress)
        except table.SupersededError as error:
            raise _taken_over(folder) from error
        finally:
            while _KEPT:
                _KEPT.popitem()[1][0].close()


def hold(folder: Path) -> AbstractContextManager[None]:
    """Hold a folder; elsewhere there are no locks, and a run ends the writing of those before it."""
    return folder_lock(folder) if is_local(folder) else nullcontext()


def compact_fleet(folder: Path) -> tuple[int, int]:
    """Take all rows of a fleet into its table, and count its rows and its files."""
    table.read_flights(folder, ["name"])
    with table.report_fleet_errors(folder), hold(folder):
        table.FleetFolder(folder).begin().merge()
    return table.read_flights(folder, ["name"]).height, len(table.part_files(folder))


def _run_shard(
    shard: Shard,
    logs_found: LogsFound,
    logs: pl.DataFrame,
    executor: process_pool.Executor,
    progress: ItemsDone,
) -> FleetRun:
    folder, options = shard.folder, shard.options
    opened, new, copies = _work_of(logs, folder.opened_rows(options.motion))
    total, before = logs.height, opened.height - new.height - copies.height
    if before < total:
        folder.state(options)
    folder.replace_unopened(logs, options)
    progress(before, total)
    motion, due, count = options.chosen_motion(), time.monotonic() + MERGE_S, before
    for rows in _mapped(executor, shard, new):
        count += rows
        progress(count, total)
        if (start_s := time.monotonic()) > due:
            folder.merge(motion)
            due = time.monotonic() + max(MERGE_S, MERGE_TIMES * (time.monotonic() - start_s))
    for part in copies.iter_slices(2_000):
        copied = []
        for log, first in zip(LogList(part), part["first"], strict=True):
            reason = f"A copy of {first}, whose row has the numbers."
            about = {"copy_of": log.sha256, "verdict": table.COPY, "reason": reason}
            copied.append(options.row_of(log) | about)
        folder.write(copied)
    folder.merge(motion)
    stored = folder.opened_rows(options.motion)
    if shard.page_of is not None:
        with closing(table.reports_there(folder.folder)) as reports:
            reported = pl.DataFrame({"sha256": list(reports)}, schema={"sha256": pl.String})
        results = stored.filter(~pl.col("verdict").is_in([table.COPY, table.FAILED]))
        unreported = logs.join(results, on=KEY, how="semi", maintain_order="left")
        unreported = unreported.join(reported, on="sha256", how="anti", maintain_order="left")
        for _ in _mapped(executor, replace(shard, only_reports=True), unreported):
            pass
    progress(total, total)
    verdicts = Counter(stored.join(opened, on=KEY, how="semi")["verdict"])
    rows = verdicts.total()
    if rows != opened.height:
        raise _taken_over(folder.folder)
    verdicts[table.FAILED] += total - rows
    others, unread = logs_found.others, logs_found.unread_folders
    return FleetRun(total, before, +verdicts, others, unread, stored.height - rows)


def _hash_logs(logs: LogList, executor: process_pool.Executor) -> pl.DataFrame:
    """The list with the hash of each log, or the reason why it cannot be opened."""
    pages: dict[int, pl.DataFrame] = {}
    with closing(executor.map(_hash_page, logs.pages())) as results:
        for number, page in results:
            hashes = [(log.sha256 or None, log.problem) for log in page]
            pages[number] = pl.DataFrame(hashes, schema=dict.fromkeys(HASHED, pl.String), orient="row")
    return logs.table.with_columns(pl.concat([pages[number] for number in sorted(pages)]))


def _mapped(executor: process_pool.Executor, shard: Shard, logs: pl.DataFrame) -> Iterable[int]:
    size = min(MOST_LOGS, max(1, logs.height // TASKS))
    with closing(executor.map(shard, LogList(logs).pages(size))) as results:
        for _, rows in results:
            yield rows


def _taken_over(folder: Path) -> InputError:
    received = f"'{folder}', in which rows are missing that were written, or which another run has begun on"
    remedy = "Run the same again: what is there is kept."
    return InputError("a folder that is this run's until it is done", received, remedy)


def hashed(log: Log) -> Log:
    """A log with the hash of its bytes, or with the reason why it cannot be opened."""
    path, remote = path_of(log.path), is_address(log.path)
    try:
        status = path.stat()
        is_folder = not remote and stat.S_ISDIR(status.st_mode) and bool(folder_parts(path).members)
        if not is_folder and not (remote or stat.S_ISREG(status.st_mode)):
            return replace(log, problem="It is no regular file.")
        size = folder_size(path) if is_folder else status.st_size
        if size > DEFAULT_MAX_BYTES:
            problem = f"It has {size} bytes, more than the {DEFAULT_MAX_BYTES} that are read."
            return replace(log, problem=problem)
        if is_folder:
            return replace(log, sha256=folder_sha256(path))
        with path.open("rb") as stream:
            return replace(log, sha256=hashlib.file_digest(stream, "sha256").hexdigest())
    except (OSError, ValueError) as error:
        return replace(log, problem=f"It cannot be opened: {getattr(error, 'strerror', None) or error}.")
