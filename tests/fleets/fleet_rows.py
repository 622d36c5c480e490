"""Rows of fleets, and logs that are quick to make and to read, also in other processes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime

from eivor.atomic_file import parquet_bytes
from eivor.fleet.table import FLIGHTS, PAGE, FleetOptions, PageOf, flight_frame
from eivor.logs.read import here


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


@dataclass(frozen=True)
class QuickRow:
    """Rows in place of those of `RowOfLog`: a log is a text, which some make mistakes at."""

    options: FleetOptions
    page_of: PageOf | None = None

    def __call__(self, log):
        with here(log.path) as path:
            text = path.read_text(encoding="utf-8")
        if text.startswith("slow"):
            time.sleep(0.02)
        selected = {"verdict": "weak", "gain.value": float(len(text)), "gain.verdict": "weak"}
        page = {} if self.page_of is None else {PAGE: f"page of {text}"}
        return {**self.options.row_of(log), **selected, **page}


def write_logs(folder, texts):
    """Write texts under names that end like logs."""
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def rows_of(monkeypatch, made=QuickRow):
    """Make quick rows in this process."""

    def row_maker(options, page_of=None):
        return made(options) if page_of is None else made(options, page_of)

    monkeypatch.setattr("eivor.fleet.table.RowOfLog", row_maker)
    monkeypatch.setattr("eivor.fleet.run.kept_process", lambda function, _limits: function)
