"""Whatever computes a fleet, and whatever is killed meanwhile: the same table, no row lost, none twice."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.logs_found import logs_found
from eivor.fleets.run import run_fleet
from eivor.fleets.table import read_flights
from eivor.logs.table.written import write_recording
from eivor.signals.log_origin import LogOrigin
from eivor.simulation.flights.vertical_flight import simulate_vertical_flights
from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec
from eivor.studies.dask_executor import DaskCluster
from eivor.studies.executors import LocalProcesses
from eivor.studies.sealed_table import parquet_bytes
from fleets.fleet_tasks import write_logs
from studies.dask_cluster import SOURCES, dask_cluster, wait_for_workers

#: Of the plan by which processes are killed.
SEED = 0

#: Begins runs as children of a process that has loaded everything, and kills them, until it was often enough.
SCRIPT = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from eivor.fleets import shard
from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.logs_found import logs_found
from eivor.fleets.run import run_fleet
from fleets.fleet_tasks import QuickRow
shard.FlightRow = QuickRow
found, folder, kills, options = logs_found(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), FleetOptions()
plan, killed, fleets = np.random.default_rng({seed}), 0, 1
while killed < kills:
    child = os.fork()
    if not child:
        run_fleet(found, folder / str(fleets), options, guarded=False, shard_logs=3)
        os._exit(0)
    time.sleep(plan.uniform(0.02, 1.2))
    os.kill(child, signal.SIGKILL)
    was_killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    killed, fleets = killed + was_killed, fleets + (not was_killed)
for fleet in range(fleets + 1):  # the first was never killed
    run_fleet(found, folder / str(fleet), options, guarded=False, shard_logs=3)
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


def simulated_fleet(folder: Path, vehicles: int, flights: int) -> Path:
    """Small logs: vehicles with a board of their own, and a copy."""
    folder.mkdir()
    draws = np.random.default_rng(1)
    specs = [
        VerticalFlightSpec(hover_input=float(draws.uniform(0.4, 0.6)), seed=number, duration=20.0)
        for number in range(vehicles * flights)
    ]
    for number, flight in enumerate(simulate_vertical_flights(specs)):
        origin = LogOrigin(board=f"N{number // flights:03d}", airframe="simulated")
        write_recording(replace(flight.recording, origin=origin), folder / f"{number:04d}.parquet")
    (folder / "copy.parquet").write_bytes((folder / "0000.parquet").read_bytes())
    (folder / "damaged.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    return folder


@pytest.mark.long
def test_local_processes_and_a_cluster_make_the_same_table(tmp_path):
    """Two local processes; two workers of Dask, one of which is killed when the first rows are there."""
    found = logs_found(str(simulated_fleet(tmp_path / "logs", 2, 2)))
    options = FleetOptions()
    run_fleet(found, tmp_path / "one", options)
    assert read_flights(tmp_path / "one").height == len(found.logs) == 6
    run_fleet(found, tmp_path / "two", options, executor=LocalProcesses(2))
    assert content(tmp_path / "two") == content(tmp_path / "one")
    with dask_cluster(tmp_path) as cluster:
        wait_for_workers(cluster.address, 2)

        def kill(done: int, _total: int) -> None:
            if done and cluster.workers[0].poll() is None:
                cluster.workers[0].kill()

        run = run_fleet(
            found,
            tmp_path / "dask",
            options,
            executor=DaskCluster(cluster.address),
            shared=True,
            shard_logs=1,
            progress=kill,
        )
        assert cluster.workers[0].poll() is not None
    assert run.verdicts["copy"] == run.verdicts["failed"] == 1
    assert content(tmp_path / "dask") == content(tmp_path / "one")
