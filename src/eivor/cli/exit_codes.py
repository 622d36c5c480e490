"""Exit codes, and how errors become them: one message, no traceback."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from enum import IntEnum
from typing import ParamSpec

import typer

from eivor.cli.terminal import complain
from eivor.errors import EivorError, UsageError

P = ParamSpec("P")

#: Set to 1 to see the traceback of an unexpected error.
DEBUG_VARIABLE = "EIVOR_DEBUG"


class ExitCode(IntEnum):
    """What a command tells the shell."""

    IDENTIFIED = 0
    FAILED = 1
    USAGE = 2
    NOT_IDENTIFIED = 3
    INTERRUPTED = 130


def guarded(command: Callable[P, ExitCode]) -> Callable[P, None]:
    """Make a command that returns an exit code into one that leaves with it, whatever happens inside."""

    @functools.wraps(command)
    def leaving(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(code=int(_outcome(command, *args, **kwargs)))

    return leaving


def _outcome(command: Callable[P, ExitCode], *args: P.args, **kwargs: P.kwargs) -> ExitCode:
    try:
        return command(*args, **kwargs)
    except EivorError as error:
        return reported(error)
    except KeyboardInterrupt:
        complain("interrupted")
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        return ExitCode.FAILED
    except MemoryError:
        complain("Not enough memory for this log.", "Cut it to the manoeuvre of interest, or use --window.")
        return ExitCode.FAILED
    except Exception as error:  # the last line of defence: a user never sees a traceback
        if os.environ.get(DEBUG_VARIABLE) == "1":
            raise
        complain(
            f"unexpected {type(error).__name__}: {error}",
            "This is a mistake in Eivor. Please report it with the command and, if you can, the log;",
            f"{DEBUG_VARIABLE}=1 shows where it happened.",
        )
        return ExitCode.FAILED


def reported(error: EivorError) -> ExitCode:
    """Print the message of an error, and return its exit code."""
    complain(str(error))
    return ExitCode.USAGE if isinstance(error, UsageError) else ExitCode.FAILED
