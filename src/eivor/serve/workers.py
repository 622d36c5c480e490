"""Worker processes and what waits for them: a bounded queue, limits, and an end to what nobody waits for.

One process is kept ready, so that a drop need not wait for imports; the others begin when there is more to do
than it can, and end when there is not. So does the first, for which a new one begins: what logs have taken of
memory is given back.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from http import HTTPStatus

from eivor.fleets.guard import BEGIN_S, AbandonedError, Guard, LimitError
from eivor.fleets.limits import Limits
from eivor.fleets.telling import Tell, Telling, nobody
from eivor.serve.refusals import RefusedError, told
from eivor.serve.tasks import Begin, Choices, Outcome, Refused, Task

#: A process that has worked ends after so long without work [s].
IDLE_S = 10.0
#: How long it is waited for before a process is begun again that did not begin [s].
AGAIN_S = 5.0


class Ticket:
    """A task on its way through the queue.

    Parameters
    ----------
    task : Task
        What to do.
    begun : callable
        Called when a process takes it.
    hear : callable
        Takes what the task tells.
    ended : callable
        Called with the outcome, None as well where the task was given up.
    urgent : bool
        Whether it goes before those that are not: somebody looks at an empty page.
    """

    def __init__(
        self,
        task: Task,
        *,
        begun: Callable[[], None] = lambda: None,
        hear: Tell = nobody,
        ended: Callable[[Outcome], None] = nobody,
        urgent: bool = False,
    ) -> None:
        self.task, self.begun, self.hear, self.urgent = task, begun, hear, urgent
        self._ended = ended
        self._given_up = threading.Event()
        self._over = threading.Event()
        self._outcome: Outcome = None

    @property
    def given_up(self) -> bool:
        """Whether nobody waits for it."""
        return self._given_up.is_set()

    def give_up(self) -> None:
        """Say that nobody waits for it."""
        self._given_up.set()

    def end(self, outcome: Outcome) -> None:
        """Hand the outcome over."""
        self._outcome = outcome
        self._ended(outcome)
        self._over.set()

    def outcome(self) -> Outcome:
        """Outcome, once it is there."""
        self._over.wait()
        return self._outcome


class Workers:
    """The processes and the queue.

    Parameters
    ----------
    count : int
        Processes at most.
    limits : Limits
        Of each task.
    most_waiting : int
        Tasks that may wait.
    work : Telling
        From a task to its outcome.
    """

    def __init__(self, count: int, limits: Limits, most_waiting: int, work: Telling) -> None:
        self._limits, self._most_waiting = limits, most_waiting
        self._change = threading.Condition()
        self._waiting: deque[Ticket] = deque()
        self._free: set[int] = set()
        self._closed = False
        self._choices: Choices | None = None
        self._guards = [Guard(work, limits) for _ in range(count)]
        self._threads = [
            threading.Thread(target=self._work, args=(number,), name=f"worker {number}", daemon=True)
            for number in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def put(self, ticket: Ticket) -> None:
        """Queue a task.

        Raises
        ------
        RefusedError
            When too many wait.
        """
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
        ticket.give_up()
        with self._change:
            waited = ticket in self._waiting
            if waited:
                self._waiting.remove(ticket)
        if waited:
            ticket.end(None)

    def choices(self) -> Choices:
        """What may be chosen, which the first process tells when it is ready.

        Raises
        ------
        RefusedError
            When it does not begin.
        """
        with self._change:
            self._change.wait_for(lambda: self._choices is not None or self._closed, timeout=BEGIN_S)
            if self._choices is None:
                raise _not_begun()
            return self._choices

    def pids(self) -> list[int]:
        """Processes that wait for work."""
        return [guard.pid for guard in self._guards if guard.pid is not None]

    def close(self) -> None:
        """End all processes; what waits is given up."""
        with self._change:
            self._closed = True
            waiting, self._waiting = list(self._waiting), deque()
            self._change.notify_all()
        for ticket in waiting:
            ticket.give_up()
            ticket.end(None)
        for thread in self._threads:
            thread.join()

    def _work(self, number: int) -> None:
        """Take one task after the other, until it is closed."""
        guard, has_worked = self._guards[number], False
        try:
            while not self._closed:
                if number == 0 and guard.pid is None and not self._began(guard):
                    continue
                ticket = self._next(number, IDLE_S if has_worked else None)
                has_worked = ticket is not None
                if ticket is None:
                    guard.close()
                else:
                    ticket.begun()
                    ticket.end(self._done(guard, ticket))
        finally:
            guard.close()

    def _began(self, guard: Guard) -> bool:
        """Whether a process is ready."""
        try:
            found = guard(Begin(), given_up=lambda: self._closed)
        except AbandonedError:
            return False
        except (LimitError, OSError):
            with self._change:
                self._change.wait_for(lambda: self._closed, timeout=AGAIN_S)
            return False
        with self._change:
            self._choices = found
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

    def _done(self, guard: Guard, ticket: Ticket) -> Outcome:
        try:
            outcome: Outcome = guard(
                ticket.task, hear=ticket.hear, given_up=lambda: ticket.given_up or self._closed
            )
        except AbandonedError:
            return None
        except (LimitError, OSError) as error:
            return self._beyond(str(error))
        return outcome

    def _beyond(self, sentence: str) -> Refused:
        limits = self._limits
        refused = RefusedError(
            HTTPStatus.INTERNAL_SERVER_ERROR,
            f"a log that takes at most {limits.time_s:g} s and {limits.memory_gb:g} GB",
            f"another one ({sentence[:1].lower()}{sentence[1:].removesuffix('.')})",
            "Cut the log to the manoeuvre of interest, or start with more: eivor serve --time S --memory GB.",
        )
        return Refused(int(refused.status), told(refused))


def _not_begun() -> RefusedError:
    return RefusedError(
        HTTPStatus.SERVICE_UNAVAILABLE,
        "a worker process that begins",
        "none",
        "Stop `eivor serve` and start it again.",
    )
