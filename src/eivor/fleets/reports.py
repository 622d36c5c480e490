"""Reports of a fleet's folder, one for each motion that its table has."""

from __future__ import annotations

from pathlib import Path

from eivor.fleets.pooled_rows import across_of, wanted_columns
from eivor.fleets.report import FleetReport, fleet_report
from eivor.fleets.table import read_flights
from eivor.motions import motion_by_name


def fleet_reports(folder: Path) -> tuple[FleetReport, ...]:
    """Reports of a folder.

    Parameters
    ----------
    folder : Path
        That `eivor fleet run` made.

    Raises
    ------
    InputError
        When it has no table of flights.
    UsageError
        When the package that brings one of its motions is not there.
    """
    names = read_flights(folder, ["motion"])["motion"].drop_nulls().unique().sort().to_list()
    motions = [motion_by_name(name) for name in names]
    columns = [name for motion in motions for name in wanted_columns(across_of(motion))]
    table = read_flights(folder, list(dict.fromkeys(columns)))
    return tuple(fleet_report(table, motion) for motion in motions)
