"""A fleet's run, against the plain loop over the same logs, by one process and by two.

Targets: two processes 1.8 times one; no more than 1.1 times the sum of the single identifications; memory of
who hands out the logs flat in their number. What two processes can reach on a machine is what two plain loops
reach, each over half the logs: cores that share a core's units, or that others use, give less than two.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from _shared import EIVOR, arguments, machine

from validation.simulated_fleets import FleetSpec, write_fleet_logs

#: Reads and identifies logs, one after the other, and prints the seconds of it: by the clock, of processors.
LOOP = """
import sys, time
from eivor.logs.read import read_log
from eivor.motions.identify import identify_flight
from threadpoolctl import threadpool_limits
threadpool_limits(limits=1)
identify_flight(read_log(sys.argv[1]))  # what is loaded once
begun = time.perf_counter(), time.process_time()
for path in sys.argv[1:]:
    identify_flight(read_log(path))
print(time.perf_counter() - begun[0], time.process_time() - begun[1])
"""
#: Logs of fleets whose memory is measured: some minutes for each 100,000 that are not identical.
MANY = {"damaged": (2_000, 20_000, 200_000), "identical": (2_000, 20_000, 200_000)}
#: How often the memory of a process is looked at [s].
LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class Took:
    """Seconds by the clock and of all processors, and the largest memory of the first process [MB]."""

    wall_s: float
    cpu_s: float
    memory_mb: float = 0.0


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    count, duration_s, rounds = (2, 4.0, 1) if small else (200, 30.0, 2)
    many = {"damaged": (10,), "identical": (10,)} if small else MANY
    with tempfile.TemporaryDirectory() as position:
        folder = Path(position)
        spec = FleetSpec(vehicles=2, flights=count // 2, duration_s=duration_s)
        logs = write_as_csv(list(write_fleet_logs(spec, folder / "made")), folder / "logs")
        cases: dict[str, Callable[[int], Took]] = {
            "plain loop": lambda _: loops(logs, 1),
            "two plain loops": lambda _: loops(logs, 2),
            "fleet, one log": lambda turn: fleet(logs[0], folder / f"0-{turn}", 1),
            "fleet, one process": lambda turn: fleet(folder / "logs", folder / f"1-{turn}", 1),
            "fleet, two processes": lambda turn: fleet(folder / "logs", folder / f"2-{turn}", 2),
        }
        results = {name: [case(0)] for name, case in cases.items()}
        for turn in range(1, rounds):
            for name, case in cases.items():
                results[name].append(case(turn))
        print_run(count, {name: least(tries) for name, tries in results.items()})
        for kind, numbers in many.items():
            for number in numbers:
                print_memory(kind, number, folder)


def write_as_csv(logs: Sequence[Path], folder: Path) -> list[Path]:
    """Logs as CSV, which is read as it stands: Parquet is tried in a process of its own where it is alone."""
    import polars as pl

    folder.mkdir()
    path = [folder / f"{number:04d}.csv" for number in range(len(logs))]
    for log, item in zip(logs, path, strict=True):
        pl.read_parquet(log).write_csv(item)
    return path


def loops(logs: Sequence[Path], count: int) -> Took:
    """Plain loops at once, each over its share of the logs."""
    started = [
        subprocess.Popen(
            (sys.executable, "-c", LOOP, *map(str, logs[index::count])), stdout=subprocess.PIPE, text=True
        )
        for index in range(count)
    ]
    selected = [tuple(map(float, process.communicate()[0].split())) for process in started]
    return Took(max(wall for wall, _ in selected), sum(cpu for _, cpu in selected))


def fleet(logs: Path, out: Path, workers: int) -> Took:
    """A run of the command line, its start included."""
    command = (*EIVOR, "fleet", "run", str(logs), "-o", str(out), "--workers", str(workers))
    start_s, memory = time.perf_counter(), 0.0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while True:
        memory = max(memory, memory_mb(process.pid))
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            break
        time.sleep(LOOK_S)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{command} left with {process.returncode}")
    return Took(time.perf_counter() - start_s, usage.ru_utime + usage.ru_stime, memory)


def memory_mb(pid: int) -> float:
    """Largest memory of a process so far [MB]; zero where the system does not say."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)


def least(tries: Sequence[Took]) -> Took:
    return Took(*(min(getattr(item, name) for item in tries) for name in ("wall_s", "cpu_s", "memory_mb")))


def print_run(count: int, took: dict[str, Took]) -> None:
    for name, item in took.items():
        memory = f", first process {item.memory_mb:.0f} MB" if item.memory_mb else ""
        print(f"{name:21} {item.wall_s:7.1f} s, of processors {item.cpu_s:7.1f} s{memory}")
    plain, alone = took["plain loop"], took["fleet, one log"]
    item, two = took["fleet, one process"], took["fleet, two processes"]
    work = (item.cpu_s - alone.cpu_s) / (count - 1) * count
    print(
        f"processors, fleet over plain loop: {item.cpu_s / plain.cpu_s:.2f} with its start of some seconds;"
    )
    print(f"    {work / plain.cpu_s:.2f} without; two processes over one: {two.cpu_s / item.cpu_s:.2f}")
    reached, most = item.wall_s / two.wall_s, plain.wall_s / took["two plain loops"].wall_s
    print(f"two processes {reached:.2f} times one; plain loops {most:.2f}; of these {reached / most:.2f}")


def print_memory(kind: str, count: int, folder: Path) -> None:
    """Memory by the number of logs, which are damaged, each in its own way or all in one: that is quick."""
    logs = folder / f"{kind}-{count}"
    logs.mkdir()
    for number in range(count):
        current = number if kind == "damaged" else 0
        (logs / f"{number}.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + current.to_bytes(8, "little"))
    took = fleet(logs, folder / f"of-{kind}-{count}", 1)
    print(f"{count:7,d} {kind} logs: {took.wall_s:.1f} s, first process {took.memory_mb:.0f} MB")


if __name__ == "__main__":
    main()
