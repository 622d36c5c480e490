"""Real drops, many of them: every one is answered, and memory, files and processes are as before."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path

import polars as pl
import pytest

from eivor.serve import jobs
from eivor.serve.app import ServeOptions, Server
from serve.conftest import Asking

#: What memory may have grown by [bytes].
GROWN = 50_000_000

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")


def held(pids: list[int]) -> int:
    """Memory that processes hold [bytes]."""
    return sum(int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * 4096 for pid in pids)


def fresh(server: Server) -> int:
    """The process that waits, once those that have worked are gone."""
    used, end = set(server.workers.pids()), time.monotonic() + 60.0
    assert used
    while time.monotonic() < end:
        pids = server.workers.pids()
        if len(pids) == 1 and pids[0] not in used:
            return pids[0]
        time.sleep(0.05)
    raise AssertionError(f"no new process: {pids}")


def dropped(page: Asking, content: bytes, count: int, at_once: int) -> None:
    """Drop a log so often, and ask for everything that comes of it."""

    def drop(number: int) -> None:
        job = page.job(content, f"{number}.csv")
        assert set(page.last(job)) == {"done"}
        for name in ("result.json", "report.html", "exports"):
            assert page("GET", f"/jobs/{job}/{name}")[0] == 200
        page.json("DELETE", f"/jobs/{job}")

    with ThreadPoolExecutor(at_once) as many:
        list(many.map(drop, range(count)))


def check(monkeypatch: pytest.MonkeyPatch, seconds: float, *rounds: tuple[int, int]) -> None:
    """Drop logs of so many seconds: so many, so many of them at once."""
    with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as path:
        content = pl.read_parquet(path).filter(pl.col("time") < seconds).write_csv().encode()
    monkeypatch.setattr(jobs, "IDLE_S", 1.0)
    server = Server(ServeOptions(workers=2))
    try:
        page = Asking(server)
        dropped(page, content, 1, 1)  # what this process loads by itself
        before = held([os.getpid(), fresh(server)])
        for count, at_once in rounds:
            dropped(page, content, count, at_once)
        assert held([os.getpid(), fresh(server)]) < before + GROWN
        assert not list(server.folder.glob("jobs/*"))
    finally:
        server.close()
    assert not server.folder.exists()
    assert not server.workers.pids()


@pytest.mark.thorough
def test_twenty_drops(monkeypatch):
    check(monkeypatch, 2.0, (20, 4))


@pytest.mark.long
def test_two_hundred_drops(monkeypatch):
    check(monkeypatch, 20.0, (200, 1), (20, 20))
