"""Executors: where tasks are computed. Whatever does it, the results are the same.

A task is a function of one item. The matrices are small, so a process that computes tasks uses one thread
for linear algebra: more only wait for each other, and another number of threads may round differently.
"""

from __future__ import annotations

import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures import Executor as PoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from multiprocessing import connection, get_context, parent_process
from multiprocessing.synchronize import Event
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from eivor.errors import InputError, UsageError
from eivor.studies.interrupts import interrupts_wait

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Tasks that are handed out for each worker: one at work and one that waits for it.
TASKS_PER_WORKER = 2


class Executor(ABC):
    """Maps a function over items."""

    @abstractmethod
    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[int, Result], None, None]:
        """Result of each item with the item's place, in any order, as they are done; see `in_order`.

        The number of tasks in flight is bounded, so that memory does not grow with the number of items.
        Closing the iterator ends the work.

        Parameters
        ----------
        function : callable
            A pure function that can be pickled, as can its items and results: one of a module, or an object
            that holds what all tasks have in common.
        items : iterable
            Taken as there is room for them.

        Yields
        ------
        int, result
            Place of an item, counted from zero, and what the function made of it.

        Raises
        ------
        InputError
            When a worker is lost for good.
        EivorError
            What the function raises.
        """


@dataclass(frozen=True, slots=True)
class InProcess(Executor):
    """One after another, in this process."""

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[int, Result], None, None]:
        """In order, see `Executor.map`."""
        for place, item in enumerate(items):
            with threadpool_limits(limits=1):
                result = function(item)
            yield place, result


@dataclass(frozen=True, slots=True)
class _LocalPool(Executor):
    """In a pool of this computer, whose tasks know when nobody waits for them any more."""

    workers: int

    def __post_init__(self) -> None:
        check_workers(self.workers)

    def _mapped(
        self, pool: PoolExecutor, stop: Event | threading.Event, items: Iterable[Any]
    ) -> Generator[tuple[int, Any], None, None]:
        try:
            yield from _as_done(pool, self.workers, items)
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


class LocalProcesses(_LocalPool):
    """In processes of this computer.

    Parameters
    ----------
    workers : int
        Number of processes.

    Raises
    ------
    UsageError
        When it is less than one.
    """

    __slots__ = ()

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[int, Result], None, None]:
        """As they are done, see `Executor.map`."""
        context = get_context("spawn")
        stop = context.Event()
        pool = ProcessPoolExecutor(
            self.workers, mp_context=context, initializer=_begin_worker, initargs=(function, stop)
        )
        try:
            yield from self._mapped(pool, stop, items)
        except BrokenProcessPool as error:
            raise InputError(
                "worker processes that live until the study is done",
                "one that died",
                "Memory may have run out: use fewer workers. A script that runs a study must guard it with "
                "`if __name__ == '__main__':`. What was complete is kept: run the same again.",
            ) from error


class LocalThreads(_LocalPool):
    """In threads of this process: for tasks that wait for processes of their own, as those of a fleet do.

    Parameters
    ----------
    workers : int
        Number of threads.

    Raises
    ------
    UsageError
        When it is less than one.
    """

    __slots__ = ()

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[int, Result], None, None]:
        """As they are done, see `Executor.map`."""
        stop = threading.Event()
        pool = ThreadPoolExecutor(self.workers, initializer=_begin_thread, initargs=(function, stop))
        yield from self._mapped(pool, stop, items)


def _as_done(
    pool: PoolExecutor, workers: int, items: Iterable[Any]
) -> Generator[tuple[int, Any], None, None]:
    """Results of a pool as they are done, of tasks that are handed out when there is room for them."""
    waiting = enumerate(items)
    flying: set[Future[tuple[int, Any]]] = set()
    while True:
        tasks = list(islice(waiting, TASKS_PER_WORKER * workers - len(flying)))
        with interrupts_wait():  # a task that is handed in may begin a worker
            flying |= {pool.submit(_task_in_worker, *one) for one in tasks}
        if not flying:
            return
        done, flying = wait(flying, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def useful_workers(workers: int | None, tasks: int) -> int:
    """How many workers there is work for, on this computer.

    Parameters
    ----------
    workers : int or None
        Asked for; None for one for each core.
    tasks : int
        Number of tasks.

    Raises
    ------
    UsageError
        When there is less than one worker.
    """
    if workers is not None:
        check_workers(workers)
    return min(workers or os.cpu_count() or 1, tasks)


def local_executor(workers: int | None, tasks: int) -> Executor:
    """Executor on this computer, of no more processes than there are tasks; this one, where one will do.

    Parameters
    ----------
    workers : int or None
        Number of processes; None for one for each core.
    tasks : int
        Number of tasks.

    Raises
    ------
    UsageError
        When there is less than one worker.
    """
    useful = useful_workers(workers, tasks)
    return LocalProcesses(useful) if useful > 1 else InProcess()


def check_workers(workers: int) -> None:
    """Refuse a number of processes that computes nothing.

    Raises
    ------
    UsageError
        When it is less than one.
    """
    if workers < 1:
        raise UsageError("one worker or more", f"{workers}", "Leave it out to use every core.")


def in_order(results: Generator[tuple[int, Result], None, None]) -> Generator[Result, None, None]:
    """Results in the order of their items: one that comes early is kept until it is its turn.

    Parameters
    ----------
    results : generator of (int, result)
        As `Executor.map` gives them; closed with this one.
    """
    early: dict[int, Result] = {}
    turn = 0
    with closing(results):
        for place, result in results:
            early[place] = result
            while turn in early:
                yield early.pop(turn)
                turn += 1


def abandoned() -> bool:
    """Whether nobody waits for the task's result any more; a long task asks between its parts, and ends."""
    return _WORKER.stop is not None and _WORKER.stop.is_set()


class _Worker(threading.local):
    """What the worker that this thread is was begun with."""

    function: Callable[[Any], Any]
    stop: Event | threading.Event | None = None


_WORKER = _Worker()


def _begin_worker(function: Callable[[Any], Any], stop: Event) -> None:
    """Set a worker process up: an interrupt is its parent's business, and so is its life.

    Until here interrupts were blocked, see `interrupts_wait`; from here on they are ignored.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(limits=1)
    _begin_thread(function, stop)


def _begin_thread(function: Callable[[Any], Any], stop: Event | threading.Event) -> None:
    _WORKER.function, _WORKER.stop = function, stop


def _end_with_parent() -> None:
    """A killed parent cannot stop its workers; without it there is nobody to work for."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _task_in_worker(place: int, item: Any) -> tuple[int, Any]:
    return place, _WORKER.function(item)
