"""Executors: where shards of a study are computed. Whatever does it, the trials are the same.

The matrices are small, so a process that computes trials uses one thread for linear algebra: more only
wait for each other, and another number of threads may round differently.
"""

from __future__ import annotations

import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from multiprocessing import connection, get_context, parent_process
from multiprocessing.synchronize import Event

from threadpoolctl import threadpool_limits

from eivor.errors import InputError, UsageError
from eivor.studies.study import Study
from eivor.studies.trial import TrialRecord, trial
from eivor.studies.trial_shards import shard_trials

#: Shards that are handed out for each worker: one at work and one that waits for it.
SHARDS_PER_WORKER = 2


@dataclass(frozen=True, slots=True)
class ShardResult:
    """A computed shard.

    Parameters
    ----------
    number : int
        Which.
    trials : tuple of TrialRecord
        In order.
    """

    number: int
    trials: tuple[TrialRecord, ...]


class Executor(ABC):
    """Maps shards to their trials."""

    @abstractmethod
    def results(self, study: Study, shards: Iterable[int]) -> Generator[ShardResult, None, None]:
        """Trials of each shard, in any order, as they are done.

        The number of shards in flight is bounded, so that memory does not grow with the study. Closing the
        iterator ends the work.

        Raises
        ------
        InputError
            When a worker is lost for good.
        """


@dataclass(frozen=True, slots=True)
class InProcess(Executor):
    """One after another, in this process."""

    def results(self, study: Study, shards: Iterable[int]) -> Generator[ShardResult, None, None]:
        """In order, see `Executor.results`."""
        for number in shards:
            with threadpool_limits(limits=1):
                trials = tuple(trial(study, index) for index in shard_trials(study.runs, number))
            yield ShardResult(number, trials)


@dataclass(frozen=True, slots=True)
class LocalProcesses(Executor):
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

    workers: int

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UsageError("one worker or more", f"{self.workers}", "Leave it out to use every core.")

    def results(self, study: Study, shards: Iterable[int]) -> Generator[ShardResult, None, None]:
        """As they are done, see `Executor.results`."""
        context = get_context("spawn")
        stop = context.Event()
        pool = ProcessPoolExecutor(
            self.workers, mp_context=context, initializer=_begin_worker, initargs=(study, stop)
        )
        waiting = iter(shards)
        flying: set[Future[ShardResult]] = set()
        try:
            while True:
                room = SHARDS_PER_WORKER * self.workers - len(flying)
                flying |= {pool.submit(_shard_in_worker, number) for number in islice(waiting, room)}
                if not flying:
                    return
                done, flying = wait(flying, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool as error:
            raise InputError(
                "worker processes that live until the study is done",
                "one that died",
                "Memory may have run out: use fewer workers. A script that runs a study must guard it with "
                "`if __name__ == '__main__':`. What was complete is kept: run the same again.",
            ) from error
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


class _Worker:
    """What a worker process was begun with."""

    study: Study
    stop: Event


def _begin_worker(study: Study, stop: Event) -> None:
    """Set a worker process up: an interrupt is its parent's business, and so is its life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(limits=1)
    _Worker.study, _Worker.stop = study, stop


def _end_with_parent() -> None:
    """A killed parent cannot stop its workers; without it there is nobody to work for."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _shard_in_worker(number: int) -> ShardResult:
    trials = []
    for index in shard_trials(_Worker.study.runs, number):
        if _Worker.stop.is_set():
            break  # nobody waits for the result any more
        trials.append(trial(_Worker.study, index))
    return ShardResult(number, tuple(trials))
