"""Whatever computes a study, and whatever is killed meanwhile: the same bytes."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

import pytest

from eivor.dask_executor import DaskCluster
from eivor.errors import InputError, UsageError
from eivor.lab.study import SHARD_TRIALS, run_study
from eivor.process_pool import (
    TASKS_PER_WORKER,
    InProcess,
    Limits,
    LocalProcesses,
    LocalThreads,
    local_executor,
)
from studies.mapped_tasks import Arriving, Patient, refusing, text_of
from studies.study_parts import content, dask_cluster, small_study, wait_for_workers
from worker_answers import answered

#: Enough shards that every worker has some and a killed one leaves some.
RUNS = 6 * SHARD_TRIALS + 10


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected")
    run_study(small_study(RUNS), folder, executor=InProcess())
    return content(folder)


def test_a_lost_worker_is_a_sentence():
    with pytest.raises(
        InputError, match=r"worker processes that live .* one that died .*7.*run the same again"
    ):
        list(LocalProcesses(1).map(answered, ["a", "die"]))


def children():
    """Worker processes of this one."""
    below = [
        int(item) for task in Path("/proc/self/task").glob("*/children") for item in task.read_text().split()
    ]
    return [item for item in below if b"process_pool" in Path(f"/proc/{item}/cmdline").read_bytes()]


@pytest.mark.parametrize("executor", [InProcess(), LocalProcesses(2), LocalThreads(2)])
def test_any_function_is_mapped(executor):
    """A flight, a scenario or a study: an executor does not know what a task is."""
    items = ["a", ("b", 1), None, 3.5]
    assert dict(executor.map(text_of, items)) == {index: text_of(item) for index, item in enumerate(items)}
    assert list(executor.map(text_of, [])) == []
    with pytest.raises(InputError, match=r"Expected no 7; received one\. Leave it out"):
        list(executor.map(refusing, [7]))


def test_a_worker_that_begins_is_not_interrupted(capfd):
    """Ctrl-C reaches a worker while it still imports; it is the parent's business all the same."""
    assert dict(LocalProcesses(2).map(Arriving(), [1, 2])) == {0: "<1>", 1: "<2>"}
    assert capfd.readouterr().err == ""


def test_items_are_taken_as_there_is_room():
    """Memory does not grow with their number."""
    taken: list[int] = []
    items = (taken.append(item) or item for item in range(1000))
    with contextlib.closing(LocalProcesses(2).map(text_of, items)) as results:
        next(results)
        assert len(taken) <= 2 * TASKS_PER_WORKER


@pytest.mark.parametrize("executor", [LocalProcesses(1), LocalThreads(1)])
def test_closing_ends_the_work(executor, tmp_path):
    """Workers that nobody waits for end between two parts of a task, and are gone."""
    with contextlib.closing(executor.map(Patient(tmp_path), range(5))) as results:
        assert next(results) == (0, 0)
    assert not children()
    assert not (tmp_path / "4").exists()


@pytest.fixture
def cluster(tmp_path):
    with dask_cluster(tmp_path) as started:
        yield started


@pytest.mark.thorough
def test_dask_with_a_worker_killed(expected, cluster, tmp_path):
    """Two workers, one of which is killed in the middle."""
    folder = tmp_path / "study"
    killed: list[int] = []

    def kill(done, total):
        if done >= 2 * SHARD_TRIALS and not killed:
            cluster.workers[0].kill()
            killed.append(done)

    wait_for_workers(cluster.address, 2)
    run_study(small_study(RUNS), folder, executor=DaskCluster(cluster.address), progress=kill)
    assert killed
    assert cluster.workers[0].poll() is not None
    assert cluster.workers[1].poll() is None
    assert content(folder) == expected


@pytest.mark.thorough
def test_dask_without_a_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr("eivor.dask_executor.PATIENCE_S", 0.5)
    with pytest.raises(
        InputError, match=r"Expected a Dask scheduler at tcp://127.0.0.1:1; received no answer"
    ):
        run_study(small_study(), tmp_path, executor=DaskCluster("tcp://127.0.0.1:1"))


def test_dask_is_optional(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"Dask, which is needed .*pip install 'eivor\[dask\]'"):
        run_study(small_study(), tmp_path, executor=DaskCluster("tcp://127.0.0.1:1"))


def test_workers_and_addresses_that_cannot_be_are_refused(monkeypatch):
    for refused in (lambda: LocalProcesses(0), lambda: LocalThreads(0), lambda: local_executor(0, 5)):
        with pytest.raises(UsageError, match="Expected one worker or more; received 0"):
            refused()
    with pytest.raises(UsageError, match="Expected the address of a Dask scheduler; received 'somewhere'"):
        DaskCluster("somewhere")
    with pytest.raises(UsageError, match=r"a limit .* above zero"):
        Limits(time_s=0.0)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert local_executor(None, 100) == LocalProcesses(8)
    assert local_executor(5, 1) == local_executor(None, 0) == InProcess()
