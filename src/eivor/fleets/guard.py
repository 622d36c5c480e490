"""Calls of a function under limits of time and memory, in a process that may die of it and nobody else.

The process is begun once and takes one item after the other, so that what it loads is loaded once. An item
that takes too long or too much, or at which the process dies, is told by an exception; the next one begins a
new process. An item at which a process dies that had others before is tried once more in a new one, so that
no item pays for what those before it left behind.

Processes are no children of `multiprocessing`: workers of a cluster, which may have none, begin them too.
"""

from __future__ import annotations

import pickle
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, BinaryIO, cast

from eivor.fleets.begun_process import begun_process, end, send
from eivor.fleets.limits import Limits
from eivor.fleets.telling import Tell, Telling, nobody
from eivor.studies.executors import abandoned

#: How often it is looked at whether anybody waits for the result [s].
LOOK_S = 0.2
#: How long a process may take to begin, beside what its limits say [s].
BEGIN_S = 120.0
#: Times that an item is tried at which its process dies.
TRIES = 2
#: Bytes of what a process that died said last, and what is in those that tell why.
LAST_WORDS, TELLING_WORD = 4000, "memory"
#: How long they are waited for once it has died: what it had begun may keep its pipe open [s].
WORDS_S = 2.0


class LimitError(Exception):
    """An item that took more than it may, or at which its process died; the sentence says which."""


class AbandonedError(Exception):
    """Nobody waits for the result any more."""


class Guard:
    """A function of one item, called in a process of its own.

    Parameters
    ----------
    function : callable or Telling
        That can be pickled, as can its items and results.
    limits : Limits
        Of each call.
    """

    def __init__(self, function: Callable[[Any], Any] | Telling, limits: Limits) -> None:
        self._function = function
        self._limits = limits
        self._process: _Process | None = None

    def __call__(self, item: Any, *, hear: Tell = nobody, given_up: Callable[[], bool] | None = None) -> Any:
        """Result of an item.

        Parameters
        ----------
        item : object
            What the function takes.
        hear : callable
            Takes what a `Telling` function tells; from the beginning again where an item is tried again.
        given_up : callable, optional
            Whether nobody waits any more. Default: whether the task that this is part of is abandoned.

        Raises
        ------
        LimitError
            When it takes more than it may, or its process dies.
        AbandonedError
            When nobody waits.
        """
        nobody_waits = given_up or abandoned
        for _ in range(TRIES - 1):
            with suppress(_DiedError):
                return self._tried(item, hear, nobody_waits)
            if nobody_waits():
                raise AbandonedError
        try:
            return self._tried(item, hear, nobody_waits)
        except _DiedError as died:
            raise LimitError(str(died)) from None

    def _tried(self, item: Any, hear: Tell, given_up: Callable[[], bool]) -> Any:
        process = self._process or _Process(self._function, self._limits)
        self._process = None  # until it has answered
        try:
            result = process.result(item, self._limits, hear, given_up)
        except BaseException:
            process.end()
            raise
        self._process = process
        return result

    @property
    def pid(self) -> int | None:
        """Process that waits for the next item; None without one."""
        return None if self._process is None else self._process.pid

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.end()
            self._process = None


class _DiedError(Exception):
    """A process that ended before it answered, or ran out of memory; it may have been for those before."""


class _Process:
    """A process with its two pipes: items go in, results come out."""

    def __init__(self, function: Callable[[Any], Any] | Telling, limits: Limits) -> None:
        self._popen = begun_process()
        self.pid = self._popen.pid
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._words = bytearray()
        self._items = cast("BinaryIO", self._popen.stdin)
        results, said = cast("BinaryIO", self._popen.stdout), cast("BinaryIO", self._popen.stderr)
        self._taking = threading.Thread(target=self._take, args=(results,), daemon=True)
        self._hearing = threading.Thread(target=self._hear, args=(said,), daemon=True)
        for reader in (self._taking, self._hearing):
            reader.start()
        self._is_new = True
        send(self._popen, (function, limits.memory_gb))

    def result(self, item: Any, limits: Limits, hear: Tell, given_up: Callable[[], bool]) -> Any:
        """Answer to an item."""
        if self._is_new:
            self._answer(BEGIN_S, "begin", hear, given_up)  # what it loads is nobody's time
            self._is_new = False
        send(self._popen, item)
        kind, value = self._answer(limits.time_s, "answer", hear, given_up)
        if kind == "memory":
            raise _DiedError(f"It took more than {limits.memory_gb:g} GB of memory.")
        return value

    def _answer(
        self, patience_s: float, what: str, hear: Tell, given_up: Callable[[], bool]
    ) -> tuple[str, Any]:
        end = time.monotonic() + patience_s
        while True:
            try:
                found = self._answers.get(timeout=LOOK_S)
            except queue.Empty:
                if given_up():
                    raise AbandonedError from None
                if time.monotonic() > end:
                    raise LimitError(f"It took longer than {patience_s:g} s to {what}.") from None
                continue
            if found is None:
                raise _DiedError(self._last_words())
            if found[0] != "told":
                return found
            hear(found[1])

    def _take(self, pipe: BinaryIO) -> None:
        """Results as they come; None for their end."""
        with pipe, suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                self._answers.put(pickle.load(pipe))  # noqa: S301 - our own process wrote it
        self._answers.put(None)

    def _hear(self, pipe: BinaryIO) -> None:
        """What it says, of which the last is kept; a pipe that nobody reads would stop it."""
        with pipe, suppress(OSError):
            for line in pipe:
                self._words = (self._words + line)[-LAST_WORDS:]

    def _last_words(self) -> str:
        code = self._popen.wait()
        self._hearing.join(WORDS_S)
        lines = self._words.decode("utf-8", "replace").strip().splitlines()
        # what wants memory and gets none says so in its own way, and how to find out more after that
        telling = [line for line in lines if TELLING_WORD in line.lower()] or lines
        said = f", and said last: {telling[-1]}" if telling else ""
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"The process that worked on it died ({how}){said}."

    def end(self) -> None:
        """End it and what it has begun, whatever they do."""
        end(self._popen)
        with suppress(OSError):
            self._items.close()
        for reader in (self._taking, self._hearing):
            reader.join()
