"""Jobs: what was asked of which logs, how far it is, and where its files are."""

from __future__ import annotations

import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any

from eivor.serve.asked_json import AskedJob
from eivor.serve.refusals import RefusedError, absent
from eivor.serve.tasks import REPORT, Found, Identify, KeptLog, Outcome, Refused, Stage, Task
from eivor.serve.workers import Ticket, Workers

#: Jobs that are over and remembered.
MOST_REMEMBERED = 500
#: Something is said at least so often [s].
HEARTBEAT_S = 1.0
#: The stage before a process takes a job.
WAITING = "waiting"

Event = dict[str, Any]


class Job:
    """A job and what has happened of it."""

    def __init__(
        self,
        name: str,
        asked: AskedJob,
        logs: dict[str, KeptLog],
        folder: Path,
        workers: Workers,
        clock: Callable[[], float],
    ) -> None:
        self.name, self.asked, self.folder = name, asked, folder
        self.logs = tuple(logs)
        self.over_at: float | None = None
        self.cancelled = False
        self._workers, self._clock = workers, clock
        self._change = threading.Condition()
        self._begun_at = time.monotonic()
        self._events: list[Event] = [{"stage": WAITING}]
        self._report: Refused | None = None
        self._working = True
        self.stem = next(iter(logs.values())).name.rpartition(".")[0] or "flight"
        self._ticket = Ticket(
            Identify(asked, logs, folder), begun=self._began, report=self._heard, ended=self._ended
        )
        workers.put(self._ticket)

    @property
    def working(self) -> bool:
        """Whether a process may still use its logs and its folder."""
        return self._working

    def events(self) -> Iterator[Event]:
        """Everything that has happened, and what happens, to the last; something each second."""
        told = 0
        while True:
            with self._change:
                self._change.wait_for(partial(self._has_more, told), timeout=HEARTBEAT_S)
                new, told = self._events[told:], len(self._events)
                last = self._events[-1]
            for event in new or [last]:
                yield self._timed(event) if "stage" in event else event
            if "stage" not in last:
                return

    def _has_more(self, told: int) -> bool:
        return len(self._events) > told

    def _timed(self, event: Event) -> Event:
        timed = {**event, "elapsed": round(time.monotonic() - self._begun_at, 2)}
        if event["stage"] == WAITING:
            timed["position"] = self._workers.position(self._ticket)
        return timed

    def cancel(self) -> None:
        """Give it up: its process is ended, or it does not begin."""
        self.cancelled = True
        self._workers.give_up(self._ticket)

    def result_folder(self) -> Path:
        """Folder with its result."""
        with self._change:
            last = self._events[-1]
        if "done" not in last:
            raise RefusedError(
                HTTPStatus.CONFLICT,
                "a job with a result",
                "one that is not done" if "stage" in last else "one that has none",
                "See its events.",
            )
        return self.folder

    def report(self) -> Path:
        """File of its report, once it is there."""
        folder = self.result_folder()
        with self._change:
            self._change.wait_for(lambda: not self._working)
        if self._report is not None:
            told = self._report.told
            raise RefusedError(
                HTTPStatus(self._report.status), told["expected"], told["received"], told["advice"]
            )
        if not (folder / REPORT).exists():
            raise absent("a report", self.name)
        return folder / REPORT

    def _began(self) -> None:
        self._begun_at = time.monotonic()

    def _heard(self, told: Any) -> None:
        with self._change:
            if "stage" in self._events[-1]:  # after the verdict the report is written
                if isinstance(told, Found):
                    self._over({"done": {"status": told.status}})
                elif isinstance(told, Stage):
                    self._events.append({"stage": told.name})
                    self._change.notify_all()

    def _ended(self, outcome: Outcome) -> None:
        with self._change:
            self._working = False
            if "stage" not in self._events[-1]:
                self._report = outcome if isinstance(outcome, Refused) else None
                self._change.notify_all()
            elif isinstance(outcome, Refused):
                self._over({"failed": outcome.told})
            else:
                self._over({"cancelled": True})

    def _over(self, event: Event) -> None:
        self._events.append(event)
        self.over_at = self._clock()
        self._change.notify_all()


class Jobs:
    """The jobs of a run."""

    def __init__(self, folder: Path, workers: Workers, clock: Callable[[], float]) -> None:
        self._folder, self._workers, self._clock = folder, workers, clock
        self._jobs: dict[str, Job] = {}
        self._lock = threading.Lock()
        folder.mkdir(mode=0o700)

    def begin(self, asked: AskedJob, logs: dict[str, KeptLog]) -> str:
        """Queue a job; its identifier."""
        name = secrets.token_hex(16)
        folder = self._folder / name
        folder.mkdir(mode=0o700)
        try:
            job = Job(name, asked, logs, folder, self._workers, self._clock)
        except RefusedError:
            shutil.rmtree(folder)
            raise
        with self._lock:
            self._jobs[name] = job
            over = [one for one in self._jobs.values() if not one.working]
            for old in over[: max(len(over) - MOST_REMEMBERED, 0)]:
                self._forget(old)
        return name

    def get(self, name: str) -> Job:
        """Job of an identifier."""
        with self._lock:
            if name not in self._jobs:
                raise absent("a job", name)
            return self._jobs[name]

    def end(self, name: str) -> None:
        """Cancel a job that is not over, forget one that is."""
        job = self.get(name)
        if job.over_at is None:
            job.cancel()
            return
        with self._lock:
            self._forget(job)

    def in_use(self) -> set[str]:
        """Logs that jobs work on, or will."""
        with self._lock:
            return {log for job in self._jobs.values() if job.working for log in job.logs}

    def forget_older(self, age_s: float) -> None:
        """Forget jobs that have been over for so long."""
        oldest = self._clock() - age_s
        with self._lock:
            for job in list(self._jobs.values()):
                if job.over_at is not None and job.over_at < oldest:
                    self._forget(job)

    def do(self, task: Task) -> Outcome:
        """Outcome of something small that somebody waits for."""
        ticket = Ticket(task, urgent=True)
        self._workers.put(ticket)
        return ticket.outcome()

    def _forget(self, job: Job) -> None:
        job.cancel()  # its report may still be written
        self._jobs.pop(job.name, None)
        shutil.rmtree(job.folder, ignore_errors=True)
