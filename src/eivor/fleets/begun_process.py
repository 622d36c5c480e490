"""The processes of `eivor.fleets.guard`: begun when one is wanted, or ahead of that.

What such a process loads takes it a second. Where it is known early that one will be wanted, it loads while
who wants it loads things, too.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO, cast

#: One thread of linear algebra and of tables, as everywhere where logs are identified beside each other.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS"), "1"
)
#: Those that nobody has taken yet.
_AHEAD: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()


def begun_process() -> subprocess.Popen[bytes]:
    """A process that waits for its function and items: one that was begun ahead where there is one."""
    with suppress(queue.Empty):
        return _AHEAD.get_nowait()
    return _begin()


@contextmanager
def begun_ahead(module: str) -> Iterator[None]:
    """Have a process ready for the first who wants one; it is ended when nobody has taken it in this context.

    Parameters
    ----------
    module : str
        What it loads meanwhile.
    """
    _AHEAD.put(_begin(module))
    try:
        yield
    finally:
        with suppress(queue.Empty), _AHEAD.get_nowait() as not_taken:
            end(not_taken)


def send(process: subprocess.Popen[bytes], item: Any) -> None:
    """Give a process what it takes next: modules to load, its function with its memory, then items."""
    pipe = cast("BinaryIO", process.stdin)
    with suppress(OSError):  # that it died is told where its answer is missed
        pickle.dump(item, pipe)
        pipe.flush()


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process and what it has begun, whatever they do."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)  # it leads a group of its own
    process.kill()
    process.wait()


def _begin(*modules: str) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-m", "eivor.fleets.guarded_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,  # an interrupt is the business of who waits for it
    )
    send(process, modules)
    return process
