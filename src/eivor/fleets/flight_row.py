"""One log to one row of the fleet's table: its numbers, or the reason why it has none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import EivorError
from eivor.fleets.fleet_options import FleetOptions
from eivor.fleets.log_list import Log
from eivor.fleets.own_reports import PAGE, PageOf
from eivor.fleets.table import COPY, DIAGNOSTIC, FAILED, NUMBERS, VERDICT
from eivor.flights.result import FlightEstimate
from eivor.logs.formats import format_at
from eivor.logs.read import read_log
from eivor.motions.identify import identify_flight
from eivor.signals.recording import Recording

#: Channels whose mean over the log is a column of their own.
SURROUNDINGS = {
    "battery_voltage": "battery_voltage",
    "temperature": "air_temperature",
    "air_density": "air_density",
}


@dataclass(frozen=True, slots=True)
class FlightRow:
    """The function from a log to its row.

    Parameters
    ----------
    options : FleetOptions
        What is asked of every log.
    page_of : callable, optional
        What makes the page of a result, which the row then holds as `PAGE` until it is written.
    """

    options: FleetOptions
    page_of: PageOf | None = None

    def __call__(self, log: Log) -> dict[str, Any]:
        """Row of a log that could be opened; also of one without a result."""
        motion = self.options.chosen_motion()
        about = NamedRow(self.options)(log)
        try:
            recording = read_log(log.path, channel_map=self._map(log))
            if recording.sha256 != log.sha256:
                return failed_row(about, "The file changed while the fleet was run: run it again.")
            about = {**about, **_of_recording(recording), **self._whose(log, recording)}
            result = identify_flight(recording, self.options.flight, model=motion)
        except EivorError as error:
            return failed_row(about, str(error))
        page = {} if self.page_of is None else {PAGE: self.page_of(result)}
        return {**about, **_of_result(result), **page}

    def _map(self, log: Log) -> str | None:
        """Channel map of a log, when it is of a format that takes one."""
        chosen = self.options.map_of(log.name)
        if not chosen:
            return None
        return chosen if format_at(Path(log.path)).takes_map else None

    def _whose(self, log: Log, recording: Recording) -> dict[str, str]:
        """Vehicle and type: as the user says where it is said, else as the log does."""
        origin, told = recording.origin, _whose_by_name(self.options, log)
        found = {"vehicle": origin.board, "type": origin.airframe, **told}
        if self.options.vehicle_from and self.options.pattern() is None and not told:
            found["vehicle"] = _in_table(Path(log.path), self.options.vehicle_from) or origin.board
        return {key: text for key, text in found.items() if text}


class NamedRow:
    """What every row of a log has, also of one that is not read: what its name and the list tell of it.

    Parameters
    ----------
    options : FleetOptions
        What is asked of every log.
    """

    def __init__(self, options: FleetOptions) -> None:
        self._options, self._marks = options, options.marks()

    def __call__(self, log: Log) -> dict[str, Any]:
        """Beginning of the row of a log."""
        about = {"sha256": log.sha256 or None, "name": log.name}
        return {**about, **self._marks, **_whose_by_name(self._options, log)}


def _whose_by_name(options: FleetOptions, log: Log) -> Mapping[str, str]:
    """Vehicle and type as the log's path or the list says, where the user says that it does."""
    pattern = options.pattern()
    if pattern is not None:
        return pattern.told(log.name)
    told = log.told.get(options.vehicle_from, "")
    return {"vehicle": told} if told else {}


def failed_row(about: Mapping[str, Any], reason: str) -> dict[str, Any]:
    """Row of a log without a result."""
    return {**about, "verdict": FAILED, "reason": reason}


def copy_row(about: Mapping[str, Any], first: str) -> dict[str, Any]:
    """Row of a copy: it names the first, and has no numbers of its own."""
    told = {
        "copy_of": about["sha256"],
        "verdict": COPY,
        "reason": f"A copy of {first}, whose row has the numbers.",
    }
    return {**about, **told}


def _of_recording(recording: Recording) -> dict[str, Any]:
    start, end = recording.span_s
    origin = recording.origin
    found: dict[str, Any] = {
        "firmware": origin.firmware or None,
        "start": origin.start,
        "duration_s": end - start,
    }
    for column, name in SURROUNDINGS.items():
        channel = recording.channels.get(name)
        if channel is not None and np.isfinite(channel.values).any():
            found[column] = float(np.nanmean(channel.values))
    return found


def _of_result(result: FlightEstimate) -> dict[str, Any]:
    row: dict[str, Any] = {
        "verdict": result.verdict.status.value,
        "reason": " ".join(result.verdict.sentences) or None,
    }
    for name, one in result.quantities.items():
        numbers = (one.value, one.std_error, *one.interval)
        row |= {f"{name}.{part}": float(number) for part, number in zip(NUMBERS, numbers, strict=True)}
        row[f"{name}.{VERDICT}"] = one.verdict.value
    if result.fit is not None:
        row["covariance"] = result.covariance.ravel().tolist()
        row["covariance_names"] = list(result.names)
    row |= {f"{DIAGNOSTIC}{name}": float(value) for name, value in result.diagnostics.items()}
    return row


def _in_table(path: Path, column: str) -> str:
    """First text of a column of a log that is a table; empty when it has no such column."""
    import polars as pl

    scans: dict[str, Callable[[Path], pl.LazyFrame]] = {
        "csv": lambda place: pl.scan_csv(place, infer_schema=False),
        "parquet": pl.scan_parquet,
    }
    try:
        scan = scans.get(format_at(path).name)
        if scan is None:
            return ""
        text = scan(path).select(pl.col(column).drop_nulls().first()).collect().item()
    except (EivorError, OSError, pl.exceptions.PolarsError):
        return ""
    return "" if text is None else str(text)
