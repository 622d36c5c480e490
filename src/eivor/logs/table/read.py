"""Tables (CSV, Parquet) with canonical column names, or with a channel map.

Without a map a table's axes are z up and its units SI; a table that `write_recording` wrote says its
own frame and sources.
"""

from __future__ import annotations

from pathlib import Path

from eivor.logs.channel_map import load_channel_map
from eivor.logs.elements import with_elements
from eivor.logs.log_format import ReadOptions
from eivor.logs.mapping import fitted_rules, fitting_map, ignored_columns, mapped_recording
from eivor.logs.table.source import TableSource
from eivor.logs.table.written import restore
from eivor.signals.recording import Recording


def read_table(file: Path, source: TableSource, log_format: str, options: ReadOptions) -> Recording:
    """Read a table.

    Parameters
    ----------
    file : Path
        The file; `read_log` has checked its size and its first bytes.
    source : TableSource
        Its columns.
    log_format : str
        Name of its format.
    options : ReadOptions
        A channel map, and the hash of the file's bytes.

    Raises
    ------
    ChannelMapError
        When no map fits, or the map is wrong.
    CorruptLogError, EmptyLogError, LogTooLargeError, UnknownFormatError
        When the table cannot be read.
    """
    findings = list(source.findings)
    if options.channel_map is None:
        chosen, finding = fitting_map(source.names, file.name)
        findings += [finding] if finding is not None else []
    else:
        chosen = load_channel_map(options.channel_map)
    asked = [column for rule in chosen.rules for column in rule.expression.columns]
    rules = fitted_rules(chosen, with_elements(asked, source.names), file.name)
    needed = dict.fromkeys([chosen.time_column, *(c for rule in rules for c in rule.expression.columns)])
    if options.channel_map is None and chosen.origin == file.name:
        findings += ignored_columns([name for name in source.names if name not in needed])
    recording = mapped_recording(
        chosen,
        rules,
        source.read(list(needed)),
        name=file.name,
        log_format=log_format,
        sha256=options.sha256,
        findings=findings,
    )
    return restore(recording, source.metadata) if options.channel_map is None else recording
