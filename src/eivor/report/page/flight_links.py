"""Links from a fleet's page to the reports of its flights."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from eivor.fleets.own_reports import report_place, reports_there


def flight_links(folder: Path, page: Path) -> Mapping[str, str]:
    """Address of the report of each log that has one, by the log's hash, relative to a page.

    An address has the fleet's folder and the hash in it, and nothing that a log says.

    Parameters
    ----------
    folder : Path
        Of the fleet.
    page : Path
        Where the page will be.
    """
    beside = page.resolve().parent
    return {
        sha256: quote(Path(os.path.relpath(report_place(folder.resolve(), sha256), beside)).as_posix())
        for sha256 in reports_there(folder)
    }
