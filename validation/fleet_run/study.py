"""Whether a fleet's table is the same whatever computes it and whatever is killed meanwhile.

    python -m validation.fleet_run.study --kept FILE.jsonl [--size small|full] [--page docs/fleet.md]

simulates the fleet of the grid beside this file, runs it in one process, in two, in two that are killed and
interrupted at random instants and begun again, and on two workers of Dask of which one is killed, and
compares the tables to the byte. Logs and fleets are in a folder beside the file; what is there is not made
again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from eivor.atomic_file import parquet_bytes
from eivor.dask_executor import DaskCluster
from eivor.fleet.logs import logs_found
from eivor.fleet.run import run_fleet
from eivor.fleet.table import FleetOptions, part_files, read_flights
from eivor.process_pool import Executor, InProcess, LocalThreads
from validation.simulated_fleets import FleetSpec, write_fleet_logs
from validation.studies import (
    GridStruct,
    Group,
    KeptRun,
    KeptStudy,
    Requirement,
    alone,
    table_of,
)
from validation.suite_files import versions

#: Of all draws.
SEED = 20261122
#: Where the vehicle stands in a log's name.
VEHICLES = "**/{vehicle}/*.parquet"


class Size(GridStruct, frozen=True):
    """A fleet of the grid, see its file."""

    told_vehicles: int
    told_flights: int
    short_vehicles: int
    short_flights: int
    kills: int
    interrupts: int
    told_s: float
    short_s: float

    @property
    def logs(self) -> int:
        return self.told_vehicles * self.told_flights + self.short_vehicles * self.short_flights + 3


def write_logs(size: Size, folder: Path) -> None:
    """Simulate what is not there yet, and put a copy, a damaged log and an empty one beside it."""
    parts = (
        ("told", size.told_vehicles, size.told_flights, size.told_s),
        ("short", size.short_vehicles, size.short_flights, size.short_s),
    )
    for name, vehicles, flights, duration_s in parts:
        path = folder / name
        if path.exists():
            continue
        started = folder / f"{name}-begun"
        shutil.rmtree(started, ignore_errors=True)
        spec = FleetSpec(vehicles=vehicles, flights=flights, duration_s=duration_s, wear=0.1, seed=SEED)
        for _ in write_fleet_logs(spec, started):
            pass
        started.rename(path)
    first = folder / "told" / "v0000" / "0000.parquet"
    shutil.copyfile(first, folder / "zz-copy.parquet")
    (folder / "damaged.parquet").write_bytes(first.read_bytes()[:-40])
    (folder / "empty.ulg").touch()


#: Logs of a task where runs are ended: little is made twice.
TASK_LOGS = 5
#: Longest time between the part of the table that a signal waits for, and the signal [s].
LATER_S = 1.5
#: Share of the fleet that is done when the last signal comes, at most.
MOST_DONE = 0.95
#: How often it is looked at whether it is time [s].
LOOK_S = 0.02


#: Word after which the command is one run of a fleet, in a process that may be killed.
ONE = "one-run"
#: Bytes of a unit of the largest resident memory.
UNIT = 1 if sys.platform == "darwin" else 1024


def one_run(arguments: Sequence[str]) -> int:
    """Print processor time of this process and of all that it began, and the memory of this one."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs")
    parser.add_argument("fleet", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--dask", default="")
    parser.add_argument("--task-logs", type=int)
    chosen = parser.parse_args(arguments)
    start_s = time.monotonic()
    workers: Executor = LocalThreads(chosen.workers) if chosen.workers > 1 else InProcess()
    done = run_fleet(
        logs_found(chosen.logs),
        chosen.fleet,
        FleetOptions(vehicle_from=VEHICLES),
        executor=DaskCluster(chosen.dask) if chosen.dask else workers,
        shared=bool(chosen.dask),
        shard_logs=chosen.task_logs,
    )
    current, children = (resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    took = {
        "made": done.logs - done.before,
        "seconds": time.monotonic() - start_s,
        "cpu_s": sum(item.ru_utime + item.ru_stime for item in (current, children)),
        "parent_mb": current.ru_maxrss * UNIT / 1e6,
    }
    sys.stdout.write(json.dumps(took) + "\n")
    return 0


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
    ended: int  # Runs, or workers, that were killed or interrupted on the way
    # Of the last run: by the clock, of all processors, and the largest memory of who hands out
    seconds: float
    cpu_s: float
    parent_mb: float


def one(size: Size, logs: Path, fleet: Path) -> Told:
    return _report("one process", size, fleet, _run(logs, fleet))


def two(size: Size, logs: Path, fleet: Path) -> Told:
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
    command = (sys.executable, "-m", "validation.fleet_run.study", ONE, str(logs), str(fleet), *arguments)
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
    while run.poll() is None and not true():
        time.sleep(LOOK_S)


def _report(what: str, size: Size, fleet: Path, took: Mapping[str, float], ended: int = 0) -> Told:
    table = read_flights(fleet)
    verdicts = table.group_by("verdict").agg(pl.len()).sort("verdict").rows()
    parts, whole = part_files(fleet), parquet_bytes(table)
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
        ended,
        took["seconds"],
        took["cpu_s"],
        took["parent_mb"],
    )


def groups(sizes: dict[str, Size], size: str, kept: Path) -> list[Group[tuple[str], Told]]:
    """Logs are made first where they are not there yet."""
    chosen, folder = sizes[size], kept.with_suffix("")
    write_logs(chosen, folder / "logs")
    return alone(
        {(name,): partial(made, chosen, folder / "logs", folder / name) for name, made in MODES.items()}
    )


def requirements(run: KeptRun[dict[str, Size], Told]) -> Iterator[Requirement]:
    size = run.grid[run.size]
    rows = {item.rows for item in run.lines} | {item.names for item in run.lines}
    yield Requirement(
        "a row for each log, and one only, in every case",
        f"{size.logs:,}",
        ", ".join(f"{count:,}" for count in sorted(rows)),
        rows == {size.logs},
    )
    tables = len({item.sha256 for item in run.lines})
    yield Requirement("different tables, compared to the byte", "1", f"{tables}", tables == 1)
    ended = sum(item.ended for item in run.lines)
    wanted = size.kills + size.interrupts + 1
    yield Requirement("runs and workers that were ended", f"{wanted}", f"{ended}", ended >= wanted)


COLUMNS: Mapping[str, str | Callable[[Told], str]] = {
    "run": "{.what}",
    "rows": "{.rows:,}",
    "parts": "{.parts:,}",
    "table": lambda line: f"{line.table_bytes / 1e6:.1f} MB",
    "memory of who hands out": "{.parent_mb:.0f} MB",
}


def tables(run: KeptRun[dict[str, Size], Told]) -> Iterator[str]:
    size, first = run.grid[run.size], run.lines[0]
    verdicts = ", ".join(f"{count:,} {verdict}" for verdict, count in first.verdicts.items())
    yield (
        f" with {versions()}, seed {SEED}: {size.short_vehicles:,} vehicles with {size.short_flights} "
        f"flights each that are too short to be told, {size.told_vehicles} with {size.told_flights} that are "
        f"not; a copy, a damaged log and an empty one. Rows: {verdicts}."
    )
    yield table_of(COLUMNS, run.lines)


STUDY = KeptStudy(
    "fleet_run.study", __doc__, "fleet run", dict[str, Size], Told, ("mode",), groups, requirements, tables
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(one_run(sys.argv[2:]) if sys.argv[1:2] == [ONE] else main())
