"""The queue of tasks: bounded, urgent ones first, and the worker processes that take from it.

One process is kept ready, so that a drop need not wait for imports; the others begin when there is more to do
than it can, and end when there is not. So does the first, for which a new one begins: what logs have taken of
memory is given back.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus

from eivor.process_pool import (
    BEGIN_S,
    AbandonedError,
    LimitError,
    Limits,
    ProgressCallback,
    WorkerProcess,
)
from eivor.serve.refusals import RefusedError, told
from eivor.serve.tasks import Begin, Choices, Outcome, Refused, Task, WorkFunction

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
