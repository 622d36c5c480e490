"""Jobs in processes of their own: told by stages, cancelled, kept to their limits, forgotten."""

from __future__ import annotations

import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path

import polars as pl
import pytest

from eivor.process_pool import TRIES, Limits
from eivor.serve import jobs
from eivor.serve.app import KEPT_S, ServeOptions, Server
from serve.conftest import Asking, Clock


def until(events, stage):
    """Wait for a stage."""
    assert any(event["stage"] == stage for event in events)


def is_alive(process):
    """Whether a process is there that has not ended."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_a_job_tells_its_stages_and_has_a_result(page):
    job = page.job("a flight ü".encode(), "my ü flight.ulg", mass="1.5")
    with page.events(job) as events:
        reported = list(events)
    assert list(dict.fromkeys(item["stage"] for item in reported[:-1])) == [
        "waiting",
        "reading",
        "identifying",
    ]
    assert all(item["elapsed"] >= 0.0 for item in reported[:-1])
    assert reported[-1] == {"done": {"status": "identified"}}
    assert page("GET", f"/jobs/{job}/result.json")[1].decode() == "a flight ü"
    assert page("GET", f"/jobs/{job}/report.html")[1].decode() == "<p>a flight ü"
    assert page.last(job) == reported[-1]  # for those who come late, too
    targets = page.json("GET", f"/jobs/{job}/exports")["targets"]
    assert targets == [{"name": "px4", "file": "my ü flight-px4.params", "reason": "1.5"}]
    status, body, headers = page("GET", f"/jobs/{job}/exports/px4?mass=2:1&prior=a=1&prior=b=2&vehicle=x")
    assert (status, body.decode()) == (200, "mass='2:1', vehicle='x', prior='a=1\\nb=2'")
    assert headers["Content-Disposition"] == (
        "attachment; filename=\"my_flight-px4.txt\"; filename*=UTF-8''my%20%C3%BC%20flight-px4.txt"
    )
    assert page.refused("GET", f"/jobs/{job}/plan/csv") == (409, "Expected csv; received csv. csv")
    assert page.refused("GET", f"/jobs/{job}/exports?" + "&".join(f"x{n}=1" for n in range(21)))[0] == 400
    page.json("DELETE", f"/jobs/{job}")
    assert page.refused("GET", f"/jobs/{job}/result.json")[0] == 404
    assert not list(page.server.folder.glob(f"jobs/{job}*"))


@pytest.mark.thorough
def test_a_running_job_is_cancelled_and_so_is_one_that_waits(opening):
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    running, waiting = page.job(b"child and sleep"), page.job(b"sleep")
    with page.events(running) as events:
        until(events, "sleeping")
        assert next(events)["stage"] == "sleeping"  # something is said while it lasts
        with page.events(waiting) as others:
            assert next(others)["position"] == 1
            assert page.refused("GET", f"/jobs/{waiting}/result.json")[0] == 409
            page.json("DELETE", f"/jobs/{waiting}")
            assert list(others)[-1] == {"cancelled": True}
        (child,) = page.server.folder.glob(f"jobs/{running}/child")
        page.json("DELETE", f"/jobs/{running}")
        assert list(events)[-1] == {"cancelled": True}
    process, given_up_at = int(child.read_text(encoding="ascii")), time.monotonic()
    while is_alive(process):  # what is killed ends when it has its turn
        assert time.monotonic() < given_up_at + 10.0
        time.sleep(0.02)
    assert page.refused("GET", f"/jobs/{running}/report.html")[0] == 409
    assert page.last(page.job(b"well")) == {"done": {"status": "identified"}}


def test_a_log_that_is_refused_is_a_sentence(page):
    assert page.last(page.job(b"refuse"))["failed"]["advice"] == "refuse"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"die", "died (exit code 7)"),
        pytest.param(b"memory", "it took more than 0.2 GB of memory", marks=pytest.mark.thorough),
        pytest.param(b"sleep", "it took longer than 0.6 s to answer", marks=pytest.mark.thorough),
    ],
)
def test_what_a_process_dies_of_is_a_sentence(opening, content, sentence):
    page = opening(workers=1, limits=Limits(0.6, 0.2))
    reported = page.last(page.job(content))["failed"]
    assert reported["expected"] == "a log that takes at most 0.6 s and 0.2 GB"
    assert sentence in reported["sentence"]
    assert "eivor serve --time S --memory GB" in reported["advice"]
    assert page.last(page.job(b"once")) == {"done": {"status": "identified"}}


@pytest.mark.thorough
def test_a_process_that_is_killed_takes_nothing_along(opening):
    page = opening(workers=1, limits=Limits(60.0, 0.5))
    job = page.job(b"sleep")
    with page.events(job) as events:
        for left in reversed(range(TRIES)):
            until(events, "sleeping")
            (pid,) = page.server.folder.glob(f"jobs/{job}/pid")
            os.kill(int(pid.read_text(encoding="ascii")), signal.SIGKILL)
            if left:
                until(events, "reading")
        last = list(events)[-1]
    assert "signal 9" in last["failed"]["sentence"]
    assert page.last(page.job(b"well")) == {"done": {"status": "identified"}}


def test_a_verdict_stays_where_its_report_fails(page):
    job = page.job(b"unreported")
    assert page.last(job) == {"done": {"status": "identified"}}
    assert page("GET", f"/jobs/{job}/result.json")[1] == b"unreported"
    assert page.refused("GET", f"/jobs/{job}/report.html") == (
        500,
        "Expected unreported; received unreported. unreported",
    )


def test_the_queue_is_bounded(opening):
    page = opening(workers=1, most_waiting=2, limits=Limits(60.0, 0.5))
    page.json("GET", "/choices")
    first = page.job(b"sleep")
    with page.events(first) as events:
        until(events, "sleeping")
    page.job(b"sleep")
    page.job(b"sleep")
    log = page.dropped(b"sleep")
    requested = json.dumps({"logs": [log]}).encode()
    status, sentence = page.refused("POST", "/jobs", requested)
    assert (status, "at most 2 tasks that wait" in sentence) == (503, True)
    assert len(list(page.server.folder.glob("jobs/*"))) == 3


def test_many_drops_at_once_are_all_answered(page):
    with ThreadPoolExecutor(20) as many:
        reported = list(many.map(lambda number: page.last(page.job(b"%d" % number)), range(20)))
    assert reported == [{"done": {"status": "identified"}}] * 20


def test_what_is_old_is_forgotten(opening):
    clock = Clock()
    page = opening(clock=clock)
    server = page.server
    log = page.dropped(b"well")
    job = page.json("POST", "/jobs", {"logs": [log]})["job"]
    assert "done" in page.last(job)
    page("GET", f"/jobs/{job}/report.html")
    clock.now += KEPT_S - 1.0
    server.forget()
    assert page("GET", f"/jobs/{job}/result.json")[0] == 200
    clock.now += 2.0
    server.forget()
    assert page.refused("GET", f"/jobs/{job}/result.json")[0] == 404
    assert page.refused("POST", "/jobs", json.dumps({"logs": [log]}).encode())[0] == 404
    assert {path.name for path in server.folder.rglob("*")} == {"logs", "jobs"}


def test_old_logs_make_room_and_those_of_jobs_stay(opening):
    clock = Clock()
    page = opening(clock=clock, workers=1, limits=Limits(60.0, 0.5))
    used = page.dropped(b"sleep" + bytes(900))
    job = page.json("POST", "/jobs", {"logs": [used]})["job"]
    others = []
    for _ in range(4):
        clock.now += 1.0
        others.append(page.dropped(bytes(1000)))
    assert page.refused("DELETE", f"/logs/{others[0]}")[0] == 404
    assert page.refused("DELETE", f"/logs/{used}")[0] == 409
    page.json("DELETE", f"/jobs/{job}")
    page.last(job)
    page.json("DELETE", f"/logs/{used}")
    page.json("DELETE", f"/logs/{others[1]}")


@pytest.mark.thorough
def test_nothing_is_left_when_it_closes_in_the_middle(opening):
    page = opening(workers=2, limits=Limits(60.0, 0.5))
    jobs = [page.job(b"sleep") for _ in range(3)]
    with page.events(jobs[0]) as events:
        until(events, "sleeping")
        page.server.close()
        assert list(events)[-1] == {"cancelled": True}
    assert not page.server.folder.exists()
    assert not page.server.workers.pids()


@pytest.mark.thorough
def test_a_process_that_has_worked_gives_its_memory_back(opening, monkeypatch):
    monkeypatch.setattr(jobs, "IDLE_S", 0.1)
    page = opening(workers=1)
    page.json("GET", "/choices")
    assert "done" in page.last(page.job(b"well"))
    before, until = set(page.server.workers.pids()), time.monotonic() + 20.0
    while set(page.server.workers.pids()) in (before, set()) and time.monotonic() < until:
        time.sleep(0.02)
    assert len(set(page.server.workers.pids()) - before) == 1


#: What memory may have grown by [bytes].
GROWN = 50_000_000


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
        page.json("GET", "/choices")
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


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.thorough
def test_twenty_drops(monkeypatch):
    check(monkeypatch, 2.0, (20, 4))
