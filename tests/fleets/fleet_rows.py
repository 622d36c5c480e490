"""Rows of fleets for tests."""

from __future__ import annotations

from datetime import UTC, datetime

from eivor.atomic_file import parquet_bytes
from eivor.fleet.table import FLIGHTS, flight_frame


def row(name, **values):
    """A row with a result of one quantity, unless it says otherwise."""
    start = datetime(2026, 5, 1, 12, tzinfo=UTC)
    reported = {f"gain.{part}": 1.0 for part in ("value", "std_error", "low", "high")} | {
        "gain.verdict": "weak"
    }
    given = {
        "motion": "vertical",
        "sha256": name * 8,
        "verdict": "weak",
        "start": start,
        "duration_s": 1800.0,
    }
    return {
        "name": name,
        **given,
        **({} if values.get("verdict") in ("failed", "copy") else reported),
        **values,
    }


def write_fleet(folder, *parts):
    """Write a fleet's parts."""
    (folder / FLIGHTS).mkdir(parents=True)
    for number, rows in enumerate(parts):
        path = folder / FLIGHTS / f"part-{number}.parquet"
        path.write_bytes(parquet_bytes(flight_frame(rows)))
    return folder
