"""Worker processes with limits on memory and time, for fleets and studies."""

from __future__ import annotations

import math
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing import spawn
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

from threadpoolctl import threadpool_limits

from eivor.errors import EivorError, InputError, UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")
#: Results with the places of their items.
Results = Generator[tuple[int, Result], None, None]
#: Takes what a task reports on its way.
ProgressCallback = Callable[[Any], None]

#: Environment variable of a process with limits: it may die of what it reads, so nothing is tried beforehand.
SANDBOX = "EIVOR_SANDBOX"
#: Period of the checks for cancellation and the time limit [s], and longest time to begin a process [s].
POLL_S, BEGIN_S = 0.2, 120.0
#: Attempts at an item at which the process dies, the last of them while no other process works.
TRIES = 2
#: Tasks submitted for each worker: one at work and one that waits for it.
TASKS_PER_WORKER = 2
#: Bytes read from the end of a dead process's output, and longest time that a process takes to die [s].
PRINTED_BYTES, DEATH_S = 4000, 10.0
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS"), "1"
)


class LimitError(Exception):
    """An item that exceeded a limit, or at which the process died; the sentence says which."""


class AbandonedError(Exception):
    """Nobody waits for the result any more."""


class _DiedError(Exception):
    """A process that ended before it answered, or ran out of memory: perhaps because of earlier items."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Resources of one item; each above zero, else a `UsageError` is raised."""

    time_s: float = 600.0  # by the clock
    memory_gb: float = 4.0  # beyond what the process has when it begins

    def __post_init__(self) -> None:
        for name, unit in (("time_s", "s"), ("memory_gb", "GB")):
            value = getattr(self, name)
            if not value > 0.0:
                expected = f"a limit {name} above zero"
                raise UsageError(expected, f"{value:g} {unit}", "Give more, or leave it out.")


UNLIMITED = Limits(math.inf, math.inf)


class _Turns:
    """Turns of attempts: many at a time, or an exclusive one after a process died, perhaps of memory."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._running = self._exclusive = 0  # running attempts, and exclusive ones waiting or running

    @contextmanager
    def turn(self, given_up: Callable[[], bool], *, exclusive: bool) -> Iterator[None]:
        """Wait for one's turn, and have it for the block."""
        with self._change:
            self._exclusive += exclusive
            try:
                while self._running if exclusive else self._exclusive:
                    if given_up():
                        raise AbandonedError
                    self._change.wait(POLL_S)
            except BaseException:
                self._exclusive -= exclusive
                raise
            self._running += 1
        try:
            yield
        finally:
            with self._change:
                self._running -= 1
                self._exclusive -= exclusive
                self._change.notify_all()


_TURNS = _Turns()


class WorkerProcess:
    """A function of one item, called in a process of its own."""

    def __init__(self, function: Callable[..., Any], limits: Limits = UNLIMITED) -> None:
        self._pickled, self._limits = pickle.dumps(function), limits
        self._process: _Process | None = None

    def __call__(
        self, item: Any, *, report: ProgressCallback | None = None, given_up: Callable[[], bool] | None = None
    ) -> Any:
        given_up = given_up or abandoned
        for attempt in range(TRIES):
            process, self._process = self._process or _Process(), None  # until it has answered
            try:
                with _TURNS.turn(given_up, exclusive=attempt > 0):
                    kind, value = process.result(self._pickled, self._limits, item, report, given_up)
            except _DiedError as died:
                process.end()
                if given_up():
                    raise AbandonedError from None
                if attempt == TRIES - 1:
                    raise LimitError(str(died)) from None
            except BaseException:
                process.end()
                raise
            else:
                self._process = process
                if kind == "error":
                    raise value
                return value
        raise AssertionError("unreachable")

    @property
    def pid(self) -> int | None:
        """Process that waits for the next item; None without one."""
        return None if self._process is None else self._process.popen.pid

    def close(self) -> None:
        if self._process is not None:
            self._process.end()
            self._process = None


class _Process:
    """A process with two pipes: items go in, results come out."""

    def __init__(self) -> None:
        if _LOADING_MAIN:
            expected = "a script that runs tasks of its own guarded by `if __name__ == '__main__':`"
            received = "one that runs them where it is imported"
            raise InputError(expected, received, "Guard it, or define the task in a module.")
        self._printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115 - closed with the process
        self.popen = subprocess.Popen(
            [sys.executable, "-P", "-c", "from eivor.process_pool import work; work()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._printed,
            env=os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(sys.path)},
            start_new_session=True,  # an interrupt is the business of who waits for it
        )
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._has_function = False

    def result(
        self,
        function: bytes,
        limits: Limits,
        item: Any,
        report: ProgressCallback | None,
        given_up: Callable[[], bool],
    ) -> tuple[str, Any]:
        """Kind of an answer, "result" or "error", and its value."""
        if not self._has_function:
            main = spawn.get_preparation_data("worker") if b"__main__" in function else {}
            main = {name: value for name, value in main.items() if name.startswith("init_main")}
            self._send((main, function, limits.memory_gb))
            self._answer(BEGIN_S, "begin", None, given_up)  # no item pays for what it loads
            self._has_function = True
        self._send((item, report is not None))
        kind, value = self._answer(limits.time_s, "answer", report, given_up)
        if kind == "memory":
            raise _DiedError(f"It took more than {limits.memory_gb:g} GB of memory.")
        return kind, value

    def _send(self, item: Any) -> None:
        pipe = cast("BinaryIO", self.popen.stdin)
        with suppress(OSError):  # its death is noticed where the answer is awaited
            pickle.dump(item, pipe)
            pipe.flush()

    def _answer(
        self, patience_s: float, what: str, report: ProgressCallback | None, given_up: Callable[[], bool]
    ) -> tuple[str, Any]:
        end = time.monotonic() + patience_s
        while True:
            with suppress(queue.Empty):
                answer = self._answers.get(timeout=POLL_S)
                if answer is None:
                    raise _DiedError(self._death_sentence())
                if answer[0] != "progress":
                    return answer
                if report is not None:
                    report(answer[1])
            if given_up():
                raise AbandonedError
            if time.monotonic() > end:
                raise LimitError(f"It took longer than {patience_s:g} s to {what}.")

    def _read(self) -> None:
        """Queue answers as they come; None for their end."""
        pipe = cast("BinaryIO", self.popen.stdout)
        with pipe, suppress(Exception):  # whatever a dying process has written
            while True:
                self._answers.put(pickle.load(pipe))  # noqa: S301 - our own process wrote it
        self._answers.put(None)

    def _death_sentence(self) -> str:
        try:
            code = self.popen.wait(DEATH_S)
        except subprocess.TimeoutExpired:  # it has sent what cannot be read here
            self.popen.kill()
            code = self.popen.wait()
        self._printed.seek(0, os.SEEK_END)
        self._printed.seek(max(self._printed.tell() - PRINTED_BYTES, 0))
        lines = self._printed.read().decode("utf-8", "replace").strip().splitlines()
        # an allocation that fails is printed in the library's way, followed by hints for debugging
        relevant = [line for line in lines if "memory" in line.lower()] or lines
        text = f", and said last: {relevant[-1]}" if relevant else ""
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"The process that worked on it died ({how}){text}."

    def end(self) -> None:
        """Kill the process and what it has begun."""
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.popen.pid, signal.SIGKILL)  # it leads a group of its own
        self.popen.kill()
        self.popen.wait()
        with suppress(OSError):
            cast("BinaryIO", self.popen.stdin).close()
        self._reader.join()
        self._printed.close()


#: In a worker process: not empty while it imports the script that began it.
_LOADING_MAIN: list[bool] = []


def work() -> None:
    """Be a worker process: take the function and its items, give results until nobody reads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    items, results = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no result
    main, pickled, memory_gb = pickle.load(items)  # noqa: S301 - who began this process wrote it
    _LOADING_MAIN.append(True)
    spawn.prepare(main)
    _LOADING_MAIN.clear()
    function = pickle.loads(pickled)  # noqa: S301 - as above
    threadpool_limits(limits=1)
    if math.isfinite(memory_gb):
        os.environ[SANDBOX] = "1"
        limit_memory(memory_gb)
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_queue_items, args=(items, waiting), daemon=True).start()
    _write_answer(results, "begun", None)
    while True:
        item, reports = waiting.get()
        os.ftruncate(2, 0)  # what was printed at items before
        report = (partial(_write_answer, results, "progress"),) if reports else ()
        try:
            answer = "result", function(item, *report)
        except MemoryError:
            if math.isinf(memory_gb):
                raise
            answer = "memory", None
        except EivorError as error:
            answer = "error", error
        _write_answer(results, *answer)


def _write_answer(results: BinaryIO, kind: str, value: Any) -> None:
    pickle.dump((kind, value), results)
    results.flush()


def _queue_items(items: BinaryIO, waiting: queue.SimpleQueue[Any]) -> None:
    """Queue items; end this process, in the middle of one too, when whoever waited is gone."""
    try:
        while True:
            waiting.put(pickle.load(items))  # noqa: S301 - as above
    except (EOFError, OSError):
        if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(0)


def limit_memory(memory_gb: float) -> None:
    """Refuse this process more address space [GB] beyond what it has; where the system can (not Windows)."""
    if sys.platform == "win32":
        return
    import resource

    try:
        used_bytes = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    except OSError:
        used_bytes = 0
    limit = used_bytes + int(memory_gb * 1e9)
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    if hard == resource.RLIM_INFINITY or limit < hard:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


class Executor(ABC):
    """Maps a function over items. Whatever computes them, the results are the same."""

    @abstractmethod
    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Results[Result]:
        """Result of each item with the item's place, in any order, as they are done; see `in_order`."""


@dataclass(frozen=True, slots=True)
class InProcess(Executor):
    """One after another, in this process."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Results[Result]:
        for index, item in enumerate(items):
            with threadpool_limits(limits=1):
                result = function(item)
            yield index, result


@dataclass(frozen=True, slots=True)
class LocalThreads(Executor):
    """In threads of this process: for tasks that wait for processes of their own, as those of a fleet do."""

    workers: int  # at least one, else a `UsageError` is raised

    def __post_init__(self) -> None:
        check_workers(self.workers)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Results[Result]:
        waiting, running = enumerate(items), set[Future[tuple[int, Result]]]()
        stop = threading.Event()

        def call(position: int, item: Item) -> tuple[int, Result]:
            _STOP.set(stop)
            return position, function(item)

        pool = ThreadPoolExecutor(self.workers)
        try:
            while True:
                room = TASKS_PER_WORKER * self.workers - len(running)
                running |= {pool.submit(call, *item) for item in islice(waiting, room)}
                if not running:
                    return
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True, slots=True)
class LocalProcesses(Executor):
    """In processes of this computer."""

    workers: int  # at least one, else a `UsageError` is raised

    def __post_init__(self) -> None:
        check_workers(self.workers)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Results[Result]:
        free: queue.SimpleQueue[WorkerProcess] = queue.SimpleQueue()
        for _ in range(self.workers):
            free.put(WorkerProcess(function))

        def call(item: Item) -> Result:
            process = free.get()
            try:
                result: Result = process(item)
            finally:
                free.put(process)
            return result

        try:
            yield from LocalThreads(self.workers).map(call, items)
        except LimitError as error:
            raise InputError(
                "worker processes that live until the study is done",
                str(error).replace("The process that worked on it", "one that").removesuffix("."),
                "Memory may have run out: use fewer workers. What was complete is kept: run the same again.",
            ) from error
        finally:
            for _ in range(self.workers):
                free.get().close()


def useful_workers(workers: int | None, tasks: int) -> int:
    """How many workers there is work for, on this computer; `workers` of None are one for each core."""
    if workers is not None:
        check_workers(workers)
    return min(workers or os.cpu_count() or 1, tasks)


def local_executor(workers: int | None, tasks: int) -> Executor:
    """Executor on this computer, of no more processes than there are tasks; this one, where one will do."""
    useful = useful_workers(workers, tasks)
    return LocalProcesses(useful) if useful > 1 else InProcess()


def check_workers(workers: int) -> None:
    """Refuse a number of workers below one, with a `UsageError`."""
    if workers < 1:
        raise UsageError("one worker or more", f"{workers}", "Leave it out to use every core.")


def in_order(results: Results[Result]) -> Generator[Result, None, None]:
    """Results of `Executor.map` in the order of their items; an early one is kept until it is its turn."""
    early: dict[int, Result] = {}
    turn = 0
    with closing(results):
        for item, result in results:
            early[item] = result
            while turn in early:
                yield early.pop(turn)
                turn += 1


#: Set in a thread once nobody waits for its task any more.
_STOP: ContextVar[threading.Event] = ContextVar("stop")


def abandoned() -> bool:
    """Whether nobody waits for this thread's task any more; a long task checks it between its parts."""
    stop = _STOP.get(None)
    return stop is not None and stop.is_set()
