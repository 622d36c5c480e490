"""Logs that come through a pipe: copied into a temporary file, as the readers need to go back in them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from eivor.errors import InputError, LogTooLargeError

#: The path that means standard input, unless there is a file of that name.
STANDARD_INPUT = "-"
#: What reports call a log that has no name.
NAME = "standard input"
_BLOCK_BYTES = 1 << 20


def is_stream(file: Path) -> bool:
    """Say whether a path means standard input, or a pipe that this process was given open (``/dev/fd/63``).

    Other pipes are not read: to open one may wait for ever.
    """
    if str(file) == STANDARD_INPUT:
        return not os.path.lexists(file)
    try:
        status = file.stat()
        descriptor = 0 if str(file) == "/dev/stdin" else int(file.name)
        return not file.is_file() and os.path.samestat(status, os.fstat(descriptor))
    except (OSError, ValueError, OverflowError):
        return False


@contextmanager
def kept(file: Path, max_bytes: int) -> Iterator[Path]:
    """Copy a stream into a file, which is there while the context lasts.

    Parameters
    ----------
    file : Path
        For which `is_stream` holds.
    max_bytes : int
        Most bytes that are read.

    Raises
    ------
    LogTooLargeError
        When there are more.
    InputError
        When there is no stream, or it cannot be copied.
    """
    with TemporaryDirectory(prefix="eivor-") as folder:
        copy = Path(folder) / NAME
        try:
            with _opened(file) as stream, copy.open("wb") as target:
                size = 0
                while block := stream.read(_BLOCK_BYTES):
                    size += len(block)
                    if size > max_bytes:
                        raise LogTooLargeError(
                            f"a log of at most {max_bytes} bytes",
                            f"more from {NAME}",
                            "Cut the log to the manoeuvre of interest, or save it and raise the limit: "
                            "read_log(max_bytes=...).",
                        )
                    target.write(block)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(
                f"a log from {NAME}", f"what cannot be copied: {reason}", "Save it, and give the file."
            ) from error
        yield copy


@contextmanager
def _opened(file: Path) -> Iterator[BinaryIO]:
    if str(file) != STANDARD_INPUT:
        with file.open("rb") as stream:
            yield stream
        return
    if sys.stdin is None or sys.stdin.closed or sys.stdin.isatty():
        raise InputError(
            f"a log from {NAME}", "nothing that is piped into it", f"Write `... | eivor identify {file}`."
        )
    yield sys.stdin.buffer
