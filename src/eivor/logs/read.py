"""Reading of a log in any format, here or at an address, and the example flight."""

from __future__ import annotations

import codecs
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path
from pkgutil import resolve_name
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import Any, Never, cast
from urllib.parse import urlsplit

from eivor import checks
from eivor.errors import (
    EmptyLogError,
    InputError,
    LogTooLargeError,
    MissingReaderError,
    UnknownFormatError,
    UsageError,
)
from eivor.logs import common
from eivor.logs.table.delimited import is_delimited
from eivor.signals.recording import Recording

_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]*)://")


def is_address(text: str) -> bool:
    """Whether a text is an address of another file system, such as s3://bucket/logs."""
    return _ADDRESS.match(text) is not None and not text.startswith("file://")


def is_local(path: object) -> bool:
    """Whether what `path_of` gave is a path of this machine."""
    return isinstance(path, Path)


def path_of(text: str) -> Path:
    """Path of a text; of an address one that does the same as far as logs and fleets need it."""
    if text.startswith("file://"):
        from urllib.request import url2pathname  # with encryption and protocols, which few logs need

        return Path(url2pathname(urlsplit(text).path))
    if not is_address(text):
        return Path(text)
    scheme = text.partition("://")[0]
    try:
        import upath

        remote = upath.UPath(text, use_listings_cache=False)
        remote.fs  # noqa: B018 - loads what the scheme needs
    except ImportError as error:
        expected = f"the packages for addresses {scheme}://"
        remedy = "Install them: pip install 'eivor[cloud]'."
        raise UsageError(expected, f"an installation without them ({error})", remedy) from error
    except ValueError as error:
        remedy = "Give a path, or an address such as s3://bucket/logs or gs://bucket/logs."
        raise UsageError("a scheme that fsspec knows", f"'{text}'", remedy) from error
    return cast("Path", remote)


@contextmanager
def here(path: str) -> Iterator[Path]:
    """A log as a local file, which is fetched when it is elsewhere."""
    if not is_address(path):
        yield Path(path)
        return
    with TemporaryDirectory(prefix="eivor-") as folder:
        local = Path(folder) / path.rpartition("/")[2]
        remote = path_of(path)
        try:
            with remote.open("rb") as source, local.open("wb") as target:
                copyfileobj(source, target)
        except Exception as error:
            received = f"'{path}', for which {type(error).__name__} says: {error}"
            remedy = "Check the address, and the credentials of this machine."
            raise InputError("an address that can be read", received, remedy) from error
        yield local


# -- Logs that cannot be read --

#: First bytes of MAVLink messages, 1 and 2, and how much longer than its content one is [bytes].
_MAVLINK_2 = 0xFD
_MAVLINK = {0xFE: 8, _MAVLINK_2: 12}
#: Stamps of telemetry: from 2001 to 2096 [us].
_STAMPS_US = (10**15, 4 * 10**15)
#: Versions of DJI's records, and how long the details at their end are [bytes].
_DJI_VERSIONS = 20
_DJI_DETAILS = (200, 2000)


def _is_telemetry(head: bytes, _file: Path) -> bool:
    """Whether it is a telemetry log: a stamp [us] before each MAVLink message, at least three of them."""
    position = result = 0
    while position + 11 <= len(head):
        stamp = int.from_bytes(head[position : position + 8], "big")
        first, length = head[position + 8], head[position + 9]
        if not _STAMPS_US[0] < stamp < _STAMPS_US[1] or first not in _MAVLINK:
            break
        signed = first == _MAVLINK_2 and head[position + 10] & 1
        position += 8 + length + _MAVLINK[first] + 13 * signed
        result += 1
    return result >= 3


def _is_dji(head: bytes, file: Path) -> bool:
    """Whether it is a record of DJI: of the vehicle (DAT), or of the remote control's application (text)."""
    if head[16:21] == b"BUILD" or b"DJI_LOG_V3" in head[:512]:
        return True
    end, details = int.from_bytes(head[:8], "little"), int.from_bytes(head[8:10], "little")
    if len(head) < 100 or not 0 < head[10] <= _DJI_VERSIONS:
        return False
    return _DJI_DETAILS[0] <= details <= _DJI_DETAILS[1] and 100 < end <= file.stat().st_size - details


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


_SNIFFS: Mapping[str, Callable[[bytes, Path], bool]] = {
    "tlog": _is_telemetry,
    "dji": _is_dji,
    "utf-16": _is_utf16,
    # delimited text without control characters, compared after UTF-8
    "8-bit": lambda head, _file: not _CONTROLS & set(head) and is_delimited(head.decode("latin-1")),
}


def _refused(name: str, row: Mapping[str, Any], error: type[InputError]) -> common.LogFormat:
    """Format without a reader, a row of a table; the file's name goes into the braces."""

    def refuse(file: Path, _options: common.ReadOptions) -> Never:
        received = row.get("received", f"{row['label']}, '{{}}'").format(file.name)
        raise error(row.get("expected", "a log that this release reads"), received, row["remedy"])

    sniff = _SNIFFS.get(name) or common.begins_with(*map(bytes.fromhex, row["magic"]))
    return common.LogFormat(name, row["label"], sniff, refuse, is_read=False)


REFUSED, (UTF_32, UTF_16, EIGHT_BIT) = (
    tuple(_refused(name, row, error) for name, row in common.LOG_TABLES[kind].items())
    for kind, error in (("refused", MissingReaderError), ("encodings", UnknownFormatError))
)


# -- Table of formats --

#: Where formats are that are recognised by their first bytes, in the order of comparison. A module is loaded
#: when the file is of no format before it.
READERS = (
    "eivor.logs.ulog.reader:FORMATS",
    "eivor.logs.table.columnar:PARQUETS",
    "eivor.logs.crazyflie:FORMATS",
    "eivor.logs.blackbox:FORMATS",
    "eivor.logs.dataflash.channels:FORMATS",
    "eivor.logs.rosbag.channels:FORMATS",
    "eivor.logs.table.columnar:ARRAYS",
)
#: Formats of text, which has no first bytes of its own, are compared last; this module has that of tables.
TABLES = "eivor.logs.table.columnar:TEXTS"

#: Ends of names of logs of formats that are recognised, or that others read: the reader says what to do.
FURTHER_ENDINGS = (".bag", ".db3", ".db3.zstd", ".mcap", ".mcap.zstd", ".tlog")


def log_formats() -> Iterator[common.LogFormat]:
    """All formats, in the order in which a file is compared with them."""
    for reader in READERS:
        yield from resolve_name(reader)
    yield from (*REFUSED, UTF_32, UTF_16, *resolve_name(TABLES), EIGHT_BIT)


def readable_formats() -> tuple[common.LogFormat, ...]:
    """Return the formats that are read."""
    return tuple(row for row in log_formats() if row.is_read)


def log_format(name: str) -> common.LogFormat | None:
    """Return the format of a name, as in `Recording.format`; None for recordings that are of no file."""
    return next((row for row in log_formats() if row.name == name), None)


def advising_format(name: str) -> common.LogFormat:
    """Return the format whose advice serves logs of a format: itself, or tables where it has none."""
    known = log_format(name)
    if known is not None and known.advice("") and known.setpoints:
        return known
    (tables,) = resolve_name(TABLES)
    return tables


def format_of(head: bytes, file: Path) -> common.LogFormat:
    """Return the format of a file."""
    for row in log_formats():
        if row.sniff(head, file):
            return row
    labels = ", ".join(row.label for row in readable_formats())
    expected = f"a log of a format that is read ({labels})"
    remedy = "Check that this is the file you meant; a table needs a line of column names and delimited text."
    raise UnknownFormatError(expected, f"'{file.name}', whose content is that of none of them", remedy)


def format_at(path: Path) -> common.LogFormat:
    """Return the format of a file, or of a folder that is a log, by what is in it."""
    if path.is_dir():
        return format_of(b"", path)
    with path.open("rb") as stream:
        return format_of(stream.read(common.HEAD_BYTES), path)


def folder_parts(folder: Path) -> common.FolderParts:
    """Return which files of a folder are one log together, and which were made of logs beside them."""
    results = [row.parts(folder) for row in readable_formats()]
    derived = frozenset().union(*(result.derived for result in results))
    return common.FolderParts(
        next((result.members for result in results if result.members), frozenset()), derived
    )


#: Largest file that is read unless the caller says otherwise: 1 GiB.
DEFAULT_MAX_BYTES = 1 << 30


def read_log(
    path: str | os.PathLike[str],
    *,
    channel_map: str | os.PathLike[str] | None = None,
    max_bytes: int = DEFAULT_MAX_BYTES,
) -> Recording:
    """Read a flight log of any supported format, recognised by its content.

    Parameters
    ----------
    path : str or path
        A ULog, a DataFlash log, a Crazyflie's microSD log or a blackbox log. A ROS bag, its folder, or MCAP.
        A CSV, Parquet, MATLAB or HDF5 file.
    channel_map : str or path, optional
        For tables, variables of a Crazyflie, and topics of bags: a channel map (TOML), or the name of a
        shipped one ("nanobench", "rotorpy"). Not needed for canonical column names, for variables and topics
        that are known, nor where a shipped map fits by itself.
    max_bytes : int
        Largest file that is read [bytes]; 1 GiB by default. What its content may become follows from it: an
        eighth of it are the numbers of a table, eight times it what is decompressed.

    Returns
    -------
    Recording
        Channels in SI units on their own clocks, with the reader's findings.

    Raises
    ------
    EmptyLogError
        When the file, or every channel that is known in it, is empty.
    LogTooLargeError
        When the file is larger than `max_bytes`; nothing has been read then.
    UnknownFormatError, MissingReaderError
        When the content is of no known format, or of one that this release does not read.
    CorruptLogError
        When the content begins like a log and cannot be read as one.
    ChannelMapError
        When a table has no canonical names and no map fits it, or the map is wrong.
    InputError
        When there is no such file, or it cannot be opened.
    UsageError
        When `path` is no path, or a channel map is given for a log that takes none.

    Notes
    -----
    Time and memory are proportional to the file's size; corrupt content cannot change that.
    """
    checks.path("path", path)
    if channel_map is not None:
        checks.path("channel_map", channel_map)
    checks.whole("max_bytes", max_bytes)
    file = Path(path)
    try:
        str(file).encode("utf-8")  # as which the table readers take their paths
    except UnicodeEncodeError as error:
        raise InputError("a path in UTF-8", repr(os.fsencode(file)), "Rename the file or folder.") from error
    size = _log_size(file)
    if size == 0:
        raise EmptyLogError("a log", f"'{file.name}', which is empty (0 bytes)", "Copy the file again.")
    if size > max_bytes:
        expected = f"a log of at most {max_bytes} bytes"
        remedy = "Cut the log to the manoeuvre of interest, or raise the limit: read_log(max_bytes=...)."
        raise LogTooLargeError(expected, f"'{file.name}' with {size} bytes", remedy)
    try:
        head, sha256 = _head(file)
        chosen = format_of(head, file)
        if channel_map is not None and chosen.is_read and not chosen.takes_map:
            taking = ", ".join(row.label for row in readable_formats() if row.takes_map)
            expected = f"a channel map only with logs whose columns have any names ({taking})"
            received = f"a channel map with the {chosen.label} '{file.name}'"
            raise UsageError(expected, received, f"Leave the map out: what a {chosen.label} holds is known.")
        return replace(chosen.read(file, common.ReadOptions(channel_map, max_bytes)), sha256=sha256)
    except OSError as error:
        raise _unreadable(file, error) from error


def _head(file: Path) -> tuple[bytes, str]:
    if file.is_dir():
        return b"", common.folder_sha256(file)
    with file.open("rb") as stream:
        head = stream.read(common.HEAD_BYTES)
        stream.seek(0)
        return head, hashlib.file_digest(stream, "sha256").hexdigest()


def _log_size(file: Path) -> int:
    try:
        status = file.stat()
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from error
    if stat.S_ISDIR(status.st_mode) and any(row.sniff(b"", file) for row in readable_formats()):
        return common.folder_size(file)
    if not stat.S_ISREG(status.st_mode):
        kind = "a directory" if stat.S_ISDIR(status.st_mode) else "not a regular file"
        remedy = "Give the file itself; eivor fleet run takes folders."
        raise InputError("the path of a log file", f"'{file}', which is {kind}", remedy)
    return status.st_size


def _unreadable(file: Path, error: OSError | ValueError) -> InputError:
    if isinstance(error, FileNotFoundError):
        expected = "the path of an existing log file"
        return InputError(expected, f"'{file}', which does not exist", "Check the name and the folder.")
    if isinstance(error, PermissionError):
        remedy = "Change its permissions, or copy it to a place of your own."
        return InputError("a log file that may be read", f"'{file}', for which permission is denied", remedy)
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    received = f"'{file}', for which the system says: {reason}"
    return InputError("a log file that can be opened", received, "Check the path.")


EXAMPLE_FLIGHT = "example_flight.parquet"


def example_flight() -> Recording:
    """Return the bundled example: a simulated flight of one minute at 100 Hz, whose truth is known.

    Friction is 0.180 1/s, the actuators' lag 72 ms; `example_flight_truth.json` beside its file says all.
    """
    with resources.as_file(resources.files("eivor.data").joinpath(EXAMPLE_FLIGHT)) as path:
        return read_log(path)
