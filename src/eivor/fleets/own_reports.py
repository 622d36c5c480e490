"""Reports of single flights in a fleet's folder: `reports/HASH.html`, one for each log that has a result."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from eivor.fleets.fleet_folder import fleet_errors_told
from eivor.flights.result import FlightEstimate
from eivor.whole_file import write_whole

#: Folder of the reports in that of the fleet.
REPORTS = "reports"
#: Key of a row, until it is written, that holds the page of its flight.
PAGE = "page"
_NAME = re.compile(r"([0-9a-f]{64})\.html")

#: What makes the page of a result.
PageOf: TypeAlias = Callable[[FlightEstimate], str]


def report_place(folder: Path, sha256: str) -> Path:
    """Where the report of a log is, by its hash and by nothing else that the log says."""
    return folder / REPORTS / f"{sha256}.html"


def write_report(folder: Path, sha256: str, page: str) -> None:
    """Write the report of a log."""
    place = report_place(folder, sha256)
    with fleet_errors_told(folder):
        place.parent.mkdir(exist_ok=True)
        write_whole(place, page)


def reports_there(folder: Path) -> Generator[str, None, None]:
    """Hashes of the logs that have a report, in any order; none are kept."""
    with fleet_errors_told(folder), suppress(FileNotFoundError), os.scandir(folder / REPORTS) as entries:
        for entry in entries:
            found = _NAME.fullmatch(entry.name)
            if found is not None:
                yield found[1]
