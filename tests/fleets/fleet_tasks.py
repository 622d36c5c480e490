"""Functions that tests call in other processes, and logs that are quick to make and to read."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from eivor.fleet.table import PAGE, FleetOptions, NamedRow, PageOf


@dataclass(frozen=True)
class QuickRow:
    """Rows in place of those of `RowOfLog`: a log is a text, which some make mistakes at."""

    options: FleetOptions
    page_of: PageOf | None = None

    def __call__(self, log):
        text = Path(log.path).read_text(encoding="utf-8")
        if text.startswith("slow"):
            time.sleep(0.02)
        selected = {"verdict": "weak", "gain.value": float(len(text)), "gain.verdict": "weak"}
        page = {} if self.page_of is None else {PAGE: f"page of {text}"}
        return {**NamedRow(self.options)(log), **selected, **page}


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

    monkeypatch.setattr("eivor.fleet.run.RowOfLog", row_maker)
