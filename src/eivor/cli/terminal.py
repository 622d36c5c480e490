"""Where the command line prints: the report on standard output, messages and progress on standard error."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

#: A step is announced when it takes longer than this [s].
PATIENCE_S = 1.0


def console(*, error: bool = False) -> Console:
    """Console on standard output or error, made when it is needed: width and colours follow the stream."""
    from rich.console import Console

    return Console(stderr=error, highlight=False, markup=False, emoji=False, soft_wrap=False)


def show(report: RenderableType) -> None:
    """Print a report on standard output; in a pipe without the blanks that pad lines to the width."""
    screen = console()
    if screen.is_terminal:
        screen.print(report)
        sys.stdout.flush()
        return
    with screen.capture() as captured:
        screen.print(report)
    write("".join(f"{line.rstrip()}\n" for line in captured.get().splitlines()))


def write(text: str) -> None:
    """Write text on standard output as it is."""
    sys.stdout.write(text)
    sys.stdout.flush()


def complain(message: str, *more: str) -> None:
    """Print a message on standard error, with further lines below it; strings are made printable."""
    from eivor.report.wording import printable

    lines = [f"eivor: {printable(message)}", *(f"  {printable(line)}" for line in more)]
    with suppress(OSError, ValueError):
        sys.stderr.write("\n".join(lines) + "\n")
        sys.stderr.flush()


@contextmanager
def step(what: str) -> Iterator[None]:
    """Show `what` with a spinner on standard error while it lasts over a second, on terminals only."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.text import Text

    from eivor.report.wording import printable

    status = console(error=True).status(Text(f"{printable(what)} ..."))
    timer = threading.Timer(PATIENCE_S, status.start)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        status.stop()
