"""The containers of messages: ROS 1 bags, sqlite3 and MCAP, opened by rosbags.

rosbags hands out messages as bytes, with the definitions of their types as text. Neither is given back to
it: it would make program code of the definitions, which are whatever the writer of the bag put there.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from eivor.errors import CorruptLogError, MissingReaderError
from eivor.logs.bags.decompression import Budget, bounded_chunks, zstd_error
from eivor.logs.bags.definitions import type_name
from eivor.logs.bags.files import MAGICS, MCAP, ROS1, SQLITE, ZSTD
from eivor.logs.bags.mcap_schemas import check_schemas
from eivor.whole_file import write_whole

#: What reading of a damaged bag may raise, beside the errors of rosbags and of its decompressors.
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    AssertionError,
    OSError,
    EOFError,
    RuntimeError,
    OverflowError,
    MemoryError,
    struct.error,
    sqlite3.Error,
)
#: Expressions in the definition of a table, which a database would compute.
_COMPUTED = re.compile(r"\bas\s*\(|generated|virtual", re.IGNORECASE)
_REMEDIES = {
    ROS1: "Mend it with `rosbag reindex`, or copy it again.",
    SQLITE: "Copy it again, with the files beside it that end in -wal and -shm, or use `ros2 bag reindex`.",
    MCAP: "Mend it with `mcap recover OLD -o NEW`, or copy it again.",
}


@dataclass(frozen=True, slots=True)
class Connection:
    """One topic of a bag's file.

    Parameters
    ----------
    topic : str
        Its name.
    kind : str
        Type of its messages, "package/Type".
    text : str
        Definition of that type, empty where the bag has none.
    is_idl : bool
        Whether the definition is of the interface definition language, not of `.msg`.
    count : int
        Number of messages, as the bag says.
    handle : Any
        What rosbags calls it.
    """

    topic: str
    kind: str
    text: str
    is_idl: bool
    count: int
    handle: Any


@dataclass(frozen=True, slots=True)
class Container:
    """One open file of a bag.

    Parameters
    ----------
    connections : tuple of Connection
        Its topics.
    ros1 : bool
        Whether messages are written as in ROS 1.
    reader : Any
        rosbags' own.
    budget : Budget
        For messages that are compressed one by one.
    """

    connections: tuple[Connection, ...]
    ros1: bool
    reader: Any
    budget: Budget

    def messages(self, wanted: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Give messages in the order of the record: topic, time of the record [ns], bytes."""
        known = {one.handle.id: one for one in wanted}
        if not known:
            return
        for handle, record_ns, data in self.reader.messages([one.handle for one in wanted]):
            payload = bytes(data)
            if payload.startswith(ZSTD):
                payload = self.budget.zstd(payload)
            yield known[handle.id], int(record_ns), payload


def check_installed() -> None:
    """Raise when rosbags is not there.

    Raises
    ------
    MissingReaderError
        With the command that installs it.
    """
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise MissingReaderError(
            "rosbags, which reads bags and MCAP",
            f"an installation without it ({error})",
            "Install it: pip install 'eivor[ros]'.",
        ) from error


@contextmanager
def opened(file: Path, budget: Budget) -> Iterator[Container]:
    """Open one file of a bag.

    Parameters
    ----------
    file : Path
        Of any of the kinds, told by its content; or one that is compressed as a whole.
    budget : Budget
        How much may be decompressed.

    Raises
    ------
    CorruptLogError
        When it cannot be read, also while the context lasts.
    """
    kind = ""
    damage: tuple[type[Exception], ...] = (*_DAMAGE, *_errors_of_rosbags())
    try:
        with TemporaryDirectory(prefix="eivor-") as folder, bounded_chunks(budget):
            plain = _unpacked(file, Path(folder), budget)
            kind = _kind(plain)
            reader = _reader(plain, kind, budget)
            reader.open()
            try:
                yield Container(_connections(reader), kind == ROS1, reader, budget)
            finally:
                reader.close()
    except damage as error:
        raise _unreadable(file, kind, error) from error


def _errors_of_rosbags() -> tuple[type[Exception], ...]:
    import apsw
    from rosbags.rosbag1 import ReaderError as BagError
    from rosbags.rosbag2 import ReaderError

    return apsw.Error, BagError, ReaderError, zstd_error()


def _unreadable(file: Path, kind: str, error: Exception) -> CorruptLogError:
    said = str(error).replace(str(file.resolve()), file.name)[:200]
    return CorruptLogError(
        "a bag that can be read to its end",
        f"'{file.name}', which cannot ({type(error).__name__}: {said})",
        _REMEDIES.get(kind, "Copy it again."),
    )


def _unpacked(file: Path, folder: Path, budget: Budget) -> Path:
    """The file itself, or what is in it where it is compressed as a whole."""
    with file.open("rb") as stream:
        if stream.read(len(ZSTD)) != ZSTD:
            return file.resolve()
    plain = folder / "unpacked"
    write_whole(plain, budget.zstd(file.read_bytes()))
    return plain


def _kind(file: Path) -> str:
    with file.open("rb") as stream:
        head = stream.read(16)
    for magic, kind in MAGICS.items():
        if head.startswith(magic):
            return kind
    raise ValueError("it begins like no bag")


def _reader(file: Path, kind: str, budget: Budget) -> Any:
    if kind == ROS1:
        return _bag_reader(file, budget)
    if kind == MCAP:
        from rosbags.rosbag2.storage_mcap import McapReader

        check_schemas(file)
        return McapReader(file)
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    _check_database(file)
    # it goes into the address of a database, in which other characters mean something
    return Sqlite3Reader(Path(quote(str(file))))


def _bag_reader(file: Path, budget: Budget) -> Any:
    """Reader of a ROS 1 bag whose chunks become so large and no larger."""
    from bz2 import decompress

    from lz4.frame import decompress as lz4_decompress
    from rosbags.rosbag1 import Reader

    bounded = {decompress: budget.bz2, lz4_decompress: budget.lz4}

    class BoundedReader(Reader):
        def read_chunk(self) -> Any:
            chunk = super().read_chunk()
            return chunk._replace(decompressor=bounded.get(chunk.decompressor, budget.plain))

    return BoundedReader(file)


def _check_database(file: Path) -> None:
    """Raise for a database that would compute anything: a bag has tables of plain columns.

    Raises
    ------
    ValueError
        When it has views, triggers, or columns that are computed.
    """
    database = sqlite3.connect(f"file:{quote(str(file))}?mode=ro&immutable=1", uri=True)
    try:
        rows = database.execute("SELECT type, sql FROM sqlite_master").fetchall()
    finally:
        database.close()
    for kind, text in rows:
        if kind not in {"table", "index"} or _COMPUTED.search(text or ""):
            raise ValueError("a database with more than plain tables")


def _connections(reader: Any) -> tuple[Connection, ...]:
    from rosbags.interfaces import MessageDefinitionFormat

    return tuple(
        Connection(
            one.topic,
            type_name(one.msgtype),
            one.msgdef.data or "",
            one.msgdef.format is MessageDefinitionFormat.IDL,
            int(one.msgcount),
            one,
        )
        for one in reader.connections
    )
