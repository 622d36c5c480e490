"""The supply behind commands: a battery whose voltage falls gives less thrust for the same command.

Gain and hover input are then means over the flight, and what changes with time looks like noise or like a
change of the vehicle. A log with the voltage tells by how much; one without leaves it open.
"""

from __future__ import annotations

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.signals.recording import Finding

VOLTAGE = "battery_voltage"
#: A fall by a larger share over the time used is told; thrust goes with its first or second power.
LARGE_FALL = 0.03
#: A flight without its voltage that is longer may have sagged as much [s].
LONG_S = 120.0
#: Ends of the time used whose medians are compared, as a share of it.
END_SHARE = 0.1


def supply_findings(flights: tuple[PreparedFlight, ...]) -> tuple[Finding, ...]:
    """What is known of the supply of flights by commands."""
    prefixed = len(flights) > 1
    found: list[Finding] = []
    for flight in flights:
        if flight.runs and not flight.input.measured:
            name = f"{flight.recording.name}: " if prefixed else ""
            found.extend(Finding(one.name, name + one.message) for one in _of_flight(flight))
    return tuple(found)


def _of_flight(flight: PreparedFlight) -> list[Finding]:
    start, end = flight.span_s
    channel = flight.recording.channels.get(VOLTAGE)
    within = np.zeros(0)
    if channel is not None:
        stamps, volts = channel.time_s, channel.values
        known = np.isfinite(volts) & (volts > 0.0) & (stamps >= start) & (stamps <= end)
        stamps, within = stamps[known], volts[known]
    if channel is None or within.size < 2.0 / END_SHARE:
        return [_not_logged(end - start)] if end - start > LONG_S else []
    margin = END_SHARE * (end - start)
    ends = within[stamps <= start + margin], within[stamps >= end - margin]
    if not all(one.size for one in ends):
        return []
    first, last = (float(np.median(one)) for one in ends)
    fall = 1.0 - last / first
    if fall <= LARGE_FALL:
        return []
    sentence = (
        f"The battery's voltage fell by {fall:.1%}, from {first:.3g} to {last:.3g} V: the same command gave "
        "less thrust at the end, and gain and hover input are means over the flight."
    )
    return [Finding("voltage_sag", sentence)]


def _not_logged(length_s: float) -> Finding:
    sentence = (
        f"No battery voltage is logged with {length_s / 60.0:.2g} minutes of flight: it may have sagged, "
        "and the same command then gives less thrust at the end. Log it."
    )
    return Finding("voltage_not_logged", sentence)
