"""Names of the tables that `ulog2csv` writes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from eivor.logs.folders import file_names
from eivor.logs.log_format import FolderParts
from eivor.logs.ulog.topics import NEEDED_TOPICS

#: A table of a topic that is needed: its log, its topic and the number of the instance.
TOPIC_TABLE = rf"(.*)_({'|'.join(sorted(NEEDED_TOPICS, key=len, reverse=True))})_(\d+)\.csv"
_NAME = re.compile(TOPIC_TABLE)
#: How names of ULogs end.
ULOG_ENDINGS = (".ulg", ".ulog")
#: Any table of a topic, needed or not.
_TABLE = re.compile(r".*_\d+\.csv")


@dataclass(frozen=True, slots=True)
class TopicTable:
    """A table of one topic.

    Parameters
    ----------
    file : Path
        The table.
    log, topic : str
        What its name says.
    instance : int
        Number of the topic's instance.
    """

    file: Path
    log: str
    topic: str
    instance: int


def tables_of(folder: Path) -> list[TopicTable]:
    """Return the tables of topics that are needed, by their names; none of what is no folder."""
    if not folder.is_dir():
        return []
    named = ((name, _NAME.fullmatch(name)) for name in file_names(folder))
    found = [
        TopicTable(folder / name, match[1], match[2], int(match[3]))
        for name, match in named
        if match is not None
    ]
    return sorted(found, key=lambda table: table.file)


def csv_parts(folder: Path) -> FolderParts:
    """Return the tables that `ulog2csv` made, with those of topics that are not needed.

    Tables beside their ULog are not another log.
    """
    logs = {table.log for table in tables_of(folder)}
    beside = {log for log in logs if any((folder / f"{log}{end}").is_file() for end in ULOG_ENDINGS)}
    names = [name for name in file_names(folder) if _TABLE.fullmatch(name)] if logs else []

    def of(some: set[str]) -> frozenset[str]:
        begins = tuple(f"{log}_" for log in some)
        return frozenset(name for name in names if name.startswith(begins))

    return FolderParts(of(logs - beside) - of(beside), of(beside))
