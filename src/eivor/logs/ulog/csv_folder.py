"""Folders that `ulog2csv` makes of a ULog: a table for each instance of a topic, ``NAME_TOPIC_INSTANCE.csv``.

Topics are read as in the ULog itself. The parameters are not in these tables.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from eivor.errors import CorruptLogError, EmptyLogError, InputError, UnknownFormatError
from eivor.logs.findings import channel_findings
from eivor.logs.log_format import ReadOptions
from eivor.logs.table.delimited import open_csv
from eivor.logs.ulog.channels import read_topics
from eivor.logs.ulog.csv_names import tables_of
from eivor.logs.ulog.delays import unknown_filters
from eivor.logs.ulog.instances import Topic, choose_instance
from eivor.logs.ulog.topics import LOOKED_FOR
from eivor.logs.ulog.vehicle import vehicle_of
from eivor.signals.recording import Finding, Frame, Recording

#: A field of a topic, which no other column of these tables looks like.
_FIELD = re.compile(r"[A-Za-z_][\w.\[\]]*")
#: Stamps beyond these are damaged [us].
_LAST_US = float(1 << 62)


def read_csv_folder(folder: Path, options: ReadOptions, log_format: str) -> Recording:
    """Read a folder of `ulog2csv`.

    Parameters
    ----------
    folder : Path
        It holds tables of topics that are needed.
    options : ReadOptions
        The hash of the bytes.
    log_format : str
        Name of the format.

    Raises
    ------
    InputError
        When the tables are of several logs.
    EmptyLogError
        When no channel is made of them.
    """
    tables = tables_of(folder)
    logs = sorted({table.log for table in tables})
    if len(logs) > 1:
        raise InputError(
            "a folder with the tables of one log",
            f"'{folder.name}' with those of {len(logs)}: {', '.join(logs[:4])}",
            "Put them into folders of their own.",
        )
    findings: list[Finding] = []
    instances: dict[str, list[Topic]] = {}
    for table in tables:
        topic = _topic(table.file, table.topic, table.instance, findings)
        if topic is not None:
            instances.setdefault(table.topic, []).append(topic)
    topics = {name: choose_instance(candidates, findings) for name, candidates in instances.items()}
    start = min((int(topic.fields["timestamp"].min()) for topic in topics.values()), default=0)
    channels = read_topics(topics, np.uint64(start), {}, findings)
    if not channels:
        raise EmptyLogError(
            "tables with flight data", f"'{folder.name}' without a value", "Convert the ULog again."
        )
    findings += unknown_filters(channels.values(), "These tables hold")
    return Recording(
        name=folder.name,
        format=log_format,
        channels=channels,
        frame=Frame.NED,
        sha256=options.sha256,
        looked_for=LOOKED_FOR,
        findings=(*findings, *channel_findings(channels)),
        vehicle=vehicle_of(topics, {}),
    )


def _topic(file: Path, name: str, instance: int, findings: list[Finding]) -> Topic | None:
    """One table as a topic; None when it is damaged, or holds no stamps."""
    try:
        source = open_csv(file)
        names = [column for column in source.names if _FIELD.fullmatch(column)]
        values = source.read(names).values if "timestamp" in names else {}
    except (CorruptLogError, EmptyLogError, UnknownFormatError) as error:
        findings.append(Finding("corrupt_parts", f"A table was left out: {error.received}."))
        return None
    stamps = values.get("timestamp", np.empty(0))
    sound = np.isfinite(stamps) & (stamps >= 0.0) & (stamps < _LAST_US)
    if not sound.any():
        findings.append(Finding("time_stamps", f"A table without stamps was left out: '{file.name}'."))
        return None
    fields = {key: column[sound] for key, column in values.items() if not key.startswith("timestamp")}
    clocks = {
        key: np.nan_to_num(values[key][sound]).clip(0.0, _LAST_US).astype(np.uint64)
        for key in ("timestamp", "timestamp_sample")
        if key in values
    }
    return Topic(name, instance, {**fields, **clocks})
