"""Ctrl-C while processes begin."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from eivor.studies.interrupts import interrupts_wait

INTERRUPTED = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises, also where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_waits_until_the_block_is_done():
    reached = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - where it is raised is the point
        with interrupts_wait():
            signal.raise_signal(signal.SIGINT)
            reached.append("end of the block")
        reached.append("beyond it")
    assert reached == ["end of the block"]


def test_everything_is_as_before():
    handler = signal.getsignal(signal.SIGINT)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with pytest.raises(ZeroDivisionError), interrupts_wait():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is handler
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == mask


def test_a_process_that_begins_meanwhile_sees_none():
    with interrupts_wait():
        run = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, check=False)
    assert (run.stdout, run.stderr, run.returncode) == (b"alive\n", b"", 0)


def test_in_another_thread_processes_are_protected_too():
    found = []

    def begin() -> None:
        with interrupts_wait():
            found.append(subprocess.run([sys.executable, "-c", INTERRUPTED], check=False).returncode)

    thread = threading.Thread(target=begin)
    thread.start()
    thread.join()
    assert found == [0]


def test_an_interrupt_that_is_ignored_stays_so():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_wait():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
