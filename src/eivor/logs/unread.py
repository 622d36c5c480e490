"""Formats that are recognised but not read: each says what to do with such a file."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import Never

from eivor.errors import MissingReaderError, UnknownFormatError
from eivor.logs.log_format import LogFormat, ReadOptions, begins_with
from eivor.logs.table.formats import is_delimited


def _recognised(name: str, label: str, magic: bytes, remedy: str) -> LogFormat:
    """Row of a format without a reader: how its files begin, and what to do with one."""

    def refuse(file: Path, _options: ReadOptions) -> Never:
        raise MissingReaderError("a log that this release reads", f"{label}, '{file.name}'", remedy)

    return LogFormat(name, label, begins_with(magic), refuse, is_read=False)


_UNPACK = "Unpack it and give the log that is inside."
_TABLE = "Write the table as Parquet or CSV."

#: First bytes of MAVLink messages, 1 and 2, and how much longer than its content one is [bytes].
_MAVLINK_2 = 0xFD
_MAVLINK = {0xFE: 8, _MAVLINK_2: 12}
#: Stamps of telemetry: from 2001 to 2096 [us].
_STAMPS_US = (10**15, 4 * 10**15)
#: Versions of DJI's records, and how long the details at their end are [bytes].
_DJI_VERSIONS = 20
_DJI_DETAILS = (200, 2000)

#: Recognised formats without a reader in this release.
RECOGNISED: tuple[LogFormat, ...] = (
    _recognised(
        "blackbox",
        "a Betaflight or INAV blackbox log",
        b"H Product:Blackbox",
        "Convert it with `blackbox_decode` to CSV, for which maps are shipped (betaflight_csv, inav_csv).",
    ),
    _recognised("arrow", "an Arrow IPC file", b"ARROW1", _TABLE),
    _recognised("gzip", "a gzip archive", b"\x1f\x8b", _UNPACK),
    _recognised("zip", "a zip archive", b"PK\x03\x04", _UNPACK),
    _recognised("zstd", "a zstd archive", b"\x28\xb5\x2f\xfd", _UNPACK),
    _recognised("xz", "an xz archive", b"\xfd7zXZ\x00", _UNPACK),
    _recognised("bzip2", "a bzip2 archive", b"BZh", _UNPACK),
    _recognised("7z", "a 7z archive", b"7z\xbc\xaf\x27\x1c", _UNPACK),
)


def _is_telemetry(head: bytes, _file: Path) -> bool:
    """Whether it is a telemetry log: a stamp [us] before each MAVLink message, at least three of them."""
    place = found = 0
    while place + 11 <= len(head):
        stamp = int.from_bytes(head[place : place + 8], "big")
        first, length = head[place + 8], head[place + 9]
        if not _STAMPS_US[0] < stamp < _STAMPS_US[1] or first not in _MAVLINK:
            break
        signed = 13 * (first == _MAVLINK_2 and head[place + 10] & 1)
        place += 8 + length + _MAVLINK[first] + signed
        found += 1
    return found >= 3


def _is_dji(head: bytes, file: Path) -> bool:
    """Whether it is a record of DJI: of the vehicle (DAT), or of the remote control's application (text)."""
    if head[16:21] == b"BUILD" or b"DJI_LOG_V3" in head[:512]:
        return True
    end, details = int.from_bytes(head[:8], "little"), int.from_bytes(head[8:10], "little")
    if len(head) < 100 or not 0 < head[10] <= _DJI_VERSIONS:
        return False
    return _DJI_DETAILS[0] <= details <= _DJI_DETAILS[1] and 100 < end <= file.stat().st_size - details


def _refuse_telemetry(file: Path, _options: ReadOptions) -> Never:
    raise MissingReaderError(
        "a log of the vehicle",
        f"'{file.name}', a telemetry log (.tlog), which holds a few messages a second",
        "That is too slow for the lag of motors and for friction. Give the log from the vehicle's card: .bin "
        "of ArduPilot, .ulg of PX4.",
    )


def _refuse_dji(file: Path, _options: ReadOptions) -> Never:
    raise MissingReaderError(
        "a log with the commands of the motors",
        f"'{file.name}', a flight record of DJI",
        "They hold ten samples a second and no commands or setpoints, newer ones in a cipher: nothing can be "
        "identified from them.",
    )


#: Formats of others that are told by more than their first bytes.
TELEMETRY = LogFormat("tlog", "a telemetry log", _is_telemetry, _refuse_telemetry, is_read=False)
DJI = LogFormat("dji", "a flight record of DJI", _is_dji, _refuse_dji, is_read=False)

_CONTROLS = frozenset(range(32)) - frozenset(b"\t\n\r\f")


def _is_utf16(head: bytes, _file: Path) -> bool:
    """Whether it is delimited text with a mark of UTF-16, or with zeros for every second byte."""
    for codec, mark, zeros in (
        ("utf-16-le", codecs.BOM_UTF16_LE, head[1:100:2]),
        ("utf-16-be", codecs.BOM_UTF16_BE, head[0:100:2]),
    ):
        if head.startswith(mark) or (len(zeros) > 1 and not any(zeros)):
            text = codecs.getincrementaldecoder(codec)("replace").decode(head)
            return is_delimited(text) and "\x00" not in text
    return False


def _is_eight_bit(head: bytes, _file: Path) -> bool:
    """Whether it is delimited text without control characters; asked after UTF-8."""
    return not _CONTROLS.intersection(head) and is_delimited(head.decode("latin-1"))


def _refuse_utf16(file: Path, _options: ReadOptions) -> Never:
    raise _other_encoding(file, "in UTF-16", "UTF-16")


def _refuse_eight_bit(file: Path, _options: ReadOptions) -> Never:
    letters = "with letters that are not UTF-8 (a degree sign of Latin-1 or Windows-1252?)"
    raise _other_encoding(file, letters, "WINDOWS-1252")


def _other_encoding(file: Path, received: str, codec: str) -> UnknownFormatError:
    """Error for a table that would be unreadable or, worse, misread."""
    return UnknownFormatError(
        "a table in UTF-8",
        f"'{file.name}', a table {received}",
        f"Save it as UTF-8, as `iconv -f {codec} -t UTF-8 OLD > NEW` does.",
    )


UTF_16 = LogFormat("utf-16", "a table in UTF-16", _is_utf16, _refuse_utf16, is_read=False)
EIGHT_BIT = LogFormat(
    "8-bit", "a table in an 8-bit encoding", _is_eight_bit, _refuse_eight_bit, is_read=False
)
