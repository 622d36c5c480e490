"""The process in which `eivor.fleets.guard` calls its function: items come in by a pipe, results go out.

Run as a program. It ends when its pipe is closed, also in the middle of an item: whoever waited is gone.
"""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from eivor.expendable import may_die
from eivor.fleets.telling import Telling

#: Bytes of a GB.
GB = 10**9


def serve(items: BinaryIO, results: BinaryIO) -> None:
    """Load modules, take the function and its items, and give the results, until there are no more."""
    for module in pickle.load(items):  # noqa: S301 - who began this process wrote it
        import_module(module)
    function, memory_gb = pickle.load(items)  # noqa: S301 - as above
    _one_thread()
    limit_memory(memory_gb)
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_take, args=(items, waiting), daemon=True).start()
    _give(results, ("begun", None))
    while True:
        _give(results, _answer(function, waiting.get(), results))


def _answer(function: Callable[[Any], Any] | Telling, item: Any, results: BinaryIO) -> tuple[str, Any]:
    try:
        if isinstance(function, Telling):
            return "result", function(item, lambda told: _give(results, ("told", told)))
        return "result", function(item)
    except MemoryError:
        return "memory", None


def _give(results: BinaryIO, answer: tuple[str, Any]) -> None:
    pickle.dump(answer, results)
    results.flush()


def _take(items: BinaryIO, waiting: queue.SimpleQueue[Any]) -> None:
    try:
        while True:
            waiting.put(pickle.load(items))  # noqa: S301 - as above
    except (EOFError, OSError):
        os._exit(0)


def _one_thread() -> None:
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)


def limit_memory(memory_gb: float) -> None:
    """Refuse this process more memory than so much beyond what it has; where the system can (not Windows).

    Parameters
    ----------
    memory_gb : float
        Address space [GB].
    """
    if sys.platform == "win32":
        return
    import resource

    try:
        held = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    except OSError:
        held = 0
    most = held + int(memory_gb * GB)
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def main() -> None:
    """Serve by what is standard input and output now; what others print goes to standard error."""
    may_die()
    items, results = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(items, results)


if __name__ == "__main__":
    main()
