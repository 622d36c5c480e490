"""Studies of the record: examples of `eivor study`, the paper's tables, the flight study's small size."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import polars as pl

from validation.parity.estimates import number
from validation.parity.where import FLIGHT_STUDY, STUDIES, eivor, run


def study_record(name: str, runs: int) -> dict[str, Any]:
    """What `eivor study --json` says of an example, run with one process."""
    with tempfile.TemporaryDirectory() as folder:
        done = eivor(
            *("study", STUDIES / f"{name}.toml", "--runs", runs, "--workers", 1),
            *("--out", Path(folder) / "study", "--json", "-"),
        )
    document = done.document
    if document is None:
        return {"exit_code": done.code, "message": done.err.strip()}
    for of_the_day in ("provenance", "trials"):
        document.pop(of_the_day, None)
    return {"exit_code": done.code, "document": document}


def paper_record(readings: tuple[str, ...], runs: int) -> dict[str, Any]:
    """Tables of `eivor paper` under some readings."""
    done = eivor("paper", "--readings", ",".join(readings), "--runs", runs, "--workers", 1, "--json", "-")
    document = done.document
    if document is None:
        return {"exit_code": done.code, "message": done.err.strip()}
    for of_the_day in ("provenance", "version", "seconds"):
        document.pop(of_the_day, None)
    return {"exit_code": done.code, "document": document}


def flight_study_record() -> dict[str, Any]:
    """Every trial of the flight study's small size: verdict, truth, values and intervals by flight."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trials.parquet"
        done = run(FLIGHT_STUDY, "--size", "small", "--out", path)
        if not path.exists():
            raise RuntimeError(f"the flight study left with {done.code}: {done.err}")
        table = pl.read_parquet(path)
    trials = {
        f"{row['flight']}": {
            name: number(value) if isinstance(value, float) else value
            for name, value in row.items()
            if "." in name or name == "verdict"
        }
        for row in table.iter_rows(named=True)
    }
    columns = ["verdict", *(name for name in table.columns if "." in name)]
    return {
        "exit_code": done.code,
        "columns": columns,
        "trials": {name: [trial[column] for column in columns] for name, trial in trials.items()},
    }
