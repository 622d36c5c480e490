"""Pooling: which flights may share one set of parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eivor.errors import PoolingError
from eivor.flights.prepare import PreparedFlight
from eivor.signals.recording import Finding, Recording

#: Logged parameters that stand for the vehicle and the path from thrust setpoint to rotors.
VEHICLE_PARAMETERS = (
    "SYS_AUTOSTART",
    "THR_MDL_FAC",
    "CA_ROTOR_COUNT",
    "MOT_POLE_COUNT",
    "PWM_MIN",
    "PWM_MAX",
    "PWM_MAIN_MIN",
    "PWM_MAIN_MAX",
)
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


def check_poolable(flights: tuple[PreparedFlight, ...]) -> None:
    """Refuse flights of vehicles with different input maps, inputs, or parameters.

    Raises
    ------
    PoolingError
        With the first difference that was found.
    """
    first = flights[0]
    for other in flights[1:]:
        what = _difference(first, other)
        if what:
            raise PoolingError(
                f"flights of one vehicle: {first.recording.name} and {other.recording.name} alike",
                what,
                "Identify them one by one, or pool only those of one vehicle.",
            )


def _difference(first: PreparedFlight, other: PreparedFlight) -> str:
    if first.input_map != other.input_map:
        return f"input maps {first.input_map} and {other.input_map}"
    if (first.flight.input, first.flight.measured) != (other.flight.input, other.flight.measured):
        return f"inputs {first.flight.input} and {other.flight.input}"
    rotors = [flight.flight.signals.family(flight.flight.input).shape[1] for flight in (first, other)]
    if rotors[0] != rotors[1]:
        return f"{rotors[0]} and {rotors[1]} rotors"
    for name in VEHICLE_PARAMETERS:
        values = [flight.recording.parameters.get(name) for flight in (first, other)]
        if values[0] != values[1]:
            return f"{name} = {values[0]} and {values[1]}"
    means = [abs(mean) for mean in (_mean_input(first), _mean_input(other))]
    if all(np.isfinite(means)) and max(means) > LARGEST_INPUT_RATIO * min(means):
        return f"inputs of {means[0]:.4g} and {means[1]:.4g} on average, which are not on one scale"
    return ""


def _mean_input(prepared: PreparedFlight) -> float:
    """Mean of the input over the samples used; NaN when there are none."""
    if not prepared.flight.runs:
        return float("nan")
    values = prepared.flight.signals.family(prepared.flight.input)[prepared.used]
    return float(values.mean())
