"""Small studies that several tests run, a Dask cluster, and waiting for processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from eivor.lab.experiments import DifferenceEquation
from eivor.lab.study import TABLE_FILE, MethodChoice, Study
from eivor.signals.noise import WhiteNoise
from eivor.simulation.excitation import Excitation


@dataclass(frozen=True)
class Coin(Excitation):
    """+-1, independent."""

    def sample(self, count, step_s, rng):
        del step_s
        return rng.choice([-1.0, 1.0], count)


EQUATION = DifferenceEquation(
    (0.5,), (2.0,), Coin(), samples=200, noise={"output": WhiteNoise(0.5), "input": WhiteNoise(0.3)}
)

METHODS = (
    MethodChoice("least_squares"),
    MethodChoice("extended_iv", (1, 5)),
    # weighted, so that trials are computed one by one
    MethodChoice("generalized_iv", (0, 5), weighting="two_stage", known_noise=("input",)),
)


def small_study(runs=60, **changes):
    parts: dict[str, object] = {"name": "small", "experiment": EQUATION, "methods": METHODS, "seed": 7}
    return Study(**(parts | {"runs": runs} | changes))


def content(folder):
    """Every file of trials in a folder, by name."""
    shards = {path.name: path.read_bytes() for path in sorted((folder / "shards").iterdir())}
    return shards | {TABLE_FILE: (folder / TABLE_FILE).read_bytes()}


#: Longest wait for another process [s]: a machine that is busy with other work must not fail a test.
PATIENCE_S = 600.0
ROOT = Path(__file__).parents[2]

#: Where processes that are begun here find this checkout and the parts of its tests.
SOURCES = os.pathsep.join(str(ROOT / folder) for folder in ("src", "tests"))


@dataclass
class Cluster:
    address: str
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def dask_cluster(tmp_path):
    """A Dask scheduler and two workers on loopback, each a process of its own."""
    scheduler_file = tmp_path / "scheduler.json"
    environment = os.environ | {
        "PYTHONPATH": SOURCES,
        # One that was killed is missed at once all the same; one that still imports is not given up.
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "60s",
    }

    def begun(command, *options):
        return subprocess.Popen(
            [
                *(sys.executable, "-m", f"distributed.cli.dask_{command}"),
                *("--scheduler-file", str(scheduler_file), "--no-dashboard", *options),
            ],
            env=environment,
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    processes = [begun("scheduler", "--host", "127.0.0.1", "--port", "0")]
    try:
        wait_until(scheduler_file.exists, processes[0])
        options = ("--no-nanny", "--nthreads", "1", "--host", "127.0.0.1")
        processes += [begun("worker", *options) for _ in range(2)]
        yield Cluster(address_in(scheduler_file), processes[1:])
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def address_in(scheduler_file):
    import json

    result: str = json.loads(scheduler_file.read_text(encoding="utf-8"))["address"]
    return result


def wait_for_workers(address, count):
    from distributed import Client

    with Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=PATIENCE_S)


def wait_until(true, process=None, patience_s=PATIENCE_S):
    end = time.monotonic() + patience_s
    while not true():
        assert process is None or process.poll() is None, "the process ended before it was killed"
        assert time.monotonic() < end
        time.sleep(0.005)
