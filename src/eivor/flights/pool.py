"""Pooling: which flights may share one set of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eivor.errors import PoolingError
from eivor.flights.motion import Motion
from eivor.flights.prepared import PreparedFlight
from eivor.signals.recording import Finding, Recording

#: Hovering inputs of one vehicle, laden or not, are within this ratio of each other.
LARGEST_INPUT_RATIO = 10.0

Window = tuple[float, float] | None


def without_duplicates(
    logs: Sequence[Recording], windows: Sequence[Window]
) -> tuple[list[tuple[Recording, Window]], list[Finding]]:
    """Logs with their windows, each file's content with the same window once only.

    Returns
    -------
    kept : list of (Recording, window)
        In the order given.
    dropped : list of Finding
        One for each log that was left out.
    """
    kept: list[tuple[Recording, Window]] = []
    dropped: list[Finding] = []
    first: dict[tuple[str, Window], str] = {}
    for log, window in zip(logs, windows, strict=True):
        key = (log.sha256, window)
        if log.sha256 and key in first:
            dropped.append(
                Finding(
                    "duplicate_log",
                    f"{log.name} has the same content as {first[key]}; it is used once only.",
                )
            )
            continue
        first[key] = log.name
        kept.append((log, window))
    return kept, dropped


def check_poolable(flights: tuple[PreparedFlight, ...], motion: Motion[Any]) -> None:
    """Refuse flights of vehicles with different input maps, inputs, or parameters.

    Raises
    ------
    PoolingError
        With the first difference that was found.
    """
    first = flights[0]
    for other in flights[1:]:
        what = _difference(first, other, motion)
        if what:
            raise PoolingError(
                f"flights of one vehicle: {first.recording.name} and {other.recording.name} alike",
                what,
                "Identify them one by one, or pool only those of one vehicle.",
            )


def _difference(first: PreparedFlight, other: PreparedFlight, motion: Motion[Any]) -> str:
    if first.input_map != other.input_map:
        return f"input maps {first.input_map} and {other.input_map}"
    if (first.input.name, first.input.measured) != (other.input.name, other.input.measured):
        return f"inputs {first.input.name} and {other.input.name}"
    if first.actuators != other.actuators:
        return f"{first.actuators} and {other.actuators} rotors"
    for name in motion.vehicle_parameters:
        values = [flight.recording.parameters.get(name) for flight in (first, other)]
        if values[0] != values[1]:
            return f"{name} = {values[0]} and {values[1]}"
    levels = [motion.input_level(flight) if flight.runs else float("nan") for flight in (first, other)]
    if all(np.isfinite(levels)) and max(levels) > LARGEST_INPUT_RATIO * min(levels):
        return f"inputs of {levels[0]:.4g} and {levels[1]:.4g} on average, which are not on one scale"
    return ""
