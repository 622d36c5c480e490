"""Names of the tables that `ulog2csv` writes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from eivor.logs.ulog.topics import NEEDED_TOPICS

_NAME = re.compile(rf"(.*)_({'|'.join(sorted(NEEDED_TOPICS, key=len, reverse=True))})_(\d+)\.csv")


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
    named = ((file, _NAME.fullmatch(file.name)) for file in sorted(folder.iterdir()))
    return [
        TopicTable(file, match[1], match[2], int(match[3]))
        for file, match in named
        if match is not None and file.is_file()
    ]
