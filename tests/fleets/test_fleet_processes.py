"""Whatever computes a fleet, and whatever is killed meanwhile: the same table, no row lost, none twice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eivor.atomic_file import parquet_bytes
from eivor.fleet.table import read_flights
from fleets.fleet_tasks import write_logs
from studies.dask_cluster import SOURCES

#: Of the plan by which processes are killed.
SEED = 0

#: Begins runs as children of a process that has loaded everything, and kills them, until it was often enough.
SCRIPT = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from eivor.fleet import run as shard
from eivor.fleet.table import FleetOptions
from eivor.fleet.logs import logs_found
from eivor.fleet.run import run_fleet
from fleets.fleet_tasks import QuickRow
shard.RowOfLog = QuickRow
logs, folder, kills, options = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), FleetOptions()
plan, killed, fleets = np.random.default_rng({seed}), 0, 1
while killed < kills:
    child = os.fork()
    if not child:
        run_fleet(logs_found(logs), folder / str(fleets), options, guarded=False, shard_logs=3)
        os._exit(0)
    time.sleep(plan.uniform(0.02, 1.2))
    os.kill(child, signal.SIGKILL)
    was_killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    killed, fleets = killed + was_killed, fleets + (not was_killed)
for fleet in range(fleets + 1):  # the first was never killed
    run_fleet(logs_found(logs), folder / str(fleet), options, guarded=False, shard_logs=3)
"""


def content(folder: Path) -> bytes:
    return parquet_bytes(read_flights(folder))


@pytest.mark.parametrize(
    "kills", [pytest.param(3, marks=pytest.mark.thorough), pytest.param(50, marks=pytest.mark.long)]
)
def test_killed_at_random_instants(tmp_path, kills):
    """SIGKILL to who runs the fleet and begins it again; what is done is begun anew in another folder."""
    texts = {f"{number:03d}.csv": f"slow {number % 50}" for number in range(60)}
    logs = write_logs(tmp_path / "logs", texts)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(seed=SEED), encoding="utf-8")
    fleets = tmp_path / "fleets"
    subprocess.run(
        [sys.executable, str(script), str(logs), str(fleets), str(kills)],
        env=os.environ | {"PYTHONPATH": SOURCES},
        check=True,
    )
    tables = {folder.name: content(folder) for folder in fleets.iterdir()}
    assert len(tables) >= 2
    assert read_flights(fleets / "0").height == len(texts)
    assert set(tables.values()) == {tables["0"]}
