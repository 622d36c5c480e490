"""Jobs of the server: tasks, kept logs and worker processes."""

from __future__ import annotations

import asyncio
import hmac
import html
import os
import re
import secrets
import shutil
import socket
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from importlib import resources
from pathlib import Path, PurePosixPath
from pkgutil import resolve_name
from typing import Any, cast
from urllib.parse import parse_qs, quote, unquote

import anyio.from_thread
import anyio.to_thread
import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from eivor.atomic_file import whole_file
from eivor.errors import EivorError
from eivor.process_pool import BEGIN_S, AbandonedError, LimitError, Limits, ProgressCallback, WorkerProcess
from eivor.serve.app import page_text
from eivor.serve.requests import AskedJob, RefusedError, Told, absent, asked_job, sent_files, status_of, told

# -- Tasks --

#: Files of a result in the folder of its job.
RESULT, REPORT = "result.json", "report.html"


@dataclass(frozen=True, slots=True)
class KeptLog:
    """A log on the disk."""

    path: Path  # where it is; its name there says nothing
    name: str  # what its user calls it
    size: int  # bytes


@dataclass(frozen=True, slots=True)
class Begin:
    """Say what may be chosen."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What may be chosen, as the page is given it."""

    known: Mapping[str, object]  # see `eivor.serve`


@dataclass(frozen=True, slots=True)
class Identify:
    """Identify logs, and write result and report into a folder; progress is stages and the verdict."""

    asked: AskedJob  # what of them
    logs: Mapping[str, KeptLog]  # by identifier
    folder: Path  # of the job


@dataclass(frozen=True, slots=True)
class Supply:
    """What is known beside the flight, as words."""

    mass: str = ""  # as on the command line
    vehicle: str = ""  # by its name, or as the text of a file
    priors: tuple[str, ...] = ()  # as on the command line


@dataclass(frozen=True, slots=True)
class ListExports:
    """Say of every target whether it can be written, and what stands in the way."""

    folder: Path  # of the job
    supply: Supply  # what is known beside
    stem: str  # what the files are called


@dataclass(frozen=True, slots=True)
class Export:
    """Write what a target takes, as a `File`."""

    folder: Path
    supply: Supply
    stem: str
    target: str  # its word


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan the flight that would tell, and write it as a `File`."""

    folder: Path
    stem: str
    form: str  # word of the kind of file
    home: str = ""  # place of a mission, as words
    target: str = ""  # what the flight is to tell; empty for what the result could not


@dataclass(frozen=True, slots=True)
class File:
    """A file that is sent."""

    name: str  # what it is called
    text: str  # content


@dataclass(frozen=True, slots=True)
class Stage:
    """Told on the way: what begins."""

    name: str


@dataclass(frozen=True, slots=True)
class Found:
    """Told on the way: the result is written, and its verdict."""

    status: str


@dataclass(frozen=True, slots=True)
class Refused:
    """In place of a result: the error that came instead."""

    status: int  # of the answer
    told: Told = field(default_factory=dict)  # parts of the error


Task = Begin | Identify | ListExports | Export | Plan
Outcome = Choices | File | Refused | list[dict[str, object]] | None
WorkFunction = Callable[[Task, ProgressCallback], Outcome]


#: Function of the worker processes, which alone load it and what it needs.
OUTCOME_OF = "eivor.serve.worker:outcome_of"


@dataclass(frozen=True, slots=True)
class Work:
    """The function of worker processes: a task to its outcome."""

    def __call__(self, item: Task, report: ProgressCallback) -> Outcome:
        """Outcome of a task."""
        return resolve_name(OUTCOME_OF)(item, report)

    def __reduce__(self) -> tuple[Callable[[], Work], tuple[()]]:
        return _loaded, ()


def _loaded() -> Work:
    resolve_name(OUTCOME_OF)
    return Work()


# -- Workers --

#: A process that has worked ends after so long without work [s].
IDLE_S = 10.0
#: Pause before a process is begun again that did not begin [s].
AGAIN_S = 5.0


def _ignore(*_: object) -> None:
    """Take whatever is reported."""


@dataclass(eq=False)
class Ticket:
    """A task on its way through the queue."""

    task: Task
    begun: Callable[[], None] = _ignore  # called when a process takes it
    report: ProgressCallback = _ignore  # takes progress
    ended: Callable[[Outcome], None] = _ignore  # takes the outcome: None as well where it was given up
    urgent: bool = False  # whether it goes before those that are not
    given_up: bool = False
    _over: threading.Event = field(default_factory=threading.Event)
    _outcome: Outcome = None

    def end(self, outcome: Outcome) -> None:
        """Hand the outcome over."""
        self._outcome = outcome
        self.ended(outcome)
        self._over.set()

    def outcome(self) -> Outcome:
        """Outcome, once it is there."""
        self._over.wait()
        return self._outcome


class Workers:
    """At most `count` processes that do tasks by `work`, each within its limits, and the queue."""

    def __init__(self, count: int, limits: Limits, most_waiting: int, work: WorkFunction) -> None:
        self._limits, self._most_waiting = limits, most_waiting
        self._change = threading.Condition()
        self._waiting: deque[Ticket] = deque()
        self._free: set[int] = set()
        self._closed = False
        self._choices: Choices | None = None
        self._processes = [WorkerProcess(work, limits) for _ in range(count)]
        self._threads = [
            threading.Thread(target=self._work, args=(one,), daemon=True) for one in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def put(self, ticket: Ticket) -> None:
        """Queue a task; a `RefusedError` when too many wait."""
        with self._change:
            if self._closed or len(self._waiting) >= self._most_waiting:
                raise RefusedError(
                    HTTPStatus.SERVICE_UNAVAILABLE,
                    f"at most {self._most_waiting} tasks that wait",
                    "one more",
                    "Wait until some are done, or cancel them.",
                )
            place = sum(one.urgent for one in self._waiting) if ticket.urgent else len(self._waiting)
            self._waiting.insert(place, ticket)
            self._change.notify_all()

    def position(self, ticket: Ticket) -> int:
        """How many are before a task, and it; zero when it waits no more."""
        with self._change:
            return self._waiting.index(ticket) + 1 if ticket in self._waiting else 0

    def give_up(self, ticket: Ticket) -> None:
        """Take a task out of the queue, or end the process that works on it."""
        ticket.given_up = True
        with self._change:
            waited = ticket in self._waiting
            if waited:
                self._waiting.remove(ticket)
        if waited:
            ticket.end(None)

    def choices(self) -> Choices:
        """What may be chosen, as the first process reports it; a `RefusedError` when it does not begin."""
        with self._change:
            self._change.wait_for(lambda: self._choices is not None or self._closed, timeout=BEGIN_S)
            if self._choices is None:
                raise RefusedError(
                    HTTPStatus.SERVICE_UNAVAILABLE,
                    "a worker process that begins",
                    "none",
                    "Stop `eivor serve` and start it again.",
                )
            return self._choices

    def pids(self) -> list[int]:
        """Processes that wait for work."""
        return [process.pid for process in self._processes if process.pid is not None]

    def close(self) -> None:
        """End all processes; what waits is given up."""
        with self._change:
            self._closed = True
            waiting = list(self._waiting)
            self._change.notify_all()
        for ticket in waiting:
            self.give_up(ticket)
        for thread in self._threads:
            thread.join()

    def _work(self, number: int) -> None:
        """Take one task after the other, until it is closed."""
        process, has_worked = self._processes[number], False
        try:
            while not self._closed:
                if number == 0 and process.pid is None and not self._began(process):
                    continue
                ticket = self._next(number, IDLE_S if has_worked else None)
                has_worked = ticket is not None
                if ticket is None:
                    process.close()
                else:
                    ticket.begun()
                    ticket.end(self._done(process, ticket))
        finally:
            process.close()

    def _began(self, process: WorkerProcess) -> bool:
        """Whether a process is ready."""
        try:
            choices = process(Begin(), report=_ignore, given_up=lambda: self._closed)
        except AbandonedError:
            return False
        except (LimitError, OSError):
            with self._change:
                self._change.wait_for(lambda: self._closed, timeout=AGAIN_S)
            return False
        with self._change:
            self._choices = choices
            self._change.notify_all()
        return True

    def _next(self, number: int, patience_s: float | None) -> Ticket | None:
        """The next task, when no process before this one is free; None when none comes, or it is closed."""
        with self._change:
            self._free.add(number)
            self._change.notify_all()
            self._change.wait_for(lambda: self._closed or self._is_for(number), timeout=patience_s)
            ticket = self._waiting.popleft() if self._is_for(number) and not self._closed else None
            self._free.discard(number)
            self._change.notify_all()
            return ticket

    def _is_for(self, number: int) -> bool:
        return bool(self._waiting) and number == min(self._free)

    def _done(self, process: WorkerProcess, ticket: Ticket) -> Outcome:
        """Outcome of a task; what exceeds a limit is refused."""
        try:
            outcome: Outcome = process(
                ticket.task, report=ticket.report, given_up=lambda: ticket.given_up or self._closed
            )
        except AbandonedError:
            return None
        except (LimitError, OSError) as error:
            sentence, limits = str(error), self._limits
            refused = RefusedError(
                HTTPStatus.INTERNAL_SERVER_ERROR,
                f"a log that takes at most {limits.time_s:g} s and {limits.memory_gb:g} GB",
                f"another one ({sentence[:1].lower()}{sentence[1:].removesuffix('.')})",
                "Cut the log to the manoeuvre of interest, or start with more: "
                "eivor serve --time S --memory GB.",
            )
            return Refused(int(refused.status), told(refused))
        return outcome


# -- Jobs --

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


# -- Uploaded logs --

#: Letters of a name that are shown.
LONGEST_NAME = 255
#: So many logs of the largest size are kept at once.
LARGEST_KEPT = 4
#: What is left free on the disk [bytes].
LEFT_FREE = 200_000_000
#: Endings that files keep; their content says what they are.
LONGEST_ENDING = 12


@dataclass(slots=True)
class _Entry:
    log: KeptLog
    used_at: float


class KeptLogs:
    """The logs of a run."""

    def __init__(self, folder: Path, largest: int, clock: Callable[[], float]) -> None:
        self._folder, self._largest, self._clock = folder, largest, clock
        self._entries: dict[str, _Entry] = {}
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
        """Keep a log; its identifier."""
        self._make_room(size, in_use())
        try:
            log = secrets.token_hex(16)
            path = self._folder / f"{log}{_ending(name)}"
            _write(path, files)
            with self._lock:
                self._entries[log] = _Entry(KeptLog(path, name, size), self._clock())
        finally:
            with self._lock:
                self._coming -= size
        return log

    def _make_room(self, size: int, in_use: Collection[str]) -> None:
        """Forget the oldest logs that nobody works on, until another one has room."""
        with self._lock:
            most = LARGEST_KEPT * self._largest
            free = shutil.disk_usage(self._folder).free - LEFT_FREE - self._coming
            oldest = sorted(set(self._entries) - set(in_use), key=lambda one: self._entries[one].used_at)
            kept = sum(one.log.size for one in self._entries.values()) + self._coming
            while (kept + size > most or size > free) and oldest:
                gone = self._forget(oldest.pop(0))
                kept, free = kept - gone, free + gone
            if kept + size > most or size > free:
                raise RefusedError(
                    HTTPStatus.INSUFFICIENT_STORAGE,
                    f"room for {size} bytes more",
                    "none",
                    "Wait until flights are identified, or make room on the disk.",
                )
            self._coming += size

    def get(self, log: str) -> KeptLog:
        """Log of an identifier, which is used now."""
        with self._lock:
            entry = self._entries.get(log)
            if entry is None:
                raise absent("a log", log)
            entry.used_at = self._clock()
            return entry.log

    def forget(self, log: str) -> None:
        """Delete a log."""
        with self._lock:
            if log not in self._entries:
                raise absent("a log", log)
            self._forget(log)

    def forget_older(self, age_s: float, in_use: Collection[str]) -> None:
        """Delete the logs that nobody has used for so long, or works on."""
        with self._lock:
            oldest = self._clock() - age_s
            for log in [one for one, entry in self._entries.items() if entry.used_at < oldest]:
                if log not in in_use:
                    self._forget(log)

    def _forget(self, log: str) -> int:
        entry = self._entries.pop(log)
        _delete(entry.log.path)
        return entry.log.size


def _write(path: Path, files: Iterable[tuple[str, Iterator[bytes]]]) -> None:
    """Write a log, all of it or nothing."""
    try:
        for name, chunks in files:
            if name:
                path.mkdir(mode=0o700, exist_ok=True)
            with whole_file(path / name if name else path) as file:
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
    name = name.replace("\0", "").strip()[:LONGEST_NAME]
    return name or "log"


def _ending(name: str) -> str:
    ending = PurePosixPath(name).suffix.lower()
    plain = ending[1:].isascii() and ending[1:].isalnum()
    return ending if plain and len(ending) <= LONGEST_ENDING else ""


# -- App --

#: The only address, and the header with the token.
ADDRESS, TOKEN = "127.0.0.1", "X-Eivor-Token"
#: Logs and results are deleted after this time, and the server looks for them this often [s].
KEPT_S, LOOK_S = 3600.0, 1.0
#: Time for the head of a request, and for its body beside the bytes per second that it must reach [s].
HEAD_S, BODY_S, BODY_RATE = 10.0, 30.0, 100_000.0
#: A refused body is read for this long, since a browser that still sends would not see the answer [s].
LINGER_S = 1.0
#: Time to finish answers when the server ends [s].
LAST_S = 2
#: Connections at a time, and bytes of a request's head and of a request that is no log.
MOST_CONNECTIONS, MOST_HEAD, MOST_JSON = 64, 65_536, 1_000_000
#: Fields of a query, and its letters.
MOST_FIELDS, LONGEST_QUERY = 20, 200_000
#: The flight that comes with Eivor.
EXAMPLE = "example_flight.parquet"
_REOPEN = "Open the address that `eivor serve` has printed."
_RELOAD = "Load the page again."
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Connection": "close",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
_POLICY = re.compile(r'http-equiv="Content-Security-Policy" content="([^"]*)"')


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Resources of a server."""

    port: int = 0  # zero for any that is free
    workers: int = 2  # processes at most
    limits: Limits = field(default_factory=Limits)  # of each job
    largest: int = 500_000_000  # bytes of a log at most
    most_waiting: int = 256  # jobs in the queue
    clock: Callable[[], float] = time.monotonic
    work: WorkFunction = field(default_factory=Work)  # function of the worker processes


class Server:
    """A page on this machine, until it is closed."""

    def __init__(self, options: ServeOptions | None = None) -> None:
        self.options = chosen = options or ServeOptions()
        self.page = page_text()
        self.token = secrets.token_urlsafe(24)
        listening = _listening(chosen.port)
        self.port: int = listening.getsockname()[1]
        self.folder = Path(tempfile.mkdtemp(prefix="eivor-serve-"))
        self.workers = Workers(chosen.workers, chosen.limits, chosen.most_waiting, chosen.work)
        self.logs = KeptLogs(self.folder / "logs", chosen.largest, chosen.clock)
        self.jobs = Jobs(self.folder / "jobs", self.workers, chosen.clock)
        self._uvicorn = uvicorn.Server(
            uvicorn.Config(
                Gate(_application(self), self.port, self.token),
                http=BoundedProtocol,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                h11_max_incomplete_event_size=MOST_HEAD,
                timeout_graceful_shutdown=LAST_S,
            )
        )
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._uvicorn.run, args=([listening],), daemon=True),
            threading.Thread(target=self._look_after, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.port}/?token={self.token}"

    @property
    def connections(self) -> int:
        """Number of open connections."""
        return len(self._uvicorn.server_state.connections)

    def policy(self) -> str:
        """Content security policy of the page, as it declares itself, and that nobody may frame it."""
        stated = _POLICY.search(self.page)
        own = html.unescape(stated.group(1)) if stated else "default-src 'none'"
        return f"{own}; frame-ancestors 'none'"

    def forget(self) -> None:
        """Delete what is an hour old."""
        self.jobs.forget_older(KEPT_S)
        self.logs.forget_older(KEPT_S, self.jobs.in_use())

    def close(self) -> None:
        """End connections and processes, and delete the files."""
        self._closed.set()
        self._uvicorn.should_exit = True
        self.workers.close()
        for thread in self._threads:
            thread.join()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _look_after(self) -> None:
        while not self._closed.wait(LOOK_S):
            self.forget()


def _listening(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere another program could take the port over
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((ADDRESS, port))
        listening.listen(128)
    except OSError:
        listening.close()
        raise
    return listening


class BoundedProtocol(H11Protocol):
    """Connections of a limited number, whose requests come within a limited time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection when there is room."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            error = RefusedError(
                HTTPStatus.SERVICE_UNAVAILABLE, "fewer connections", "one more", "Close some tabs."
            )
            self._end(error)
        else:
            self.loop.call_later(HEAD_S, self._end_late)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no request."""
        self._end(RefusedError(HTTPStatus.BAD_REQUEST, "a request of the page", msg, _RELOAD))

    def _end_late(self) -> None:
        if cast("object", self.cycle) is None and not self.transport.is_closing():
            self.transport.close()

    def _end(self, error: EivorError) -> None:
        answer, status = _refused(error), status_of(error)
        head = [f"HTTP/1.1 {status.value} {status.phrase}".encode()]
        head += [name + b": " + value for name, value in answer.raw_headers]
        self.transport.write(b"\r\n".join([*head, b"", bytes(answer.body)]))
        self.transport.close()


class Gate:
    """Lets the page of this run pass, in a browser on this machine, and nobody else."""

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app, self._token = app, token
        self._hosts = f"{ADDRESS}:{port}", f"localhost:{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                present = {name.lower() for name, _ in message["headers"]}
                own = [(name.lower().encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *(one for one in own if one[0] not in present)]
            await send(message)

        anyio.to_thread.current_default_thread_limiter().total_tokens = 2 * MOST_CONNECTIONS
        request = Request(scope, receive)
        try:
            self._check(request)
        except RefusedError as error:
            await _read_on(request)
            await _refused(error)(scope, receive, with_headers)
        else:
            with suppress(ClientDisconnect):
                await self._app(scope, receive, with_headers)

    def _check(self, request: Request) -> None:
        headers = request.headers
        host, origin = headers.get("host", ""), headers.get("origin")
        if host.lower() not in self._hosts:
            received = f"'{host[:100]}'"
            raise RefusedError(
                HTTPStatus.MISDIRECTED_REQUEST, f"the host {self._hosts[0]}", received, _REOPEN
            )
        if origin is not None and origin.lower() not in {f"http://{own}" for own in self._hosts}:
            raise _forbidden("a request of the page itself", f"one of '{origin[:100]}'")
        site = headers.get("sec-fetch-site", "none")
        if site not in ("same-origin", "none"):
            raise _forbidden("a request of the page itself", f"one that is {site[:100]}")
        token = headers.get(TOKEN, "")
        if request.scope["path"] == "/" and request.method == "GET":
            token = token or _fields(request).get("token", "")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self._token.encode()):
            raise _forbidden("the token of this run", "another one" if token else "none")


def _forbidden(expected: str, received: str) -> RefusedError:
    return RefusedError(HTTPStatus.FORBIDDEN, expected, received, _REOPEN)


def _refused(error: EivorError) -> Response:
    return JSONResponse({"error": told(error)}, status_of(error), headers=_HEADERS)


async def _read_on(request: Request) -> None:
    """Read what is sent all the same, for a while."""
    with suppress(ClientDisconnect, RuntimeError), anyio.move_on_after(LINGER_S):
        if request.headers.get("content-length", "0") != "0":
            async for _ in request.stream():
                pass


# -- routes -----------------------------------------------------------------------------------------------


class _Routes:
    """What answers each path; functions that are not `async` run in threads."""

    def __init__(self, server: Server) -> None:
        self._server, self._logs, self._jobs = server, server.logs, server.jobs

    def page(self, _request: Request) -> Response:
        return HTMLResponse(self._server.page, headers={"Content-Security-Policy": self._server.policy()})

    def choices(self, _request: Request) -> Response:
        return JSONResponse(
            {**self._server.workers.choices().known, "largest_bytes": self._server.options.largest}
        )

    async def keep_log(self, request: Request) -> Response:
        size = _length(request, self._server.options.largest)
        name = shown_name(request.headers.get("x-eivor-name", ""))
        body = _Body(request, size)
        sent = sent_files(request.headers.get("x-eivor-files", ""), size)
        files = [(one.name, one.size) for one in sent] or [("", size)]
        parts = ((one, body.parts(length)) for one, length in files)
        log = await anyio.to_thread.run_sync(lambda: self._logs.keep(name, size, parts, self._jobs.in_use))
        return JSONResponse({"log": log, "name": name, "bytes": size})

    def keep_example(self, _request: Request) -> Response:
        content = resources.files("eivor.data").joinpath(EXAMPLE).read_bytes()
        log = self._logs.keep(EXAMPLE, len(content), [("", iter([content]))], self._jobs.in_use)
        return JSONResponse({"log": log, "name": EXAMPLE, "bytes": len(content)})

    def forget_log(self, request: Request) -> Response:
        log = request.path_params["log"]
        if log in self._jobs.in_use():
            raise RefusedError(
                HTTPStatus.CONFLICT, "a log that nobody works on", "one of a job", "Cancel the job first."
            )
        self._logs.forget(log)
        return JSONResponse({})

    async def begin_job(self, request: Request) -> Response:
        body = _Body(request, _length(request, MOST_JSON))

        def begin() -> str:
            asked = asked_job(b"".join(body.parts(body.left)))
            return self._jobs.begin(asked, {log: self._logs.get(log) for log, _ in asked.logs})

        return JSONResponse({"job": await anyio.to_thread.run_sync(begin)})

    def end_job(self, request: Request) -> Response:
        self._jobs.end(request.path_params["job"])
        return JSONResponse({})

    def events(self, request: Request) -> Response:
        job = self._jobs.get(request.path_params["job"])
        lines = (bytes(JSONResponse(event).body) + b"\n" for event in job.events())
        return StreamingResponse(lines, media_type="application/x-ndjson; charset=utf-8")

    def result(self, request: Request) -> Response:
        folder = self._jobs.get(request.path_params["job"]).result_folder()
        return Response((folder / RESULT).read_bytes(), media_type="application/json; charset=utf-8")

    def report(self, request: Request) -> Response:
        return HTMLResponse(self._jobs.get(request.path_params["job"]).report().read_bytes())

    def list_exports(self, request: Request) -> Response:
        job, fields = self._jobs.get(request.path_params["job"]), _fields(request)
        outcome = self._done(ListExports(job.result_folder(), _supply(fields, job.asked.mass), job.stem))
        return JSONResponse({"targets": outcome})

    def export(self, request: Request) -> Response:
        job, target = self._jobs.get(request.path_params["job"]), request.path_params["target"]
        supply = _supply(_fields(request), job.asked.mass)
        return _file(self._done(Export(job.result_folder(), supply, job.stem, target)))

    def plan(self, request: Request) -> Response:
        job, fields = self._jobs.get(request.path_params["job"]), _fields(request)
        form, home, target = request.path_params["form"], fields.get("home", ""), fields.get("for", "")
        return _file(self._done(Plan(job.result_folder(), job.stem, form, home, target)))

    def _done(self, task: Task) -> Outcome:
        outcome = self._jobs.do(task)
        if isinstance(outcome, Refused):
            parts = outcome.told
            status = HTTPStatus(outcome.status)
            raise RefusedError(status, parts["expected"], parts["received"], parts["advice"])
        if outcome is None:
            unavailable = HTTPStatus.SERVICE_UNAVAILABLE
            raise RefusedError(
                unavailable, "a server that stays", "one that stops", "Start it again: eivor serve."
            )
        return outcome

    async def refuse(self, request: Request, error: Exception) -> Response:
        await _read_on(request)
        return _refused(_as_refusal(request, error))


def _application(server: Server) -> Starlette:
    answers = _Routes(server)
    app = Starlette(
        routes=[
            Route(path, endpoint, methods=[method])
            for method, path, endpoint in (
                ("GET", "/", answers.page),
                ("GET", "/choices", answers.choices),
                ("POST", "/logs", answers.keep_log),
                ("POST", "/example", answers.keep_example),
                ("DELETE", "/logs/{log}", answers.forget_log),
                ("POST", "/jobs", answers.begin_job),
                ("DELETE", "/jobs/{job}", answers.end_job),
                ("GET", "/jobs/{job}/events", answers.events),
                ("GET", "/jobs/{job}/result.json", answers.result),
                ("GET", "/jobs/{job}/report.html", answers.report),
                ("GET", "/jobs/{job}/exports", answers.list_exports),
                ("GET", "/jobs/{job}/exports/{target}", answers.export),
                ("GET", "/jobs/{job}/plan/{form}", answers.plan),
            )
        ],
        exception_handlers=dict.fromkeys((EivorError, HTTPException, OSError, TimeoutError), answers.refuse),
    )
    app.router.redirect_slashes = False
    return app


def _as_refusal(request: Request, error: Exception) -> EivorError:
    if isinstance(error, EivorError):
        return error
    if isinstance(error, TimeoutError):
        return RefusedError(
            HTTPStatus.REQUEST_TIMEOUT, "a log that comes at once", "a slow one", "Drop it again."
        )
    if isinstance(error, OSError):
        said = error.strerror or type(error).__name__
        return RefusedError(HTTPStatus.INTERNAL_SERVER_ERROR, "files that can be written", said, "Make room.")
    status = HTTPStatus(error.status_code) if isinstance(error, HTTPException) else HTTPStatus(500)
    if status == HTTPStatus.METHOD_NOT_ALLOWED and isinstance(error, HTTPException):
        return RefusedError(status, (error.headers or {}).get("Allow", ""), request.method, _RELOAD)
    return RefusedError(status, "an address of the page", f"'{request.url.path[:100]}'", _RELOAD)


# -- what comes -------------------------------------------------------------------------------------------


class _Body:
    """The body of a request, read by a thread in parts as they come."""

    def __init__(self, request: Request, size: int) -> None:
        self.left = size
        self._chunks = request.stream()
        self._rest = b""
        self._end = time.monotonic() + BODY_S + size / BODY_RATE

    def parts(self, size: int) -> Iterator[bytes]:
        """The next bytes, so many of them."""
        while size:
            chunk = self._rest or anyio.from_thread.run(self._next)
            if time.monotonic() > self._end:
                raise TimeoutError
            part, self._rest = chunk[:size], chunk[size:]
            size, self.left = size - len(part), self.left - len(part)
            yield part

    async def _next(self) -> bytes:
        with anyio.fail_after(self._end - time.monotonic()):
            async for chunk in self._chunks:
                if chunk:
                    return chunk
        raise ClientDisconnect


def _length(request: Request, most: int) -> int:
    """Bytes of the body, before any of it is read."""
    text = request.headers.get("content-length", "")
    if "transfer-encoding" in request.headers or not re.fullmatch("[0-9]{1,15}", text):
        raise RefusedError(
            HTTPStatus.LENGTH_REQUIRED, "a request that says how long it is", "one that does not", _RELOAD
        )
    if int(text) > most:
        raise RefusedError(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            f"at most {most} bytes",
            f"{text} bytes",
            "Cut the log to the manoeuvre of interest, or start with more: eivor serve --largest MB.",
        )
    return int(text)


def _fields(request: Request) -> dict[str, str]:
    """Fields of the query."""
    query = request.scope["query_string"].decode("latin-1")
    try:
        if len(query) > LONGEST_QUERY:
            raise ValueError
        fields = parse_qs(query, max_num_fields=MOST_FIELDS, errors="replace")
    except ValueError:
        expected = f"at most {MOST_FIELDS} fields"
        raise RefusedError(HTTPStatus.BAD_REQUEST, expected, "more", _RELOAD) from None
    return {name: "\n".join(values) for name, values in fields.items()}


def _supply(fields: dict[str, str], mass: str) -> Supply:
    priors = tuple(line for line in fields.get("prior", "").split("\n") if line)
    return Supply(fields.get("mass", "") or mass, fields.get("vehicle", ""), priors)


def _file(outcome: Outcome) -> Response:
    if not isinstance(outcome, File):
        raise TypeError(f"a file, not {type(outcome).__name__}")
    plain = re.sub(r"[^\w.-]+", "_", outcome.name, flags=re.ASCII) or "file"
    where = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(outcome.name, safe='')}"
    return PlainTextResponse(outcome.text, headers={"Content-Disposition": where})
