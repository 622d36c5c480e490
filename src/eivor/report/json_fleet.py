"""The JSON document of a fleet's report, schema ``eivor.fleet_report/1``; its keys: docs/fleet-report.md."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from typing import Any

import polars as pl

from eivor.fleets.report import FleetReport
from eivor.report.json_document import Json

SCHEMA = "eivor.fleet_report/1"


def fleet_json(reports: Sequence[FleetReport]) -> dict[str, Json]:
    """Document of the reports of a fleet, one for each motion; numbers are in SI units.

    Parameters
    ----------
    reports : sequence of FleetReport
        In their order.
    """
    return {
        "schema": SCHEMA,
        "motions": [_motion(report) for report in reports],
        "provenance": {"version": version("eivor")},
    }


def _motion(report: FleetReport) -> dict[str, Json]:
    return {
        "motion": report.motion.name,
        **report.logs,
        "quantities": [
            {
                "name": one.name,
                "unit": report.motion.wording[one.name].unit,
                "logarithm": one.logarithm,
                "covariates": [each.name for each in one.covariates],
            }
            for one in report.quantities
        ],
        "types": _rows(report.types),
        "vehicles": _rows(report.vehicles),
        "deviating": _rows(report.deviating),
        "left_out": _rows(report.left_out),
        "covariates": _rows(report.covariates),
    }


def _rows(table: pl.DataFrame) -> list[Json]:
    return [{name: _value(one) for name, one in row.items()} for row in table.iter_rows(named=True)]


def _value(one: Any) -> Json:
    if isinstance(one, datetime):
        return one.isoformat()
    return None if isinstance(one, float) and not math.isfinite(one) else one
