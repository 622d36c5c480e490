"""The files of a folder and of the folders in it, however many one folder has.

No list of a folder's files is made, and the folders that are still to be looked into are kept on disk.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path

from eivor.fleets.private_database import PrivateDatabase


def files_below(folder: Path, note: Callable[[OSError], None]) -> Generator[tuple[str, str], None, None]:
    """Files, folder after folder: the path of each, and its path from the folder that was given, with ``/``.

    Links to files are files; those to folders are not followed.

    Parameters
    ----------
    folder : Path
        Where to look.
    note : callable
        Takes the system's error for a folder that cannot be looked into.
    """
    waiting = PrivateDatabase("CREATE TABLE folders (number INTEGER PRIMARY KEY, inside BLOB)")
    waiting.execute("INSERT INTO folders (inside) VALUES (?)", (b"",))
    number = 0
    while found := waiting.execute("SELECT * FROM folders WHERE number > ? LIMIT 1", (number,)).fetchone():
        number, inside = found[0], os.fsdecode(found[1])
        place = folder / inside
        try:
            with os.scandir(place) as entries:
                for entry in entries:
                    name = f"{inside}/{entry.name}" if inside else entry.name
                    if _is_folder(entry):
                        if not entry.is_symlink():
                            waiting.execute("INSERT INTO folders (inside) VALUES (?)", (os.fsencode(name),))
                    else:
                        yield str(place / entry.name), name
        except OSError as error:
            note(error)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    """Whether it is a folder or a link to one; what cannot be told is a file."""
    with suppress(OSError):
        return entry.is_dir()
    return False
