"""Where the command line prints: the report on standard output, messages and progress on standard error."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from eivor.cli.plain_text import plain_text
from eivor.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

#: A step is announced when it takes longer than this [s].
PATIENCE_S = 1.0


def console(*, error: bool = False) -> Console:
    """Console on standard output or error, made when it is needed: width and colours follow the stream."""
    from rich.console import Console

    return Console(stderr=error, highlight=False, markup=False, emoji=False, soft_wrap=False)


def show(report: RenderableType) -> None:
    """Print a report on standard output; in a pipe without the blanks that pad lines to the width.

    Raises
    ------
    InputError
        When the system refuses, for example because the disk is full.
    """
    screen = console()
    with printing(), screen.capture() as captured:  # even a captured print touches the stream
        screen.print(report)
    text = captured.get()
    if not screen.is_terminal:
        text = "".join(f"{line.rstrip()}\n" for line in text.splitlines())
    write(text)


def write(text: str) -> None:
    """Write text on standard output, in letters that it has.

    Raises
    ------
    InputError
        When the system refuses, for example because the disk is full.
    """
    with printing():
        sys.stdout.write(plain_text(text, sys.stdout.encoding or "utf-8"))
        sys.stdout.flush()


@contextmanager
def printing() -> Iterator[None]:
    """Turn the system's error for standard output into one of Eivor's, and print nothing there any more.

    Raises
    ------
    InputError
        When standard output cannot be written to.
    BrokenPipeError
        When nobody reads it any more, which needs no words.
    """
    expected = "a standard output that can be written to"
    if sys.stdout is None:
        raise InputError(expected, "one that is closed", "Print to a file, a pipe or a terminal.")
    try:
        yield
    except BrokenPipeError:
        _drop_standard_output()
        raise
    except OSError as error:
        _drop_standard_output()
        raise InputError(
            expected,
            f"one for which the system says: {error.strerror or error}",
            "Make room there, or print elsewhere.",
        ) from error


def _drop_standard_output() -> None:
    """Point standard output to nowhere, so that the interpreter does not fail again on its way out."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def complain(message: str, *more: str) -> None:
    """Print a message on standard error, with further lines below it; strings are made printable."""
    from eivor.report.printable import printable

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

    from eivor.report.printable import printable

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
