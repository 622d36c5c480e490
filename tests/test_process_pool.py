"""Worker processes: a hostile item takes none of its neighbours along, and nothing outlives its parent."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import eivor
from eivor import process_pool
from eivor.atomic_file import (
    ABANDONED_S,
    PREFIX,
    SEAL_MARK,
    SUFFIX,
    atomic_write,
    check_writable,
    is_sealed,
    remove_abandoned,
    sealed,
    write_atomically,
)
from eivor.errors import InputError
from eivor.process_pool import SANDBOX, AbandonedError, LimitError, Limits, WorkerProcess
from worker_answers import SOURCES, always_reporting, answered, begin_another, counted, unreadable, wait_until


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
        alone, turn = [], process_pool._TURNS.turn
        monkeypatch.setattr(
            process_pool._TURNS, "turn", lambda *a, **b: alone.append(b["exclusive"]) or turn(*a, **b)
        )
        with pytest.raises(LimitError, match=r"died \(exit code 7\)\.$"):
            worker("die")
        assert alone == [False, True]  # once more by itself
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


def test_the_last_attempt_has_the_computer_for_itself():
    turns, seen = process_pool._Turns(), []

    def attempt(alone):
        with turns.turn(lambda: False, exclusive=alone):
            seen.append(alone)

    threads = [threading.Thread(target=attempt, args=(alone,)) for alone in (True, False)]
    with turns.turn(lambda: False, exclusive=False):
        for thread in threads:
            thread.start()
            wait_until(lambda: turns._exclusive)
        assert seen == []
        with pytest.raises(AbandonedError), turns.turn(lambda: True, exclusive=True):
            pass
    for thread in threads:
        thread.join()
    assert seen == [True, False]


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
    monkeypatch.setattr(process_pool, "DEATH_S", 0.1)
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
    (tmp_path / "a").touch()
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


# Files are whole or not there, and a seal tells a table that was changed.

PACKAGE = Path(eivor.__file__).parent


def names(folder):
    return [path.name for path in folder.iterdir()]


def half_written(path, error):
    with atomic_write(path) as file:
        file.write(b"half")
        raise error


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    write_atomically(path, "Größe")
    assert path.read_text(encoding="utf-8") == "Größe"
    assert names(tmp_path) == ["x"]


@pytest.mark.parametrize("error", [OSError(28, "full"), KeyboardInterrupt(), ValueError("x")])
def test_an_error_leaves_what_was_there(tmp_path, error):
    path = tmp_path / "x"
    for before in ([], ["x"]):
        with pytest.raises(type(error)):
            half_written(path, error)
        assert names(tmp_path) == before
        path.write_bytes(b"old")
    assert path.read_bytes() == b"old"


def test_permissions_are_those_of_the_user_or_of_the_earlier_file(tmp_path):
    path = tmp_path / "x"
    before = os.umask(0o027)
    try:
        write_atomically(path, b"")
        assert path.stat().st_mode & 0o777 == 0o640
        path.chmod(0o606)
        write_atomically(path, b"")
        assert path.stat().st_mode & 0o777 == 0o606
    finally:
        os.umask(before)


def test_what_is_no_file_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        check_writable(pipe)
        write_atomically(pipe, b"through")
        assert os.read(reader, 100) == b"through"
        assert pipe.is_fifo()
    finally:
        os.close(reader)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(Path("/dev/full"), b"x")
    with pytest.raises(IsADirectoryError):
        write_atomically(tmp_path, b"x")


def test_a_file_that_is_protected_stays(tmp_path, monkeypatch):
    path = tmp_path / "x"
    path.write_bytes(b"old")
    path.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # for the superuser nothing is protected
    for attempt in (lambda: write_atomically(path, b"new"), lambda: check_writable(path)):
        with pytest.raises(PermissionError):
            attempt()
    assert path.read_bytes() == b"old"


def test_what_a_killed_process_left_is_removed(tmp_path):
    old, young, other = (tmp_path / name for name in (f"{PREFIX}1{SUFFIX}", f"{PREFIX}2{SUFFIX}", ".mine"))
    for path in (old, young, other):
        path.touch()
    past = time.time() - 2.0 * ABANDONED_S
    for path in (old, other):
        os.utime(path, (past, past))
    remove_abandoned(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([young, other])


def test_nothing_else_in_the_package_writes_files():
    """Other ways to write a file would leave half of one behind."""
    formulas = re.compile(
        r"\.write_(text|bytes)\(|\.(write_csv|write_parquet|savefig)\((?!\s*(?:file|buffer)\b|\))"
        r"|mkstemp|open\([^)]*[\"'][wax]"
    )
    results = {
        str(file.relative_to(PACKAGE))
        for file in PACKAGE.rglob("*.py")
        if formulas.search(file.read_text(encoding="utf-8"))
    }
    copies = {"logs/common.py", "logs/read.py"}  # of a pipe or an address, in a folder that goes again
    stores = {"fleet/table.py"}  # objects at an address, which are there whole or not at all
    assert results - copies - stores == {"atomic_file.py"}


FACTS = {"eivor.study": "b" * 64, "eivor.trials": "25 to 49"}


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(3)
    status = pl.Series("status", ["identified", "weak", None] * 8)
    return pl.DataFrame({"trial": np.arange(24), "value": rng.standard_normal(24)}).with_columns(status)


@pytest.fixture(scope="module")
def content(table):
    return sealed(table, FACTS)


def test_every_flipped_bit_is_noticed(content):
    """Of every byte each bit, and the whole byte: nothing is decoded, so nothing can crash."""
    for index in range(len(content)):
        for flip in (1, 2, 4, 8, 16, 32, 64, 128, 255):
            damaged = bytearray(content)
            damaged[index] ^= flip
            assert not is_sealed(bytes(damaged), FACTS), (index, flip)


def test_every_cut_and_every_addition_is_noticed(content):
    for length in range(len(content)):
        assert not is_sealed(content[:length], FACTS)
    for more in (b"\0", content, SEAL_MARK, SEAL_MARK + b"0" * 64):
        assert not is_sealed(content + more, FACTS)
        assert not is_sealed(more + content, FACTS)
