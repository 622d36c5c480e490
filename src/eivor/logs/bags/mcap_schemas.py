"""What an MCAP file holds that is not of ROS 2: the names of its schemas, for the sentence that says so."""

from __future__ import annotations

import struct
from pathlib import Path

from eivor.errors import MissingReaderError

#: How messages are described that are read.
ENCODINGS = ("ros2msg", "ros2idl", "omgidl", "")
_MAGIC_BYTES = 8
_SCHEMA = 0x03
#: Most of a summary that is looked at [bytes].
MAX_BYTES = 1 << 24


def check_schemas(file: Path) -> None:
    """Raise for a file none of whose schemas is of ROS 2.

    Raises
    ------
    MissingReaderError
        With the schemas that it has.
    """
    found = _schemas(file)
    if not found or any(encoding in ENCODINGS for _, encoding in found):
        return
    shown = ", ".join(f"{name} ({encoding})" for name, encoding in found[:8]) + (", ..." if found[8:] else "")
    raise MissingReaderError(
        "an MCAP file with messages of ROS 2",
        f"'{file.name}' with {shown}",
        "Convert its topics to CSV with canonical column names (`mcap cat --json` prints them), or give the "
        "vehicle's own log.",
    )


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
    found, place = [], 0
    while place + 9 <= len(summary):
        kind, length = summary[place], struct.unpack_from("<Q", summary, place + 1)[0]
        record = summary[place + 9 : place + 9 + length]
        place += 9 + length
        if kind == _SCHEMA and len(record) > 2:
            name, rest = _text(record[2:])
            found.append((name, _text(rest)[0]))
    return found


def _text(data: bytes) -> tuple[str, bytes]:
    """The text that data begin with, after its length, and what follows."""
    length = int.from_bytes(data[:4], "little")
    return data[4 : 4 + length].decode("utf-8", "replace")[:80], data[4 + length :]
