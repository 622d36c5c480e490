"""Which format a file has, told from its content and never from its name."""

from __future__ import annotations

import codecs
from dataclasses import dataclass

from eivor.errors import MissingReaderError, UnknownFormatError

#: Bytes of a file's start that `sniff_format` wants to see.
HEAD_BYTES = 65536

ULOG_MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"


@dataclass(frozen=True, slots=True)
class KnownFormat:
    """A format that is recognised but not read: its first bytes, its name, and what to do with it."""

    magic: bytes
    label: str
    remedy: str


_UNPACK = "Unpack it and give the log that is inside."
_BAG = "Export the topics to CSV or Parquet with canonical column names (or write a channel map)."

#: Recognised formats without a reader in this release.
UNREAD_FORMATS: tuple[KnownFormat, ...] = (
    KnownFormat(
        b"\xa3\x95",
        "a DataFlash log (ArduPilot .bin, or PX4's old .px4log)",
        "Convert it with `mavlogdump.py --format csv` of pymavlink and write a channel map, or wait for the "
        "`[ardupilot]` extra: its reader is planned, but not in this release.",
    ),
    KnownFormat(b"#ROSBAG", "a ROS 1 bag", f"{_BAG} A `[ros]` extra is planned, but not in this release."),
    KnownFormat(
        b"SQLite format 3\x00",
        "an SQLite database (a ROS 2 bag in .db3 form is one)",
        f"{_BAG} A `[ros]` extra is planned, but not in this release.",
    ),
    KnownFormat(
        b"\x89MCAP0\r\n", "an MCAP file", f"{_BAG} An `[mcap]` extra is planned, but not in this release."
    ),
    KnownFormat(
        b"\xbc",
        "a Crazyflie microSD log",
        "Convert it with `cfusdlog.py` of the Crazyflie firmware, and write a table with canonical names.",
    ),
    KnownFormat(
        b"H Product:Blackbox",
        "a Betaflight or INAV blackbox log",
        "Convert it with `blackbox_decode` to CSV and write a channel map.",
    ),
    KnownFormat(b"ARROW1", "an Arrow IPC file", "Write the table as Parquet or CSV."),
    KnownFormat(b"\x89HDF\r\n\x1a\n", "an HDF5 file", "Write the table as Parquet or CSV."),
    KnownFormat(b"MATLAB 5.0 MAT-file", "a MATLAB file", "Write the table as Parquet or CSV."),
    KnownFormat(b"\x1f\x8b", "a gzip archive", _UNPACK),
    KnownFormat(b"PK\x03\x04", "a zip archive", _UNPACK),
    KnownFormat(b"\x28\xb5\x2f\xfd", "a zstd archive", _UNPACK),
    KnownFormat(b"\xfd7zXZ\x00", "an xz archive", _UNPACK),
    KnownFormat(b"BZh", "a bzip2 archive", _UNPACK),
    KnownFormat(b"7z\xbc\xaf\x27\x1c", "a 7z archive", _UNPACK),
)

DELIMITERS = (",", ";", "\t", "|")
_READABLE = "a ULog, CSV or Parquet log"


def sniff_format(head: bytes, name: str) -> str:
    """Format of the file that begins with `head`: "ulog", "parquet" or "csv".

    Parameters
    ----------
    head : bytes
        The first `HEAD_BYTES` of the file, or all of it.
    name : str
        What to call the file in messages.

    Raises
    ------
    MissingReaderError
        When the format is known and this release does not read it.
    UnknownFormatError
        When the content is that of no known format.
    """
    if head.startswith(ULOG_MAGIC):
        return "ulog"
    if head.startswith(b"PAR1"):
        return "parquet"
    for known in UNREAD_FORMATS:
        if head.startswith(known.magic):
            raise MissingReaderError(_READABLE, f"{known.label}, '{name}'", known.remedy)
    if _looks_like_table(head):
        return "csv"
    raise UnknownFormatError(
        _READABLE,
        f"'{name}', whose content is that of none of them",
        "Check that this is the file you meant; a table needs a line of column names and delimited text.",
    )


def _looks_like_table(head: bytes) -> bool:
    """Say whether the first bytes decode as UTF-8 text whose first line is delimited."""
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        text = decoder.decode(head)
    except UnicodeDecodeError:
        return False
    header = next((line for line in text.splitlines() if line.strip()), "")
    return any(mark in header for mark in DELIMITERS)
