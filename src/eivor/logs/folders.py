"""Logs that are folders of files: their size and their hash."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from heapq import nsmallest
from pathlib import Path

#: More files than a folder of one log has; the others do not count.
MAX_FILES = 10_000


def file_names(folder: Path) -> Iterator[str]:
    """Names of the regular files of a folder, in any order, one after the other: it may have very many.

    Raises
    ------
    OSError
        When the folder cannot be looked into.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_file():
                yield entry.name


def folder_files(folder: Path) -> list[Path]:
    """Return the regular files of a folder, by their names; those of folders in it are not looked at."""
    return [folder / name for name in nsmallest(MAX_FILES, file_names(folder))]


def folder_size(folder: Path) -> int:
    """Return the size of all its files [bytes]."""
    return sum(file.stat().st_size for file in folder_files(folder))


def folder_sha256(folder: Path) -> str:
    """Return a hash of the names and of the hashes of its files, hexadecimal."""
    whole = hashlib.sha256()
    for file in folder_files(folder):
        with file.open("rb") as stream:
            whole.update(f"{file.name}\0{hashlib.file_digest(stream, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()
