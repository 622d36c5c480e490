"""The task of a fleet's run: some logs to one part of the table, of which only a receipt comes back."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from eivor.fleets.fleet_folder import FleetFolder, SupersededError
from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.flight_row import FlightRow, NamedRow, failed_row
from eivor.fleets.log_list import Log
from eivor.fleets.own_reports import PAGE, PageOf, write_report
from eivor.process_pool import AbandonedError, LimitError, Limits, WorkerProcess, abandoned


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
        function = FlightRow(self.options, self.page_of)
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
