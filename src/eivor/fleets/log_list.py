"""The logs of a fleet, in the order of their names, on disk."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

from eivor.fleets.private_database import PrivateDatabase

#: Logs that are taken from the list in one go.
PAGE_LOGS = 500
#: What is known of a log: see `Log`; `task` and `share` are those of a run, see `eivor.fleets.ledger`.
TABLE = """CREATE TABLE logs (
    name TEXT PRIMARY KEY, path BLOB NOT NULL, told TEXT NOT NULL, sha256 BLOB,
    problem TEXT NOT NULL DEFAULT '', task INTEGER NOT NULL DEFAULT 0, share INTEGER
) WITHOUT ROWID"""
ALL = "SELECT * FROM logs WHERE name > ? ORDER BY name LIMIT ?"


@dataclass(frozen=True, slots=True)
class Log:
    """A log of a fleet.

    Parameters
    ----------
    path : str
        Where it is.
    name : str
        What it is called in the table: its path from the folder that was given, with ``/``.
    told : mapping of str to str
        What the list says of it, by column.
    sha256 : str
        Hash of its bytes; empty until it was hashed, and when it could not be opened.
    problem : str
        Why it could not be opened.
    """

    path: str
    name: str
    told: Mapping[str, str]
    sha256: str = ""
    problem: str = ""


class LogList:
    """Logs, each by its name once: of several with one name the last counts.

    Parameters
    ----------
    logs : iterable of Log
        In any order, not hashed; taken one after the other.
    """

    def __init__(self, logs: Iterable[Log] = ()) -> None:
        self.database = PrivateDatabase(TABLE)
        self.database.executemany(
            "INSERT OR REPLACE INTO logs (name, path, told) VALUES (?, ?, ?)",
            ((log.name, os.fsencode(log.path), json.dumps(dict(log.told))) for log in logs),
        )

    def __len__(self) -> int:
        return self.database.number("SELECT count(*) FROM logs")

    def __iter__(self) -> Iterator[Log]:
        return chain.from_iterable(self.pages(ALL))

    def pages(self, query: str, *given: object, size: int = PAGE_LOGS) -> Iterator[tuple[Log, ...]]:
        """Logs of a query, so many at a time, in the order of their names; they may be changed meanwhile.

        Parameters
        ----------
        query : str
            As `ALL`: what it is given last is the name after which the logs begin, and how many.
        *given : object
            What else it is given, before that.
        size : int
            How many.
        """
        name = ""
        while rows := self.database.execute(query, (*given, name, size)).fetchall():
            yield tuple(map(_log, rows))
            name = rows[-1][0]


def _log(row: tuple[Any, ...]) -> Log:
    name, path, told, sha256, problem, *_ = row
    return Log(os.fsdecode(path), name, json.loads(told), (sha256 or b"").hex(), problem)
