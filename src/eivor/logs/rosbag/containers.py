"""Containers of bags: files, compression and schemas."""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from heapq import nsmallest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from eivor.atomic_file import atomic_write
from eivor.errors import CorruptLogError, InputError, MissingReaderError
from eivor.logs.common import DECODER_ERRORS, FolderParts, file_names

# -- Decompression --

#: Largest chunk or message, where recorders write a few MB, and how much is decompressed at once [bytes].
MAX_CHUNK, STEP_BYTES = 100 << 20, 8 << 20
#: A bag becomes by decompression so many times as large, and so much more [bytes], at most.
TIMES, MORE = 64, 64 << 20
#: What a message takes in memory beside its bytes [bytes].
MESSAGE_BYTES = 100


class TooLargeError(ValueError):
    """A bag that becomes too large by decompression."""


@dataclass(slots=True)
class Budget:
    """Remaining bytes that may be decompressed, and memory for messages [bytes]."""

    remaining: int
    memory: int

    @classmethod
    def of(cls, size: int, max_bytes: int) -> Budget:
        memory = max(max_bytes, size)
        return cls(min(TIMES * size + MORE, 8 * memory), memory)

    def charge(self, data: bytes) -> bytes:
        """Subtract decompressed data from the budget, and return them."""
        self.remaining -= len(data)
        if self.remaining < 0:
            raise TooLargeError("it repeats itself far more often than a flight does")
        return data

    def message(self, data: bytes) -> bytes:
        """Return a message that is kept, without the compression that it may have."""
        payload = bytes(data)
        if payload.startswith(ZSTD):
            payload = self.decompressed(payload, _zstd().ZstdDecompressor)
        self.memory -= len(payload) + MESSAGE_BYTES
        if self.memory < 0:
            raise TooLargeError("its messages take more memory than max_bytes")
        return payload

    def steps(self, data: bytes, decompressor: Callable[[], Any]) -> Iterator[bytes]:
        """Give all frames of compressed data, in steps."""
        while data:
            decoder = decompressor()
            while not decoder.eof:
                part = decoder.decompress(data, max_length=STEP_BYTES)
                if not part and decoder.needs_input:
                    raise EOFError("compressed data that end within a frame")
                data = b""
                yield self.charge(part)
            data = decoder.unused_data or b""

    def decompressed(self, data: bytes, decompressor: Callable[[], Any], size: int = MAX_CHUNK) -> bytes:
        """Return all frames of compressed data, of at most so many bytes."""
        parts, size = [], min(size, MAX_CHUNK)
        for part in self.steps(data, decompressor):
            parts.append(part)
            size -= len(part)
            if size < 0:
                raise TooLargeError("a chunk is larger than it says, or than recorders write them")
        return b"".join(parts)


def _zstd() -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


@contextmanager
def bounded_chunks(budget: Budget) -> Iterator[None]:
    """Let rosbags decompress chunks of MCAP within a budget, while the context lasts."""
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag2 import storage_mcap

    table: dict[str, Callable[[bytes, int], bytes]] = storage_mcap.DECOMPRESSORS
    originals = dict(table)
    table[""] = lambda data, _: budget.charge(data)
    table["lz4"] = lambda data, size: budget.decompressed(data, LZ4FrameDecompressor, size)
    table["zstd"] = lambda data, size: budget.decompressed(data, _zstd().ZstdDecompressor, size)
    try:
        yield
    finally:
        table.update(originals)


# -- Files --

ROS1, SQLITE, MCAP = "ros1", "sqlite", "mcap"
MAGICS = {b"#ROSBAG": ROS1, b"SQLite format 3\x00": SQLITE, b"\x89MCAP0\r\n": MCAP}
#: How a file begins that is compressed as a whole.
ZSTD = b"\x28\xb5\x2f\xfd"
ENDINGS = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
#: The file that ROS 2 writes beside them.
METADATA = "metadata.yaml"
_PART = re.compile(r"(.*?)(?:_(\d+))?\.(bag|db3|mcap)(?:\.zstd)?")
#: More parts than any bag has.
MAX_PARTS = 10_000


def bag_parts(folder: Path) -> FolderParts:
    """Return the files of a folder that ROS 2 made: it has metadata, or parts that are called like it."""
    candidates = bag_candidates(folder)
    names = {match[1] for file in candidates if (match := _PART.fullmatch(file.name)) is not None}
    has_metadata = (folder / METADATA).is_file()
    if not candidates or len(names) > 1 or not (has_metadata or names == {folder.resolve().name}):
        return FolderParts()
    metadata = {METADATA} if has_metadata else set()
    return FolderParts(frozenset(metadata.union(file.name for file in candidates)))


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order."""
    if not path.is_dir():
        return [path]
    candidates = bag_candidates(path)
    parts = {file: _PART.fullmatch(file.name) for file in candidates}
    names = {(match[1], match[3]) for match in parts.values() if match is not None}
    if len(names) > 1:
        text = ", ".join(file.name for file in candidates[:4]) + (", ..." if len(candidates) > 4 else "")
        expected = "a folder with the files of one bag"
        received = f"'{path.name}' with those of {len(names)} ({text})"
        raise InputError(expected, received, "Give the file or the folder of one bag.")
    return sorted(candidates, key=lambda file: int((parts[file] or [0, 0, 0])[2] or 0))


def bag_candidates(folder: Path) -> list[Path]:
    """Return the files of a folder that are called like those of bags; none of what is no folder."""
    if not folder.is_dir():
        return []
    names = (name for name in file_names(folder) if name.endswith(ENDINGS))
    return [folder / name for name in nsmallest(MAX_PARTS, names)]


def declared_by_metadata(files: Sequence[Path]) -> Counter[str]:
    """How many messages of each topic the metadata of ROS 2 say that some files have; none of others."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = files[0].parent / METADATA
    try:
        if path.stat().st_size > MAX_BYTES >> 4:
            return Counter()
        content = YAML(typ="safe").load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        if {Path(name).name for name in content["relative_file_paths"]} != {file.name for file in files}:
            return Counter()
        rows = content["topics_with_message_count"]
        return Counter({str(row["topic_metadata"]["name"]): int(row["message_count"]) for row in rows})
    except (*DECODER_ERRORS, YAMLError):
        return Counter()


# -- MCAP schemas --

#: How messages are described that are read.
ENCODINGS = ("ros2msg", "ros2idl", "omgidl", "")
_MAGIC_BYTES = 8
_SCHEMA = 0x03
#: Most of a summary that is looked at [bytes].
MAX_BYTES = 1 << 24


def check_schemas(file: Path) -> None:
    """Raise for a file none of whose schemas is of ROS 2."""
    schemas = _schemas(file)
    if not schemas or any(encoding in ENCODINGS for _, encoding in schemas):
        return
    text = ", ".join(f"{name} ({encoding})" for name, encoding in schemas[:8]) + (
        ", ..." if schemas[8:] else ""
    )
    remedy = (
        "Convert its topics to CSV with canonical column names (`mcap cat --json` prints them), or give the "
        "vehicle's own log."
    )
    raise MissingReaderError("an MCAP file with messages of ROS 2", f"'{file.name}' with {text}", remedy)


def _schemas(file: Path) -> list[tuple[str, str]]:
    """Names and encodings of the schemas in the summary at the file's end."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(max(size - _MAGIC_BYTES - 20, 0))
        start = struct.unpack("<Q", stream.read(8).ljust(8, b"\0"))[0]
        if not _MAGIC_BYTES < start < size:
            return []
        stream.seek(start)
        summary = stream.read(min(size - start, MAX_BYTES))
    results, position = [], 0
    while position + 9 <= len(summary):
        kind, length = summary[position], struct.unpack_from("<Q", summary, position + 1)[0]
        record = summary[position + 9 : position + 9 + length]
        position += 9 + length
        if kind == _SCHEMA and len(record) > 2:
            name, tail = _text(record[2:])
            results.append((name, _text(tail)[0]))
    return results


def _text(data: bytes) -> tuple[str, bytes]:
    """The text that data begin with, after its length, and what follows."""
    length = int.from_bytes(data[:4], "little")
    return data[4 : 4 + length].decode("utf-8", "replace")[:80], data[4 + length :]


# -- Containers --

#: Expressions in the definition of a table, which a database would compute.
_COMPUTED = re.compile(r"\bas\s*\(|generated|virtual", re.IGNORECASE)
_REMEDIES = {
    ROS1: "Mend it with `rosbag reindex`, or copy it again.",
    SQLITE: "Copy it again, with the files beside it that end in -wal and -shm, or use `ros2 bag reindex`.",
    MCAP: "Mend it with `mcap recover OLD -o NEW`, or copy it again.",
}


def declared(reader: Any, *, ros1: bool) -> Counter[str]:
    """How many messages of each topic the indices say that there are."""
    connections, counts = reader.connections, Counter[int]()
    tables = [info.connection_counts for info in getattr(reader, "chunk_infos", ())]
    tables += [chunk.channel_count for chunk in getattr(reader, "chunks", ()) if not ros1]
    for table in tables:
        counts.update(table)
    if statistics := getattr(reader, "statistics", None):
        counts |= Counter(statistics.channel_message_counts)
    counts |= Counter({item.id: item.msgcount for item in connections})
    names = {item.id: item.topic for item in connections}
    total = Counter[str]()
    for number, count in counts.items():
        total[names.get(number, f"a topic without a name (number {number})")] += count
    return total


def check_installed() -> None:
    """Raise when rosbags is not there."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        expected = "rosbags, which reads bags and MCAP"
        received = f"an installation without it ({error})"
        raise MissingReaderError(expected, received, "Install it: pip install 'eivor[ros]'.") from error


@contextmanager
def opened(file: Path, budget: Budget) -> Iterator[tuple[Any, bool]]:
    """Reader of one file of a bag, and whether that is of ROS 1."""
    import apsw
    from rosbags.rosbag1 import ReaderError as BagError
    from rosbags.rosbag2 import ReaderError

    kind = ""
    of_rosbags = (apsw.Error, BagError, ReaderError, _zstd().ZstdError)
    try:
        with TemporaryDirectory(prefix="eivor-") as folder, bounded_chunks(budget):
            unpacked = _unpacked(file, Path(folder), budget)
            with unpacked.open("rb") as stream:
                head = stream.read(16)
            kind = next((name for magic, name in MAGICS.items() if head.startswith(magic)), "")
            if not kind:
                raise ValueError("it begins like no bag")
            reader = _reader(unpacked, kind, budget)
            reader.open()
            try:
                yield reader, kind == ROS1
            finally:
                reader.close()
    except (*DECODER_ERRORS, sqlite3.Error, *of_rosbags) as error:
        raise _unreadable(file, kind, error) from error


def _unreadable(file: Path, kind: str, error: Exception) -> CorruptLogError:
    sentence = str(error).replace(str(file.resolve()), file.name)[:200]
    expected = "a bag that can be read to its end"
    received = f"'{file.name}', which cannot ({type(error).__name__}: {sentence})"
    return CorruptLogError(expected, received, _REMEDIES.get(kind, "Copy it again."))


def _unpacked(file: Path, folder: Path, budget: Budget) -> Path:
    """The file itself, or its decompressed copy where it is compressed as a whole."""
    with file.open("rb") as stream:
        if stream.read(len(ZSTD)) != ZSTD:
            return file.resolve()
    unpacked = folder / "unpacked"
    with atomic_write(unpacked) as stream:
        stream.writelines(budget.steps(file.read_bytes(), _zstd().ZstdDecompressor))
    return unpacked


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
    from lz4.frame import LZ4FrameDecompressor
    from lz4.frame import decompress as lz4_decompress
    from rosbags.rosbag1 import Reader

    decompressors = {bz2.decompress: bz2.BZ2Decompressor, lz4_decompress: LZ4FrameDecompressor}

    class BoundedReader(Reader):
        def read_chunk(self) -> Any:
            chunk = super().read_chunk()
            kind = decompressors.get(chunk.decompressor)
            bounded = budget.charge if kind is None else partial(budget.decompressed, decompressor=kind)
            return chunk._replace(decompressor=bounded)

    return BoundedReader(file)


def _check_database(file: Path) -> None:
    """Raise for a database that would compute anything: a bag has tables of plain columns."""
    database = sqlite3.connect(f"file:{quote(str(file))}?mode=ro&immutable=1", uri=True)
    try:
        rows = database.execute("SELECT type, sql FROM sqlite_master").fetchall()
    finally:
        database.close()
    for kind, text in rows:
        if kind not in {"table", "index"} or _COMPUTED.search(text or ""):
            raise ValueError("a database with more than plain tables")
