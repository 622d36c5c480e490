"""Tables of a run that are kept on disk: what is known of each log takes no memory, however many there are.

The file is of this process alone: it has no name once it is open, and goes when the process ends, whatever
ends it. It lies where the system keeps temporary files; the variable TMPDIR names another folder.
"""

from __future__ import annotations

import sqlite3
import weakref
from collections.abc import Iterator
from contextlib import contextmanager

from eivor.errors import InputError

#: Memory that a database keeps pages in [KiB], negative as SQLite wants it.
CACHE = "PRAGMA cache_size = -8192"


class PrivateDatabase:
    """A database with these tables; not to be used by a process that was forked from the one that made it.

    Parameters
    ----------
    *tables : str
        Statements that make them.
    """

    def __init__(self, *tables: str) -> None:
        # a log's list may be made by one thread and dropped by another, never used by two at a time
        connection = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        self.execute = connection.execute
        self.executemany = connection.executemany
        for statement in ("PRAGMA temp_store = FILE", "PRAGMA journal_mode = OFF", CACHE, "BEGIN", *tables):
            connection.execute(statement)
        weakref.finalize(self, connection.close)

    def number(self, query: str, *given: object) -> int:
        """The one number that a query tells."""
        (found,) = self.execute(query, given).fetchone()
        return int(found)


@contextmanager
def database_errors_told() -> Iterator[None]:
    """Turn what the database says where it finds no room into an error of Eivor's.

    Raises
    ------
    InputError
        When there is no room, or no folder, for temporary files.
    """
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(
            "room for the list of the logs, some 500 bytes each, where temporary files are kept",
            f"what the database says: {error}",
            "Make room there, or name another folder: TMPDIR=FOLDER. Rows that were written are kept.",
        ) from error
