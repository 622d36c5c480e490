"""Logs that were dropped: on the disk under names of the server's own, until they are an hour old.

A log that is a folder of files is a folder here, too, and its files keep their names, made plain.
"""

from __future__ import annotations

import secrets
import shutil
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from eivor.serve.refusals import RefusedError, absent
from eivor.serve.tasks import KeptLog
from eivor.whole_file import whole_file

#: Letters of a name that are shown.
LONGEST_NAME = 255
#: So many logs of the largest size are kept at once.
LARGEST_KEPT = 4
#: What is left free on the disk [bytes].
LEFT_FREE = 200_000_000
#: Endings that files keep; their content says what they are.
LONGEST_ENDING = 12


@dataclass(slots=True)
class _Entry:
    log: KeptLog
    used_at: float


class KeptLogs:
    """The logs of a run."""

    def __init__(self, folder: Path, largest: int, clock: Callable[[], float]) -> None:
        self._folder, self._largest, self._clock = folder, largest, clock
        self._entries: dict[str, _Entry] = {}
        self._coming = 0
        self._lock = threading.Lock()
        folder.mkdir(mode=0o700)

    def keep(
        self,
        name: str,
        size: int,
        files: Iterable[tuple[str, Iterator[bytes]]],
        in_use: Callable[[], Collection[str]],
    ) -> str:
        """Keep a log; its identifier."""
        self._make_room(size, in_use())
        try:
            log = secrets.token_hex(16)
            path = self._folder / f"{log}{_ending(name)}"
            _write(path, files)
            with self._lock:
                self._entries[log] = _Entry(KeptLog(path, name, size), self._clock())
        finally:
            with self._lock:
                self._coming -= size
        return log

    def _make_room(self, size: int, in_use: Collection[str]) -> None:
        """Forget the oldest logs that nobody works on, until another one has room."""
        with self._lock:
            most = LARGEST_KEPT * self._largest
            free = shutil.disk_usage(self._folder).free - LEFT_FREE - self._coming
            oldest = sorted(set(self._entries) - set(in_use), key=lambda one: self._entries[one].used_at)
            kept = sum(one.log.size for one in self._entries.values()) + self._coming
            while (kept + size > most or size > free) and oldest:
                gone = self._forget(oldest.pop(0))
                kept, free = kept - gone, free + gone
            if kept + size > most or size > free:
                raise RefusedError(
                    HTTPStatus.INSUFFICIENT_STORAGE,
                    f"room for {size} bytes more",
                    "none",
                    "Wait until flights are identified, or make room on the disk.",
                )
            self._coming += size

    def get(self, log: str) -> KeptLog:
        """Log of an identifier, which is used now."""
        with self._lock:
            entry = self._entries.get(log)
            if entry is None:
                raise absent("a log", log)
            entry.used_at = self._clock()
            return entry.log

    def forget(self, log: str) -> None:
        """Delete a log."""
        with self._lock:
            if log not in self._entries:
                raise absent("a log", log)
            self._forget(log)

    def forget_older(self, age_s: float, in_use: Collection[str]) -> None:
        """Delete the logs that nobody has used for so long, or works on."""
        with self._lock:
            oldest = self._clock() - age_s
            for log in [one for one, entry in self._entries.items() if entry.used_at < oldest]:
                if log not in in_use:
                    self._forget(log)

    def _forget(self, log: str) -> int:
        entry = self._entries.pop(log)
        _delete(entry.log.path)
        return entry.log.size


def _write(path: Path, files: Iterable[tuple[str, Iterator[bytes]]]) -> None:
    """Write a log, all of it or nothing."""
    try:
        for name, chunks in files:
            if name:
                path.mkdir(mode=0o700, exist_ok=True)
            with whole_file(path / name if name else path) as file:
                for chunk in chunks:
                    file.write(chunk)
    except BaseException:
        _delete(path)
        raise


def _delete(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def shown_name(header: str) -> str:
    """Name of a log out of its header: percent-encoded, without folders."""
    name = unquote(header, errors="replace").replace("\\", "/").rpartition("/")[2]
    name = name.replace("\0", "").strip()[:LONGEST_NAME]
    return name or "log"


def _ending(name: str) -> str:
    ending = PurePosixPath(name).suffix.lower()
    plain = ending[1:].isascii() and ending[1:].isalnum()
    return ending if plain and len(ending) <= LONGEST_ENDING else ""
