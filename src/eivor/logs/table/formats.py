"""Tables as rows of the table of formats: how they are told, and what to log in them."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from eivor.logs.log_format import LogFormat, ReadOptions, begins_with
from eivor.signals.recording import Recording

if TYPE_CHECKING:
    from eivor.logs.table.source import TableSource

_HDF5 = b"\x89HDF\r\n\x1a\n"
DELIMITERS = (",", ";", "\t", "|")
_ADVICE = (
    "Log at 100 Hz or more, one row per instant, with a column 'time' in seconds.",
    "Log the motor commands (not only the thrust setpoint), the vertical velocity, the specific force or the "
    "vertical acceleration, the attitude, and the height reference.",
    "Log setpoints as they are commanded, not filtered or interpolated.",
)
_SETPOINTS = (
    "reference_position_z (the height reference), rotor_command_1.. or input (the command), pilot_throttle "
    "(the stick, when a pilot flies)."
)


def is_delimited(text: str) -> bool:
    """Say whether the first line of a text that is not blank holds a delimiter."""
    header = next((line for line in text.splitlines() if line.strip()), "")
    return any(mark in header for mark in DELIMITERS)


def _is_csv(head: bytes, _file: Path) -> bool:
    """Whether the first bytes are delimited text in UTF-8."""
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        return is_delimited(decoder.decode(head))
    except UnicodeDecodeError:
        return False


def _open_csv(file: Path) -> TableSource:
    from eivor.logs.table.delimited import open_csv

    return open_csv(file)


def _open_parquet(file: Path) -> TableSource:
    from eivor.logs.table.parquet import open_parquet

    return open_parquet(file)


def _open_matlab(file: Path) -> TableSource:
    from eivor.logs.table.matlab import open_matlab

    return open_matlab(file)


def _open_hdf5(file: Path) -> TableSource:
    from eivor.logs.table.hdf5 import open_hdf5

    return open_hdf5(file)


def _is_hdf5(head: bytes, _file: Path) -> bool:
    """Whether it is HDF5: at once, or after the 512 bytes of text of MATLAB 7.3."""
    return head.startswith(_HDF5) or head[512:].startswith(_HDF5)


def _advice(channel: str) -> tuple[str, ...]:
    """Which columns to write."""
    return (f"Add a column '{channel}', or map one in a channel map.",) if channel else _ADVICE


def _table(
    name: str,
    label: str,
    sniff: Callable[[bytes, Path], bool],
    opened: Callable[[Path], TableSource],
    *endings: str,
) -> LogFormat:
    """Row of a table: what is the same of all is said here."""

    def read(file: Path, options: ReadOptions) -> Recording:
        from eivor.logs.table.read import read_table

        return read_table(file, opened(file), name, options)

    return LogFormat(
        name, label, sniff, read, takes_map=True, advice=_advice, setpoints=_SETPOINTS, endings=endings
    )


CSV = _table("csv", "CSV", _is_csv, _open_csv, ".csv", ".tsv")
PARQUET = _table("parquet", "Parquet", begins_with(b"PAR1"), _open_parquet, ".parquet")
MATLAB = _table("matlab", "MATLAB", begins_with(b"MATLAB 5.0 MAT-file"), _open_matlab, ".mat")
HDF5 = _table("hdf5", "HDF5", _is_hdf5, _open_hdf5, ".h5", ".hdf5")
