"""Reports of a fleet's folder, one for each motion that its table has."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from eivor.fleets.given_covariates import with_covariates
from eivor.fleets.pooled_rows import across_of, wanted_columns
from eivor.fleets.report import FleetReport, fleet_report
from eivor.fleets.table import motions_there, read_flights
from eivor.motions import motion_by_name


def fleet_reports(folder: Path, given: pl.DataFrame | None = None) -> tuple[FleetReport, ...]:
    """Reports of a folder.

    Parameters
    ----------
    folder : Path
        That `eivor fleet run` made.
    given : polars.DataFrame, optional
        Covariates of flights, see `given_covariates`.

    Raises
    ------
    InputError
        When it has no table of flights, or covariates are given of none of them.
    UsageError
        When the package that brings one of its motions is not there.
    """
    motions = [motion_by_name(name) for name in motions_there(folder)]
    columns = [name for motion in motions for name in wanted_columns(across_of(motion))]
    table = read_flights(folder, list(dict.fromkeys(columns)))
    if given is None:
        return tuple(fleet_report(table, motion) for motion in motions)
    table = with_covariates(table, given)
    return tuple(fleet_report(table, motion, given.columns[1:]) for motion in motions)
