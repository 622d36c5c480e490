"""Tables (CSV, Parquet) with canonical column names, or with a channel map.

Without a map a table's axes are z up and its units SI; a table that `write_recording` wrote says its
own frame and sources.
"""

from __future__ import annotations

import os
from pathlib import Path

from eivor.logs.channel_map import load_channel_map
from eivor.logs.mapping import fitted_rules, fitting_map, ignored_columns, mapped_recording
from eivor.logs.table_csv import open_csv
from eivor.logs.table_parquet import open_parquet
from eivor.logs.written import restore
from eivor.signals.recording import Recording


def read_table(
    file: Path,
    log_format: str,
    *,
    channel_map: str | os.PathLike[str] | None = None,
    sha256: str = "",
) -> Recording:
    """Read a table.

    Parameters
    ----------
    file : Path
        The file; `read_log` has checked its size and its first bytes.
    log_format : str
        "csv" or "parquet".
    channel_map : str or path, optional
        Path of a map, or the name of a shipped one.
    sha256 : str
        Hash of the file's bytes, for the Recording.

    Raises
    ------
    ChannelMapError
        When no map fits, or the map is wrong.
    CorruptLogError, EmptyLogError, LogTooLargeError, UnknownFormatError
        When the table cannot be read.
    """
    source = open_parquet(file) if log_format == "parquet" else open_csv(file)
    findings = list(source.findings)
    if channel_map is None:
        chosen, finding = fitting_map(source.names, file.name)
        findings += [finding] if finding is not None else []
    else:
        chosen = load_channel_map(channel_map)
    rules = fitted_rules(chosen, source.names, file.name)
    needed = dict.fromkeys([chosen.time_column, *(c for rule in rules for c in rule.expression.columns)])
    if channel_map is None and chosen.origin == file.name:
        findings += ignored_columns([name for name in source.names if name not in needed])
    recording = mapped_recording(
        chosen,
        rules,
        source.read(list(needed)),
        name=file.name,
        log_format=log_format,
        sha256=sha256,
        findings=findings,
    )
    return restore(recording, source.metadata) if channel_map is None else recording
