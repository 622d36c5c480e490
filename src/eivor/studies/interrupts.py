"""Interrupts (Ctrl-C) while processes begin: the terminal sends them to every process of a command at once.

A process that is still importing cannot ignore them yet and would print a traceback of its own; a parent that
is interrupted between two steps of beginning one would leave half a child behind.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_INTERRUPT = {signal.SIGINT}


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let an interrupt wait until the block is done; processes that begin in it never see one.

    They inherit a mask that blocks it. Where the system has none (Windows) only this process is protected.
    """
    came: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    held = callable(handler) and threading.current_thread() is threading.main_thread()
    if held:
        signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        with _blocked():
            yield
    finally:
        if held:
            signal.signal(signal.SIGINT, handler)
            if came:
                signal.raise_signal(signal.SIGINT)


@contextmanager
def _blocked() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPT)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
