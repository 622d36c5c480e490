"""The ways in which the fleet is run."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from eivor.fleet.table import part_files, read_flights
from eivor.lab.study_run import parquet_bytes
from validation.fleet_run.logs import SEED, Size

#: Logs of a task where runs are ended: little is made twice.
TASK_LOGS = 5
#: Longest time between the part of the table that a signal waits for, and the signal [s].
LATER_S = 1.5
#: Share of the fleet that is done when the last signal comes, at most.
MOST_DONE = 0.95
#: How often it is looked at whether it is time [s].
LOOK_S = 0.02


@dataclass(frozen=True, slots=True)
class Told:
    """What a way of running the fleet made."""

    mode: str  # The way, by the name of its folder and in words
    what: str
    logs: int  # Logs of the fleet, rows of the table, and different names in it
    rows: int
    names: int
    verdicts: Mapping[str, int]  # Rows by verdict
    sha256: str  # Of the table, sorted, as Parquet
    table_bytes: int  # Of the files of the table
    parts: int
    row_bytes: float  # Of a row with a result, in one file of all such rows
    ended: int  # Runs, or workers, that were killed or interrupted on the way
    # Of the last run: by the clock, of all processors, and the largest memory of who hands out
    seconds: float
    cpu_s: float
    parent_mb: float


def one(size: Size, logs: Path, fleet: Path) -> Told:
    """One process, one log after the other."""
    return _report("one process", size, fleet, _run(logs, fleet))


def two(size: Size, logs: Path, fleet: Path) -> Told:
    """Two processes."""
    return _report("two processes", size, fleet, _run(logs, fleet, "--workers", "2"))


def dask(size: Size, logs: Path, fleet: Path) -> Told:
    """Two workers of Dask, of which one is killed when the first rows are there."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))
        run = _started(logs, fleet, "--dask", cluster.scheduler_address)
        _wait_for(run, partial(_has, fleet, 1))
        os.kill(victim, signal.SIGKILL)
        return _report("Dask, one of two workers killed", size, fleet, _answer(run), 1)


def ended(size: Size, logs: Path, fleet: Path) -> Told:
    """Runs that are killed and interrupted at random instants, each followed by the same again."""
    draws = np.random.default_rng(SEED)
    signals = draws.permutation([signal.SIGKILL] * size.kills + [signal.SIGINT] * size.interrupts).tolist()
    parts = np.sort(draws.uniform(0.0, MOST_DONE * size.logs / TASK_LOGS, len(signals))).tolist()
    arguments = ("--workers", "2", "--task-logs", str(TASK_LOGS))
    given = Counter[int]()
    for number, wanted in zip(signals, parts, strict=True):
        run = _started(logs, fleet, *arguments)
        _wait_for(run, partial(_has, fleet, wanted))
        time.sleep(draws.uniform(0.0, LATER_S))
        if run.poll() is None:
            run.send_signal(number)
            given[number] += 1
        run.communicate()
    killed, interrupted = given[signal.SIGKILL], given[signal.SIGINT]
    return _report(
        f"killed {killed} times and interrupted {interrupted} times, each time run again",
        size,
        fleet,
        _run(logs, fleet, *arguments),
        killed + interrupted,
    )


#: Ways by the names of their folders.
MODES: Mapping[str, Callable[[Size, Path, Path], Told]] = {
    "one": one,
    "two": two,
    "ended": ended,
    "dask": dask,
}


def _started(logs: Path, fleet: Path, *arguments: str) -> subprocess.Popen[str]:
    command = (sys.executable, "-m", "validation.fleet_run.one_run", str(logs), str(fleet), *arguments)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def _answer(run: subprocess.Popen[str]) -> dict[str, Any]:
    sentence, _ = run.communicate()
    answer: dict[str, Any] = json.loads(sentence)
    return answer


def _run(logs: Path, fleet: Path, *arguments: str) -> dict[str, Any]:
    return _answer(_started(logs, fleet, *arguments))


def _has(fleet: Path, parts: float) -> bool:
    return len(part_files(fleet)) >= parts


def _wait_for(run: subprocess.Popen[str], true: Callable[[], bool]) -> None:
    """Until it is so, or the run has ended."""
    while run.poll() is None and not true():
        time.sleep(LOOK_S)


def _report(what: str, size: Size, fleet: Path, took: Mapping[str, float], ended: int = 0) -> Told:
    table = read_flights(fleet)
    verdicts = table.group_by("verdict").agg(pl.len()).sort("verdict").rows()
    parts, whole = part_files(fleet), parquet_bytes(table)
    results = table.filter(pl.col("covariance").is_not_null())
    return Told(
        fleet.name,
        what,
        size.logs,
        table.height,
        table["name"].n_unique(),
        dict(verdicts),
        hashlib.sha256(whole).hexdigest(),
        sum(path.stat().st_size for path in parts),
        len(parts),
        len(parquet_bytes(results)) / max(1, results.height),
        ended,
        took["seconds"],
        took["cpu_s"],
        took["parent_mb"],
    )
