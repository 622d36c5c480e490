"""Tasks, worker processes, jobs and uploaded logs of the page."""

from __future__ import annotations

import math
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path, PurePosixPath
from pkgutil import resolve_name
from typing import Any
from urllib.parse import unquote

from eivor.atomic_file import atomic_write
from eivor.process_pool import BEGIN_S, AbandonedError, LimitError, Limits, ProgressCallback, WorkerProcess
from eivor.serve.requests import JobRequest, RefusedError, absent

#: Files of a result in the folder of its job.
RESULT, REPORT = "result.json", "report.html"


@dataclass(frozen=True, slots=True)
class KeptLog:
    """A log on the disk."""

    path: Path  # where it is; its name there says nothing
    name: str  # what its user calls it
    size: int  # bytes


@dataclass(frozen=True, slots=True)
class Task:
    """Work for a process: the name of a function of `eivor.serve.worker`, and its arguments."""

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class File:
    """A file that is sent."""

    name: str  # what it is called
    text: str | bytes  # content


#: A file, choices of the page or of exports, the error that came instead, or nothing.
Outcome = File | dict[str, object] | list[dict[str, object]] | RefusedError | None
#: Its progress are events: `stage`, or `done` with the verdict as soon as the result is written.
WorkFunction = Callable[[Task, ProgressCallback], Outcome]
Event = dict[str, Any]


def work(task: Task, report: ProgressCallback) -> Outcome:
    """Outcome of a task in a worker process, which alone loads what that needs."""
    return resolve_name("eivor.serve.worker:outcome_of")(task, report)


#: A process that has worked ends after so long without work [s]; tasks that wait at most.
IDLE_S, MOST_WAITING = 10.0, 256
#: By which logs and jobs grow old.
clock = time.monotonic


@dataclass(eq=False)
class Ticket:
    """A task on its way through the queue."""

    task: Task
    on_start: Callable[[], None] = lambda: None  # called when a process takes it
    report: ProgressCallback = lambda _event: None  # takes progress
    urgent: bool = False  # whether it goes before those that are not
    given_up: bool = False
    outcome: Future[Outcome] = field(default_factory=Future)  # None where it was given up


class Workers:
    """At most `count` processes that do tasks by `work`, each within its limits, and the queue."""

    def __init__(self, count: int, limits: Limits, function: WorkFunction) -> None:
        self._limits, self._function = limits, function
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(count)
        self._waiting: list[Ticket] = []
        self._free: list[tuple[WorkerProcess, float]] = []  # and when it worked last; infinite for never
        self._closed = False
        self._choices = self._first_task()

    def put(self, ticket: Ticket) -> None:
        """Queue a task; a `RefusedError` when too many wait."""
        with self._lock:
            if self._closed or len(self._waiting) >= MOST_WAITING:
                expected = f"at most {MOST_WAITING} tasks that wait"
                remedy = "Wait until some are done, or cancel them."
                raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, expected, "one more", remedy)
            position = sum(item.urgent for item in self._waiting) if ticket.urgent else len(self._waiting)
            self._waiting.insert(position, ticket)
            self._threads.submit(self._run_next)

    def position(self, ticket: Ticket) -> int:
        """How many are before a task, and it; zero when it waits no more."""
        with self._lock:
            return self._waiting.index(ticket) + 1 if ticket in self._waiting else 0

    def give_up(self, ticket: Ticket) -> None:
        """Take a task out of the queue, or end the process that works on it."""
        ticket.given_up = True
        with self._lock:
            waited = ticket in self._waiting
            if waited:
                self._waiting.remove(ticket)
        if waited:
            ticket.outcome.set_result(None)

    def choices(self) -> dict[str, object]:
        """What may be chosen, as the first process reports it; a `RefusedError` when it does not begin."""
        with suppress(TimeoutError):
            outcome = self._choices.outcome.result(BEGIN_S)
            if isinstance(outcome, dict):
                return outcome
            self._choices = self._first_task()
        remedy = "Stop `eivor serve` and start it again."
        raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "a worker process that begins", "none", remedy)

    def end_idle(self) -> None:
        """End processes that have worked and wait for long; a new one waits in their place."""
        with self._lock:
            idle = [item for item in self._free if item[1] < time.monotonic() - IDLE_S]
            self._free = [item for item in self._free if item not in idle]
            begin = idle and not self._free
        for process, _ in idle:
            process.close()
        with suppress(RefusedError):
            if begin:
                self._first_task()

    def close(self) -> None:
        with self._lock:
            self._closed = True
            waiting = list(self._waiting)
        for ticket in waiting:
            self.give_up(ticket)
        self._threads.shutdown()
        for process, _ in self._free:
            process.close()

    def _first_task(self) -> Ticket:
        ticket = Ticket(Task("choices"), urgent=True)
        self.put(ticket)
        return ticket

    def _run_next(self) -> None:
        """Do the first task that waits, if any, in the process that worked last."""
        with self._lock:
            if not self._waiting:  # it was given up
                return
            ticket = self._waiting.pop(0)
            new = WorkerProcess(self._function, self._limits), math.inf
            process, worked_at = self._free.pop() if self._free else new
        ticket.on_start()
        outcome = self._run(process, ticket)
        with self._lock:
            is_first = ticket.task.name == "choices"
            self._free.append((process, worked_at if is_first else time.monotonic()))
        ticket.outcome.set_result(outcome)

    def _run(self, process: WorkerProcess, ticket: Ticket) -> Outcome:
        try:
            outcome: Outcome = process(
                ticket.task, report=ticket.report, given_up=lambda: ticket.given_up or self._closed
            )
        except AbandonedError:
            return None
        except (LimitError, OSError) as error:
            sentence, limits = str(error), self._limits
            return RefusedError(
                HTTPStatus.INTERNAL_SERVER_ERROR,
                f"a log that takes at most {limits.time_s:g} s and {limits.memory_gb:g} GB",
                f"another one ({sentence[:1].lower()}{sentence[1:].removesuffix('.')})",
                "Cut the log to the manoeuvre of interest, or start with more: "
                "eivor serve --time S --memory GB.",
            )
        return outcome


#: Jobs that are over and remembered.
MOST_REMEMBERED = 500
#: Something is said at least so often [s].
HEARTBEAT_S = 1.0
#: The stage before a process takes a job.
WAITING = "waiting"


class Job:
    """A job and what has happened of it."""

    def __init__(
        self, name: str, job_request: JobRequest, logs: dict[str, KeptLog], folder: Path, workers: Workers
    ) -> None:
        self.name, self.request, self.folder = name, job_request, folder
        self.logs = tuple(logs)
        self.over_at: float | None = None
        self.cancelled = False
        self._workers = workers
        self._change = threading.Condition()
        self._begun_at = time.monotonic()
        self._events: list[Event] = [{"stage": WAITING}]
        self._report: RefusedError | None = None
        self.working = True  # a process may still use its logs and its folder
        self.stem = next(iter(logs.values())).name.rpartition(".")[0] or "flight"
        arguments = {"request": job_request, "logs": logs, "folder": folder}
        self._ticket = Ticket(Task("identify", arguments), on_start=self._on_start, report=self._on_event)
        self._ticket.outcome.add_done_callback(lambda outcome: self._on_outcome(outcome.result()))
        workers.put(self._ticket)

    def events(self) -> Iterator[Event]:
        """Everything that has happened, and what happens, to the last; something each second."""
        sent = 0
        while True:
            with self._change:
                if len(self._events) == sent:
                    self._change.wait(timeout=HEARTBEAT_S)
                new, sent = self._events[sent:], len(self._events)
                last = self._events[-1]
            for event in new or [last]:
                yield self._timed(event) if "stage" in event else event
            if "stage" not in last:
                return

    def _timed(self, event: Event) -> Event:
        timed = {**event, "elapsed": round(time.monotonic() - self._begun_at, 2)}
        if event["stage"] == WAITING:
            timed["position"] = self._workers.position(self._ticket)
        return timed

    def cancel(self) -> None:
        self.cancelled = True
        self._workers.give_up(self._ticket)

    def result_folder(self) -> Path:
        last = self._events[-1]
        if "done" not in last:
            received = "one that is not done" if "stage" in last else "one that has none"
            raise RefusedError(HTTPStatus.CONFLICT, "a job with a result", received, "See its events.")
        return self.folder

    def report(self) -> Path:
        folder = self.result_folder()
        with self._change:
            self._change.wait_for(lambda: not self.working)
        if self._report is not None:
            raise self._report
        if not (folder / REPORT).exists():
            raise absent("a report", self.name)
        return folder / REPORT

    def _on_start(self) -> None:
        self._begun_at = time.monotonic()

    def _on_event(self, event: Event) -> None:
        with self._change:
            if "stage" in self._events[-1]:  # after the verdict the report is written
                self._add(event)

    def _on_outcome(self, outcome: Outcome) -> None:
        with self._change:
            self.working = False
            refused = outcome if isinstance(outcome, RefusedError) else None
            if "stage" not in self._events[-1]:
                self._report = refused
                self._change.notify_all()
            else:
                self._add({"failed": refused.parts} if refused else {"cancelled": True})

    def _add(self, event: Event) -> None:
        self._events.append(event)
        if "stage" not in event:
            self.over_at = clock()
        self._change.notify_all()


class Jobs:
    """The jobs of a run."""

    def __init__(self, folder: Path, workers: Workers) -> None:
        self._folder, self._workers = folder, workers
        self._jobs: dict[str, Job] = {}
        self._lock = threading.Lock()
        folder.mkdir(mode=0o700)

    def begin(self, job_request: JobRequest, logs: dict[str, KeptLog]) -> str:
        name = secrets.token_hex(16)
        folder = self._folder / name
        folder.mkdir(mode=0o700)
        try:
            job = Job(name, job_request, logs, folder, self._workers)
        except RefusedError:
            shutil.rmtree(folder)
            raise
        with self._lock:
            self._jobs[name] = job
            finished = [_job for _job in self._jobs.values() if not _job.working]
            for old in finished[: max(len(finished) - MOST_REMEMBERED, 0)]:
                self._forget(old)
        return name

    def get(self, name: str) -> Job:
        job = self._jobs.get(name)
        if job is None:
            raise absent("a job", name)
        return job

    def end(self, name: str) -> None:
        job = self.get(name)
        if job.over_at is None:
            job.cancel()
            return
        with self._lock:
            self._forget(job)

    def in_use(self) -> set[str]:
        with self._lock:
            return {log for job in self._jobs.values() if job.working for log in job.logs}

    def forget_older(self, age_s: float) -> None:
        oldest = clock() - age_s
        with self._lock:
            for job in list(self._jobs.values()):
                if job.over_at is not None and job.over_at < oldest:
                    self._forget(job)

    def do(self, task: Task) -> Outcome:
        ticket = Ticket(task, urgent=True)
        self._workers.put(ticket)
        return ticket.outcome.result()

    def _forget(self, job: Job) -> None:
        job.cancel()  # its report may still be written
        self._jobs.pop(job.name, None)
        shutil.rmtree(job.folder, ignore_errors=True)


#: Letters of a name that are shown.
LONGEST_NAME = 255
#: So many logs of the largest size are kept at once.
LARGEST_KEPT = 4
#: What is left free on the disk [bytes].
LEFT_FREE = 200_000_000
#: Endings that files keep; their content says what they are.
LONGEST_ENDING = 12


class KeptLogs:
    """The logs of a run."""

    def __init__(self, folder: Path, largest: int) -> None:
        self._folder, self._largest = folder, largest
        self._entries: dict[str, tuple[KeptLog, float]] = {}  # and when it was used last
        self._coming = 0
        self._lock = threading.Lock()
        folder.mkdir(mode=0o700)

    def keep(
        self,
        name: str,
        size: int,
        files: Iterable[tuple[str, Iterator[bytes]]],
        in_use: Callable[[], Collection[str]],
    ) -> str:
        self._make_room(size, in_use())
        try:
            log = secrets.token_hex(16)
            ending = PurePosixPath(name).suffix.lower()
            is_plain = ending[1:].isascii() and ending[1:].isalnum() and len(ending) <= LONGEST_ENDING
            path = self._folder / f"{log}{ending if is_plain else ''}"
            _write(path, files)
            with self._lock:
                self._entries[log] = KeptLog(path, name, size), clock()
        finally:
            with self._lock:
                self._coming -= size
        return log

    def _make_room(self, size: int, in_use: Collection[str]) -> None:
        """Forget the oldest logs that nobody works on, until another one has room."""
        with self._lock:
            limit = LARGEST_KEPT * self._largest
            free = shutil.disk_usage(self._folder).free - LEFT_FREE - self._coming
            oldest = sorted(set(self._entries) - set(in_use), key=lambda item: self._entries[item][1])
            kept = sum(kept.size for kept, _ in self._entries.values()) + self._coming
            while (kept + size > limit or size > free) and oldest:
                freed = self._forget(oldest.pop(0))
                kept, free = kept - freed, free + freed
            if kept + size > limit or size > free:
                expected = f"room for {size} bytes more"
                remedy = "Wait until flights are identified, or make room on the disk."
                raise RefusedError(HTTPStatus.INSUFFICIENT_STORAGE, expected, "none", remedy)
            self._coming += size

    def get(self, log: str) -> KeptLog:
        with self._lock:
            if log not in self._entries:
                raise absent("a log", log)
            kept, _ = self._entries[log]
            self._entries[log] = kept, clock()
            return kept

    def forget(self, log: str) -> None:
        with self._lock:
            if log not in self._entries:
                raise absent("a log", log)
            self._forget(log)

    def forget_older(self, age_s: float, in_use: Collection[str]) -> None:
        """Delete the logs that nobody has used for so long, or works on."""
        with self._lock:
            oldest = clock() - age_s
            for log, (_, used_at) in list(self._entries.items()):
                if used_at < oldest and log not in in_use:
                    self._forget(log)

    def _forget(self, log: str) -> int:
        kept, _ = self._entries.pop(log)
        _delete(kept.path)
        return kept.size


def _write(path: Path, files: Iterable[tuple[str, Iterator[bytes]]]) -> None:
    try:
        for name, chunks in files:
            if name:
                path.mkdir(mode=0o700, exist_ok=True)
            with atomic_write(path / name if name else path) as file:
                for chunk in chunks:
                    file.write(chunk)
    except BaseException:
        _delete(path)
        raise


def _delete(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def shown_name(header: str) -> str:
    """Name of a log out of its header: percent-encoded, without folders."""
    name = unquote(header, errors="replace").replace("\\", "/").rpartition("/")[2]
    return name.replace("\0", "").strip()[:LONGEST_NAME] or "log"
