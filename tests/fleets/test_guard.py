"""One hostile item takes none of its neighbours along."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import pytest

from eivor.errors import UsageError
from eivor.fleets import begun_process
from eivor.fleets import guard as guard_module
from eivor.fleets.guard import AbandonedError, Guard, LimitError
from eivor.fleets.limits import Limits
from fleets.guarded_answers import answered


@pytest.mark.thorough
def test_items_are_kept_to_their_limits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    guard = Guard(answered, Limits(time_s=0.4, memory_gb=1.0))
    with contextlib.closing(guard):
        first = guard("pid")
        assert guard("a") == "<a>"
        assert guard("pid") == first != os.getpid()
        with pytest.raises(LimitError, match=r"It took longer than 0\.4 s to answer"):
            guard("sleep")
        with pytest.raises(LimitError, match=r"It took more than 1 GB of memory"):
            guard("memory")
        with pytest.raises(LimitError, match=r"died \(exit code 7\)\.$"):
            guard("die")
        with pytest.raises(LimitError, match=r"said last: memory allocation of 9 bytes failed\.$"):
            guard("words")
        with pytest.raises(LimitError, match=r"\(exit code 1\).* last: ZeroDivisionError: of all"):
            guard("mistake")
        assert guard("once") == "<once>"  # the second time, in a process that had no other
        alive = guard("pid")
        os.kill(alive, signal.SIGKILL)
        assert guard("b") == "<b>"
    assert guard.pid is None
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


@pytest.mark.thorough
def test_last_words_are_waited_for(monkeypatch):
    """On a busy machine a process is gone before what it said was read."""
    hear = guard_module._Process._hear

    def late(process, pipe):
        time.sleep(0.5)
        hear(process, pipe)

    monkeypatch.setattr(guard_module._Process, "_hear", late)
    guard = Guard(answered, Limits(time_s=5.0, memory_gb=1.0))
    with (
        contextlib.closing(guard),
        pytest.raises(LimitError, match=r"said last: memory allocation of 9 bytes failed\.$"),
    ):
        guard("words")


def test_an_abandoned_item_is_given_up(monkeypatch):
    monkeypatch.setattr("eivor.fleets.guard.abandoned", lambda: True)
    guard = Guard(answered, Limits())
    with pytest.raises(AbandonedError):
        guard("sleep")
    assert guard.pid is None


def test_a_process_that_may_die_decodes_at_once(tmp_path, monkeypatch):
    """What decoders do to a process is a further one's business, but where this one is there for it."""
    from eivor import expendable
    from eivor.logs.table import child

    begun = []
    monkeypatch.setattr(child.subprocess, "run", lambda *_, **__: begun.append(1) or child.subprocess)
    monkeypatch.setattr(child.subprocess, "returncode", 0, raising=False)
    monkeypatch.setattr(expendable, "_SAID", [])

    def decoded():
        child.decode_in_child(tmp_path / "a", "", {}, max_bytes=1, timeout_s=1.0, kind="a file")
        return len(begun)

    assert decoded() == 1
    expendable.may_die()
    assert decoded() == 1


@pytest.fixture
def begun(monkeypatch):
    """Processes that are begun, with what they load first."""
    begin, found = begun_process._begin, []

    def beginning(*modules):
        found.append((begin(*modules), modules))
        return found[-1][0]

    monkeypatch.setattr(begun_process, "_begin", beginning)
    return found


def test_a_process_that_was_begun_ahead_is_taken(begun):
    with (
        begun_process.begun_ahead("fleets.guarded_answers"),
        contextlib.closing(Guard(answered, Limits())) as guard,
    ):
        assert guard("pid") == begun[0][0].pid
    assert [modules for _, modules in begun] == [("fleets.guarded_answers",)]


def test_a_process_that_nobody_took_is_ended(begun):
    with pytest.raises(ZeroDivisionError), begun_process.begun_ahead("fleets.guarded_answers"):
        raise ZeroDivisionError
    assert begun[0][0].returncode == -signal.SIGKILL
    with contextlib.closing(Guard(answered, Limits())) as guard:
        assert guard("a") == "<a>"
    assert len(begun) == 2


def test_limits_are_above_zero():
    for wrong in ({"time_s": 0.0}, {"memory_gb": float("nan")}):
        with pytest.raises(UsageError, match=r"a limit .* above zero"):
            Limits(**wrong)
