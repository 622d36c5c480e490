"""One run at a time in a folder: a lock that the system releases when its holder ends, however that is."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eivor.errors import InputError

#: File that is locked; it stays, empty.
LOCK = ".lock"


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder for the block."""
    descriptor = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR)
    try:
        try:
            _take(descriptor)
        except BlockingIOError as error:
            raise InputError(
                "a folder that no other run works on",
                f"'{folder}', on which one works now",
                "Wait for it, or choose another folder with -o.",
            ) from error
        yield
    finally:
        os.close(descriptor)


def _take(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError from error
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
