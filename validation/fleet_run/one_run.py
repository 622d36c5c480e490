"""One run of a fleet in a process of its own, which may be killed.

    python -m validation.fleet_run.one_run LOGS FLEET [--workers N | --dask ADDRESS] [--task-logs N]

prints what it took as one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from pathlib import Path

from eivor.fleet.logs import logs_found
from eivor.fleet.run import run_fleet
from eivor.fleet.table import FleetOptions
from eivor.lab.dask_executor import DaskCluster
from eivor.process_pool import Executor, InProcess, LocalThreads
from validation.fleet_run.study import VEHICLES

#: Bytes of a unit of the largest resident memory.
UNIT = 1 if sys.platform == "darwin" else 1024


def main() -> None:
    """Run, and print processor time of this process and of all that it began, and the memory of this one."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs")
    parser.add_argument("fleet", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--dask", default="")
    parser.add_argument("--task-logs", type=int)
    chosen = parser.parse_args()
    start_s = time.monotonic()
    done = run_fleet(
        logs_found(chosen.logs),
        chosen.fleet,
        FleetOptions(vehicle_from=VEHICLES),
        executor=_executor(chosen.workers, chosen.dask),
        shared=bool(chosen.dask),
        shard_logs=chosen.task_logs,
    )
    current, children = (resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    selected = {
        "made": done.logs - done.before,
        "seconds": time.monotonic() - start_s,
        "cpu_s": sum(item.ru_utime + item.ru_stime for item in (current, children)),
        "parent_mb": current.ru_maxrss * UNIT / 1e6,
    }
    sys.stdout.write(json.dumps(selected) + "\n")


def _executor(workers: int, dask: str) -> Executor:
    if dask:
        return DaskCluster(dask)
    return LocalThreads(workers) if workers > 1 else InProcess()


if __name__ == "__main__":
    main()
