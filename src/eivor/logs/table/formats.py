"""Formats of tables: CSV, Parquet, MATLAB and HDF5."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path

from eivor.logs.channel_map import load_channel_map
from eivor.logs.common import LogFormat, ReadOptions, begins_with, noted, with_elements
from eivor.logs.mapping import fitted_rules, fitting_map, listed, mapped_recording
from eivor.logs.table.columnar import open_hdf5, open_matlab, open_parquet, restore
from eivor.logs.table.delimited import TableSource, is_delimited, open_csv
from eivor.signals.recording import Recording

_HDF5 = b"\x89HDF\r\n\x1a\n"
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


def _is_csv(head: bytes, _file: Path) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        return is_delimited(decoder.decode(head))
    except UnicodeDecodeError:
        return False


def _advice(channel: str) -> tuple[str, ...]:
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
        source, alone = opened(file), options.channel_map is None
        findings = list(source.findings)
        if options.channel_map is None:
            chosen, finding = fitting_map(source.names, file.name)
            findings += [finding] if finding is not None else []
        else:
            chosen = load_channel_map(options.channel_map)
        columns = [column for rule in chosen.rules for column in rule.expression.columns]
        rules = fitted_rules(chosen, with_elements(columns, source.names), file.name)
        needed = dict.fromkeys([chosen.time_column, *(c for rule in rules for c in rule.expression.columns)])
        if alone and chosen.origin == file.name:
            ignored = listed([name for name in source.names if name not in needed])
            sentence = "Columns without a canonical name are not used: {}."
            findings += noted("ignored_columns", sentence, ignored)
        recording = mapped_recording(
            chosen,
            rules,
            source.read(list(needed)),
            name=file.name,
            log_format=name,
            sha256=options.sha256,
            findings=findings,
        )
        return restore(recording, source.metadata) if alone else recording

    return LogFormat(
        name, label, sniff, read, takes_map=True, advice=_advice, setpoints=_SETPOINTS, endings=endings
    )


TEXTS = (_table("csv", "CSV", _is_csv, open_csv, ".csv", ".tsv"),)
PARQUETS = (_table("parquet", "Parquet", begins_with(b"PAR1"), open_parquet, ".parquet"),)
ARRAYS = (
    _table("matlab", "MATLAB", begins_with(b"MATLAB 5.0 MAT-file"), open_matlab, ".mat"),
    # at once, or after the 512 bytes of text of MATLAB 7.3
    _table("hdf5", "HDF5", lambda head, _: _HDF5 in (head[:8], head[512:520]), open_hdf5, ".h5", ".hdf5"),
)
