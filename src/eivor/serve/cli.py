"""Command `eivor serve`."""

from __future__ import annotations

import os
import signal
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from time import sleep as pause
from typing import Annotated

from eivor.cli.outputs import WorkersOption, guarded, option, write
from eivor.errors import InputError, UsageError
from eivor.process_pool import Limits
from eivor.serve.app import ServeOptions, Server

#: Ctrl-C, the system's polite end, and a terminal or a console that is closed.
STOPS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
#: How often it is looked whether to stop [s].
LOOK_S = 0.1


@guarded
def serve(
    *,
    port: Annotated[int, option("serve port")] = 0,
    no_browser: Annotated[bool, option("serve no_browser")] = False,
    workers: WorkersOption = None,
    memory: Annotated[float, option("serve memory")] = 4.0,
    time: Annotated[float, option("serve time")] = 600.0,
    largest: Annotated[float, option("serve largest")] = 500.0,
) -> None:
    """Open a page on this machine: drop logs on it, look at verdicts and pictures, take files along."""
    options = _options(port, workers, memory, time, largest)
    with _stop_requests() as stop:
        try:
            server = Server(options)
        except OSError as error:
            received = f"{port}, for which the system says: {error.strerror or error}"
            remedy = "Choose another with --port, or leave it out."
            raise InputError("a port that is free", received, remedy) from error
        try:
            write(f"{server.url}\nDrop flight logs on this page. Ctrl-C stops it.\n")
            if not no_browser:  # in a thread: a browser in the terminal would not come back
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
            while not stop:
                pause(LOOK_S)
        finally:
            server.close()


def _options(port: int, workers: int | None, memory: float, time: float, largest: float) -> ServeOptions:
    if not 0 <= port < 1 << 16:
        raise UsageError("a port of 0 to 65535", str(port), "Leave it out for any that is free.")
    if workers is not None and workers < 1:
        raise UsageError("at least one worker", str(workers), "Leave it out for one for each core.")
    if not 0.0 < largest < 1e6:
        raise UsageError("a size above zero [MB]", f"{largest:g}", "Give 500, for example.")
    return ServeOptions(
        port=port,
        workers=workers or max(2, os.cpu_count() or 1),  # a file is written while a flight is identified
        limits=Limits(time, memory),
        largest=int(largest * 1e6),
    )


@contextmanager
def _stop_requests() -> Iterator[list[int]]:
    """A list that whatever asks to stop adds to, while the block lasts."""
    came: list[int] = []
    known = [getattr(signal, name) for name in STOPS if hasattr(signal, name)]
    signals = [item for item in known if item == signal.SIGINT or signal.getsignal(item) != signal.SIG_IGN]
    before = [signal.signal(item, lambda number, _frame: came.append(number)) for item in signals]
    try:
        yield came
    finally:
        for entry, handler in zip(signals, before, strict=True):
            signal.signal(entry, handler)
