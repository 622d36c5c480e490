"""`read_log`: any supported log to a `Recording`."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from eivor import checks
from eivor.errors import EmptyLogError, InputError, LogTooLargeError, UsageError
from eivor.logs.folders import folder_sha256, folder_size
from eivor.logs.formats import format_of, readable_formats
from eivor.logs.log_format import HEAD_BYTES, ReadOptions
from eivor.logs.streams import is_stream, kept
from eivor.signals.recording import Recording

#: Largest file that is read unless the caller says otherwise: 1 GiB.
DEFAULT_MAX_BYTES = 1 << 30


def read_log(
    path: str | os.PathLike[str],
    *,
    channel_map: str | os.PathLike[str] | None = None,
    max_bytes: int = DEFAULT_MAX_BYTES,
) -> Recording:
    """Read a flight log of any supported format, told by its content.

    Parameters
    ----------
    path : str or path
        A ULog, a DataFlash log, a Crazyflie's microSD log, a ROS bag or MCAP, a CSV, Parquet, MATLAB or HDF5
        file; or the folder of a ROS 2 bag. "-" reads standard input, by way of a temporary file.
    channel_map : str or path, optional
        For tables, variables of a Crazyflie, and topics of bags: a channel map (TOML), or the name of a
        shipped one ("nanobench", "rotorpy"). Not needed for canonical column names, for variables and topics
        that are known, nor where a shipped map fits by itself.
    max_bytes : int
        Largest file that is read [bytes]; 1 GiB by default.

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
    _check_name(file)
    if is_stream(file):
        with kept(file, max_bytes) as copy:
            return _read(copy, channel_map, max_bytes)
    return _read(file, channel_map, max_bytes)


def _read(file: Path, channel_map: str | os.PathLike[str] | None, max_bytes: int) -> Recording:
    size = _log_size(file)
    if size == 0:
        raise EmptyLogError("a log", f"'{file.name}', which is empty (0 bytes)", "Copy the file again.")
    if size > max_bytes:
        raise LogTooLargeError(
            f"a log of at most {max_bytes} bytes",
            f"'{file.name}' with {size} bytes",
            "Cut the log to the manoeuvre of interest, or raise the limit: read_log(max_bytes=...).",
        )
    try:
        head, sha256 = _head(file)
    except OSError as error:
        raise _unreadable(file, error) from error
    chosen = format_of(head, file)
    if channel_map is not None and chosen.is_read and not chosen.takes_map:
        taking = ", ".join(row.label for row in readable_formats() if row.takes_map)
        raise UsageError(
            f"a channel map only with logs whose columns have any names ({taking})",
            f"a channel map with the {chosen.label} '{file.name}'",
            f"Leave the map out: what a {chosen.label} holds is known.",
        )
    return chosen.read(file, ReadOptions(channel_map, sha256))


def _check_name(file: Path) -> None:
    """Raise for a path that is not text: the table readers take their paths in UTF-8.

    Raises
    ------
    InputError
        With the bytes that are not.
    """
    try:
        str(file).encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputError(
            "a path in UTF-8",
            repr(os.fsencode(file)),
            "Rename the file or folder.",
        ) from error


def _head(file: Path) -> tuple[bytes, str]:
    """The first bytes of a file, none of a folder, and the hash of all."""
    if file.is_dir():
        return b"", folder_sha256(file)
    with file.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
        stream.seek(0)
        return head, hashlib.file_digest(stream, "sha256").hexdigest()


def _log_size(file: Path) -> int:
    """Size of a regular file, or of the files of a folder that is a log [bytes].

    Raises
    ------
    InputError
        When there is no such file, or it is neither.
    """
    try:
        status = file.stat()
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from error
    if stat.S_ISDIR(status.st_mode) and any(row.sniff(b"", file) for row in readable_formats()):
        return folder_size(file)
    if not stat.S_ISREG(status.st_mode):
        kind = "a directory" if stat.S_ISDIR(status.st_mode) else "not a regular file"
        raise InputError(
            "the path of a log file", f"'{file}', which is {kind}", "Give the file itself, one log at a time."
        )
    return status.st_size


def _unreadable(file: Path, error: OSError | ValueError) -> InputError:
    """Return the error for a file that cannot be opened."""
    if isinstance(error, FileNotFoundError):
        return InputError(
            "the path of an existing log file",
            f"'{file}', which does not exist",
            "Check the name and the folder.",
        )
    if isinstance(error, PermissionError):
        return InputError(
            "a log file that may be read",
            f"'{file}', for which permission is denied",
            "Change its permissions, or copy it to a place of your own.",
        )
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(
        "a log file that can be opened", f"'{file}', for which the system says: {reason}", "Check the path."
    )
