"""The table of formats: which there are, which one a file has, and what each advises to log.

A new format is a file that makes a `LogFormat`, and a line in `FORMATS`. Another package adds
its own with `declare_format`.
"""

from __future__ import annotations

from pathlib import Path

from eivor.errors import UnknownFormatError, UsageError
from eivor.logs.bags.format import BAGS
from eivor.logs.crazyflie.format import CRAZYFLIE
from eivor.logs.dataflash.format import DATAFLASH
from eivor.logs.log_format import HEAD_BYTES, FolderParts, LogFormat
from eivor.logs.table.formats import CSV, HDF5, MATLAB, PARQUET
from eivor.logs.ulog.format import ULOG, ULOG_CSV
from eivor.logs.unread import DJI, EIGHT_BIT, RECOGNISED, TELEMETRY, UTF_16

#: Formats that are told by their first bytes.
FORMATS: tuple[LogFormat, ...] = (
    ULOG,
    ULOG_CSV,
    PARQUET,
    CRAZYFLIE,
    DATAFLASH,
    *BAGS,
    MATLAB,
    HDF5,
    *RECOGNISED,
    TELEMETRY,
    DJI,
)
#: Formats of text, which has no first bytes of its own: asked last.
TEXTS: tuple[LogFormat, ...] = (UTF_16, CSV, EIGHT_BIT)

#: What other packages have declared, by name; asked after `FORMATS` and before `TEXTS`.
_DECLARED: dict[str, LogFormat] = {}


def log_formats() -> tuple[LogFormat, ...]:
    """Return all formats, in the order in which a file is compared with them."""
    return (*FORMATS, *_DECLARED.values(), *TEXTS)


def readable_formats() -> tuple[LogFormat, ...]:
    """Return the formats that are read."""
    return tuple(row for row in log_formats() if row.is_read)


def declare_format(added: LogFormat) -> None:
    """Add a format to the table, for this process. Declaring the same format again changes nothing.

    Raises
    ------
    UsageError
        When its name is that of another format.
    """
    known = log_format(added.name)
    if known is not None and known != added:
        raise UsageError(
            "a format with a name of its own", f"'{added.name}', which is known already", "Rename it."
        )
    if known is None:
        _DECLARED[added.name] = added


def log_format(name: str) -> LogFormat | None:
    """Return the format of a name, as in `Recording.format`; None for recordings that are of no file."""
    return next((row for row in log_formats() if row.name == name), None)


def advising_format(name: str) -> LogFormat:
    """Return the format whose advice serves logs of a format: itself, or tables where it has none."""
    known = log_format(name)
    return known if known is not None and known.advice("") and known.setpoints else CSV


def format_of(head: bytes, file: Path) -> LogFormat:
    """Return the format of a file.

    Parameters
    ----------
    head : bytes
        The first `HEAD_BYTES` of the file, or all of it.
    file : Path
        The file.

    Raises
    ------
    UnknownFormatError
        When the content is that of no known format.
    """
    for row in log_formats():
        if row.sniff(head, file):
            return row
    labels = ", ".join(row.label for row in readable_formats())
    raise UnknownFormatError(
        f"a log of a format that is read ({labels})",
        f"'{file.name}', whose content is that of none of them",
        "Check that this is the file you meant; a table needs a line of column names and delimited text.",
    )


def format_at(path: Path) -> LogFormat:
    """Return the format of a file, or of a folder that is a log, by what is in it.

    Raises
    ------
    UnknownFormatError
        When the content is that of no known format.
    OSError
        When it cannot be opened.
    """
    if path.is_dir():
        return format_of(b"", path)
    with path.open("rb") as stream:
        return format_of(stream.read(HEAD_BYTES), path)


def folder_parts(folder: Path) -> FolderParts:
    """Return which files of a folder are one log together, and which were made of logs beside them.

    Raises
    ------
    OSError
        When the folder cannot be looked into.
    """
    found = [row.parts(folder) for row in readable_formats()]
    derived = frozenset().union(*(one.derived for one in found))
    return FolderParts(next((one.members for one in found if one.members), frozenset()), derived)


def logging_advice(name: str = ULOG.name, channel: str = "") -> tuple[str, ...]:
    """Sentences that say what to log.

    Parameters
    ----------
    name : str
        Of a format that is read: "ulog", "ulog2csv" (PX4), "dataflash" (ArduPilot), "crazyflie", "ros1",
        "ros2", "mcap", "matlab", "hdf5", "csv", "parquet".
    channel : str
        A canonical channel: only the advice for it; empty for the advice on the whole flight.

    Returns
    -------
    tuple of str
        Whole sentences, the most important first. Empty when nothing is known about `channel`.

    Raises
    ------
    UsageError
        When there is no such format.
    """
    row = log_format(name)
    if row is None or not row.is_read:
        known = ", ".join(f"'{known.name}'" for known in readable_formats())
        raise UsageError(f"a log format: {known}", f"'{name}'", "Name one of these formats.")
    return row.advice(channel)
