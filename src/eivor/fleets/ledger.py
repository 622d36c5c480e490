"""What a run knows of each log, on disk: its hash, whether its row is there, what is to be done with it."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import IntEnum

import polars as pl

from eivor.fleets.log_list import ALL, PAGE_LOGS, Log, LogList
from eivor.fleets.table import COPY, FAILED

#: Parts of the table that logs which cannot be opened are spread over, by their names.
SHARES = 64

_TABLES = (
    "CREATE TABLE rows (sha256 BLOB, name TEXT, verdict TEXT)",
    "CREATE TABLE firsts (sha256 BLOB PRIMARY KEY, name TEXT, is_there INTEGER) WITHOUT ROWID",
    "CREATE TABLE reports (sha256 BLOB PRIMARY KEY) WITHOUT ROWID",
    "CREATE INDEX unopened ON logs (share, name) WHERE share IS NOT NULL",
)
_BEGIN_ANEW = (
    "DROP TABLE IF EXISTS rows",
    "DROP TABLE IF EXISTS firsts",
    "DROP TABLE IF EXISTS reports",
    "DROP INDEX IF EXISTS unopened",
    "UPDATE logs SET sha256 = NULL, problem = '', task = 0, share = NULL",
)
#: The log whose row has the numbers of a hash: that which is there, else the first of the given ones by name.
_FIRSTS_THERE = """INSERT OR REPLACE INTO firsts SELECT sha256, name, 1 FROM rows
    WHERE verdict <> ? AND sha256 IS NOT NULL ORDER BY sha256, rowid"""
_FIRSTS_GIVEN = """INSERT OR IGNORE INTO firsts SELECT sha256, min(name), 0 FROM logs
    WHERE sha256 IS NOT NULL GROUP BY sha256"""
_SETTLE = """UPDATE logs SET task = CASE
    WHEN (SELECT is_there = 0 AND firsts.name = logs.name FROM firsts
        WHERE firsts.sha256 = logs.sha256) THEN ?
    WHEN (SELECT firsts.name <> logs.name FROM firsts WHERE firsts.sha256 = logs.sha256)
        AND NOT EXISTS (SELECT 1 FROM rows WHERE rows.sha256 = logs.sha256 AND rows.name = logs.name) THEN ?
    ELSE 0 END"""
_SETTLE_REPORTS = """UPDATE logs SET task = CASE
    WHEN sha256 NOT IN reports AND EXISTS (SELECT 1 FROM rows
        WHERE rows.sha256 = logs.sha256 AND rows.name = logs.name AND rows.verdict NOT IN (?, ?)) THEN ?
    ELSE 0 END"""
_OF_TASK = "SELECT * FROM logs WHERE task = ? AND name > ? ORDER BY name LIMIT ?"
_OF_SHARE = "SELECT * FROM logs WHERE share = ? AND name > ? ORDER BY name LIMIT ?"


class Task(IntEnum):
    """What is to be done with a log."""

    NOTHING = 0
    IDENTIFY = 1
    TELL_COPY = 2
    REPORT = 3


class Ledger:
    """The state of a run over a list of logs."""

    def __init__(self, logs: LogList) -> None:
        self._logs, self._database = logs, logs.database
        for statement in (*_BEGIN_ANEW, *_TABLES):
            self._database.execute(statement)

    def logs(self) -> Iterator[tuple[Log, ...]]:
        """All logs, `PAGE_LOGS` at a time, in the order of their names."""
        return self._logs.pages(ALL)

    def note(self, logs: Sequence[Log]) -> None:
        """Keep the hashes of logs, or why they cannot be opened."""
        self._database.executemany(
            "UPDATE logs SET sha256 = ?, problem = ?, share = ? WHERE name = ?",
            [
                (_bytes(log.sha256), log.problem, None if log.sha256 else share_of(log.name), log.name)
                for log in logs
            ],
        )

    def take_rows(self, parts: Iterable[pl.DataFrame]) -> None:
        """Keep which rows are there, in place of what was known of them."""
        self._database.execute("DROP INDEX IF EXISTS row_keys")
        self._database.execute("DELETE FROM rows")
        for part in parts:
            rows = part.select("sha256", "name", "verdict").iter_rows()
            self._database.executemany(
                "INSERT INTO rows VALUES (?, ?, ?)", ((_bytes(sha256), *more) for sha256, *more in rows)
            )
        self._database.execute("CREATE INDEX row_keys ON rows (sha256, name)")

    def settle(self) -> None:
        """Say of each log that was opened whether to identify it, or to tell that it is a copy."""
        self._database.execute(_FIRSTS_THERE, (COPY,))
        self._database.execute(_FIRSTS_GIVEN)
        self._database.execute(_SETTLE, (Task.IDENTIFY, Task.TELL_COPY))

    def settle_reports(self, there: Iterable[str]) -> None:
        """Say of each log whether it has a result and wants its report."""
        self._database.executemany(
            "INSERT OR IGNORE INTO reports VALUES (?)", ((_bytes(one),) for one in there)
        )
        self._database.execute(_SETTLE_REPORTS, (COPY, FAILED, Task.REPORT))

    def of_task(self, task: Task, size: int = PAGE_LOGS) -> Iterator[tuple[Log, ...]]:
        """Logs with which something is to be done, so many at a time, in the order of their names."""
        return self._logs.pages(_OF_TASK, task, size=size)

    def count(self, task: Task) -> int:
        """How many logs these are."""
        return self._database.number("SELECT count(*) FROM logs WHERE task = ?", task)

    def opened(self) -> int:
        """How many logs could be opened."""
        return self._database.number("SELECT count(*) FROM logs WHERE sha256 IS NOT NULL")

    def first(self, log: Log) -> str:
        """Name of the log whose row has the numbers of a log that was opened."""
        query = "SELECT name FROM firsts WHERE sha256 = ?"
        (name,) = self._database.execute(query, (_bytes(log.sha256),)).fetchone()
        return str(name)

    def unopened(self, share: int) -> Iterator[Log]:
        """Logs of a share, see `share_of`, that cannot be opened."""
        for page in self._logs.pages(_OF_SHARE, share):
            yield from page

    def has(self, name: str) -> bool:
        """Whether a log of this name is in the list."""
        return self._database.number("SELECT count(*) FROM logs WHERE name = ?", name) > 0

    def rows(self) -> int:
        """How many rows are there."""
        return self._database.number("SELECT count(*) FROM rows")

    def verdicts(self) -> Mapping[str, int]:
        """How many of the rows that are there, of these logs, have which verdict."""
        query = "SELECT verdict, count(*) FROM rows JOIN logs USING (sha256, name) GROUP BY verdict"
        return dict(self._database.execute(query).fetchall())


def share_of(name: str) -> int:
    """Which part of the table has the row of a log that cannot be opened: the same in every run."""
    return zlib.crc32(name.encode("utf-8")) % SHARES


def _bytes(sha256: str | None) -> bytes | None:
    return bytes.fromhex(sha256) if sha256 else None
