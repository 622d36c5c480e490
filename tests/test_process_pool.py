"""Worker processes: a hostile item takes none of its neighbours along, and nothing outlives its parent."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys

import pytest

from eivor import process_pool
from eivor.errors import InputError
from eivor.process_pool import SANDBOX, AbandonedError, LimitError, Limits, WorkerProcess
from studies.study_parts import SOURCES, wait_until
from worker_answers import always_reporting, answered, begin_another, counted, unreadable


@pytest.mark.thorough
def test_items_are_kept_to_their_limits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    worker = WorkerProcess(answered, Limits(time_s=0.4, memory_gb=1.0))
    with contextlib.closing(worker):
        first = worker("pid")
        assert worker("a") == "<a>"
        assert worker("pid") == first != os.getpid()
        with pytest.raises(LimitError, match=r"It took longer than 0\.4 s to answer"):
            worker("sleep")
        with pytest.raises(LimitError, match=r"It took more than 1 GB of memory"):
            worker("memory")
        with pytest.raises(LimitError, match=r"died \(exit code 7\)\.$"):
            worker("die")
        with pytest.raises(LimitError, match=r"died \(exit code 0\)\.$"):
            worker("end")
        with pytest.raises(LimitError, match=r"said last: memory allocation of 9 bytes failed\.$"):
            worker("words")
        with pytest.raises(LimitError, match=r"\(exit code 1\).* last: ZeroDivisionError: of all"):
            worker("mistake")
        assert worker("once") == "<once>"  # the second time, in a process that had no other
        alive = worker("pid")
        os.kill(alive, signal.SIGKILL)
        assert worker("b") == "<b>"
        last = worker("pid")
        with pytest.raises(InputError, match="Expected no refusal; received one"):
            worker("refuse")
        assert worker("pid") == last
    assert worker.pid is None
    for ended in (first, last):
        with pytest.raises(ProcessLookupError):
            os.kill(ended, 0)


def test_an_abandoned_item_is_given_up(monkeypatch):
    monkeypatch.setattr(process_pool, "abandoned", lambda: True)
    worker = WorkerProcess(answered, Limits())
    with pytest.raises(AbandonedError):
        worker("sleep")
    assert worker.pid is None


def test_progress_comes_in_order_and_anew_with_another_attempt(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reported: list[int] = []
    with contextlib.closing(WorkerProcess(counted)) as worker:
        assert worker(3, report=reported.append) == 3
        (tmp_path / "die once").touch()
        assert worker(2, report=reported.append) == 2
    assert reported == [0, 1, 2, 0, 1, 0, 1]


def test_a_result_that_cannot_be_read_ends_its_process(monkeypatch):
    monkeypatch.setattr(process_pool, "WORDS_S", 0.1)
    with pytest.raises(LimitError, match=r"died \(signal 9\)"):
        WorkerProcess(unreadable)(1)


PARENT = """
import sys
from eivor.process_pool import WorkerProcess
from worker_answers import always_reporting, answered, begin_another, counted, unreadable
WorkerProcess(begin_another)(sys.argv[1])
"""


def is_alive(process):
    """Whether a process is there."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.thorough
def test_nothing_outlives_a_parent_that_is_killed(tmp_path):
    """Neither the worker nor what it has begun."""
    noted = tmp_path / "pid"
    environment = os.environ | {"PYTHONPATH": SOURCES}
    with subprocess.Popen([sys.executable, "-c", PARENT, str(noted)], env=environment) as parent:
        wait_until(lambda: noted.exists() and noted.read_text(encoding="ascii"), parent)
        parent.kill()
    started = int(noted.read_text(encoding="ascii"))
    wait_until(lambda: not is_alive(started))


@pytest.mark.thorough
def test_what_a_cancelled_item_has_begun_ends_with_it(tmp_path):
    noted = tmp_path / "pid"
    with pytest.raises(AbandonedError):
        WorkerProcess(begin_another)(str(noted), given_up=lambda: noted.exists() and noted.stat().st_size > 0)
    wait_until(lambda: not is_alive(int(noted.read_text(encoding="ascii"))))


SCRIPT = """
from eivor.process_pool import LocalProcesses
def doubled(item):
    return 2 * item
{guard}
    print(sorted(LocalProcesses(2).map(doubled, [1, 2])))
"""


@pytest.mark.thorough
def test_functions_of_a_script_need_its_guard(tmp_path):
    script = tmp_path / "script.py"
    outputs = []
    for guard in ("if __name__ == '__main__':", "if True:"):
        script.write_text(SCRIPT.format(guard=guard), encoding="utf-8")
        done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
        outputs.append((done.stdout, done.stderr))
    assert outputs[0] == ("[(0, 2), (1, 4)]\n", "")
    assert outputs[1][0] == ""
    assert "a script that runs tasks of its own guarded by" in outputs[1][1]


def test_a_process_that_may_die_decodes_at_once(tmp_path, monkeypatch):
    """What decoders do to a process is a further one's business, but where this one is there for it."""
    from eivor.logs.table import columnar

    started = []
    monkeypatch.setattr(columnar.subprocess, "run", lambda *_, **__: started.append(1) or columnar.subprocess)
    monkeypatch.setattr(columnar.subprocess, "returncode", 0, raising=False)

    def decoded():
        columnar.decode_in_child(tmp_path / "a", "", {}, max_bytes=1, timeout_s=1.0, kind="a file")
        return len(started)

    monkeypatch.delenv(SANDBOX, raising=False)
    assert decoded() == 1
    monkeypatch.setenv(SANDBOX, "1")
    assert decoded() == 1


def test_progress_does_not_hide_limits():
    with pytest.raises(LimitError, match=r"It took longer than 0\.1 s to answer"):
        WorkerProcess(always_reporting, Limits(0.1, 4.0))(1, report=lambda _: None)
