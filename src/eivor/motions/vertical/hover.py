"""The hover input beside what the autopilot itself holds it to be: a parameter, and an estimate in flight.

PX4 estimates its hover thrust within MPC_THR_HOVER -+ HTE_THR_RANGE, beginning at MPC_THR_HOVER. What stands
at one of these ends, or has just begun to move, says nothing of the vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity
from eivor.inference.verdict import Status
from eivor.shapes import Bool, Float
from eivor.signals.canonical import CurveSide
from eivor.signals.recording import Channel, Finding

#: Parameters in which an autopilot keeps its own idea of the hover input.
HOVER_PARAMETERS = ("MPC_THR_HOVER", "MOT_THST_HOVER")
#: A logged hover parameter that is off by more than this share is pointed out.
HOVER_DISAGREEMENT = 0.15

START, RANGE, ESTIMATE = "MPC_THR_HOVER", "HTE_THR_RANGE", "hover_thrust_estimate"
#: The ends that the range is cut to, lower and upper.
LOWER_END, UPPER_END = (0.0, 0.8), (0.2, 0.9)
#: An estimate so near to an end stands at it, and one so near to its start has not left it.
NEAR_END, NEAR_START = 0.01, 1e-3
#: So long after leaving its start it is still on its way [s].
ON_ITS_WAY_S = 2.0
#: An estimate stands at an end when it is there for this share of the time used.
AT_END_SHARE = 0.5


def hover_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> tuple[Finding, ...]:
    """What the autopilots of flights hold their hover input to be; compared where it is identified."""
    flying = [flight for flight in flights if flight.runs and _is_setpoint(flight)]
    found = [one for flight in flying for one in _standing_at_an_end(flight)]
    hover = quantities["hover_input"]
    if hover.verdict is Status.IDENTIFIED and np.isfinite(hover.value) and flying:
        found.extend(_of_parameters(flying[0], hover.value))
        found.extend(_of_estimates(flying, hover))
    return tuple(found)


def _is_setpoint(flight: PreparedFlight) -> bool:
    """Whether the input is a thrust setpoint, which the autopilot's hover input is a value of."""
    unknown = flight.curve_side is CurveSide.UNKNOWN
    return flight.curve_side is CurveSide.BEFORE or (unknown and flight.input.name == "input")


def _of_parameters(flight: PreparedFlight, hover: float) -> list[Finding]:
    logged = {name: flight.recording.parameters.get(name) for name in HOVER_PARAMETERS}
    return [
        Finding(
            "hover_parameter",
            f"The log's own {name} is {value:.3g}, but this vehicle hovered at {hover:.3g}.",
        )
        for name, value in logged.items()
        if value and abs(hover / value - 1.0) > HOVER_DISAGREEMENT
    ]


def _of_estimates(flights: list[PreparedFlight], hover: Quantity) -> list[Finding]:
    told = [comparable_estimates(flight) for flight in flights]
    values = np.concatenate(told) if told else np.empty(0)
    if not values.size:
        return []
    median = float(np.median(values))
    off = hover.value / median - 1.0
    side = "more" if off > 0.0 else "less"
    return [
        Finding(
            "hover_estimate",
            f"The autopilot's own estimate of the hover thrust is {median:.3g} (median of {values.size} "
            f"samples); this vehicle hovered at {hover.value:.3g}, {abs(off):.1%} {side}.",
        )
    ]


def comparable_estimates(flight: PreparedFlight) -> Float[np.ndarray, " _"]:
    """Samples of the autopilot's estimate while the flight was used, that say something of the vehicle."""
    channel = flight.recording.channels.get(ESTIMATE)
    if channel is None:
        return np.empty(0)
    within = _within(flight, channel)
    for low, high, _ in _ends(flight):
        within &= ~((channel.values >= low) & (channel.values <= high))
    start = flight.recording.parameters.get(START)
    if start is not None:
        with np.errstate(invalid="ignore"):
            left = np.flatnonzero(np.abs(channel.values - start) > NEAR_START)
        since = channel.time_s[left[0]] if left.size else np.inf
        within &= channel.time_s >= since + ON_ITS_WAY_S
    return np.asarray(channel.values[within])


def _within(flight: PreparedFlight, channel: Channel) -> Bool[np.ndarray, " n"]:
    """Valid samples in the stretch of time that was used."""
    first, last = flight.span_s
    return np.isfinite(channel.values) & (channel.time_s >= first) & (channel.time_s <= last)


def _ends(flight: PreparedFlight) -> list[tuple[float, float, str]]:
    """Lowest and highest value that stands at each end of the estimate's range, and the end in words."""
    logged = flight.recording.parameters
    start, reach = logged.get(START), logged.get(RANGE)
    if start is None or reach is None:
        return []
    low, high = float(np.clip(start - reach, *LOWER_END)), float(np.clip(start + reach, *UPPER_END))
    return [
        (-np.inf, low + NEAR_END, f"lower limit, {low:.3g} ({START} - {RANGE})"),
        (high - NEAR_END, np.inf, f"upper limit, {high:.3g} ({START} + {RANGE})"),
    ]


def _standing_at_an_end(flight: PreparedFlight) -> list[Finding]:
    channel = flight.recording.channels.get(ESTIMATE)
    if channel is None:
        return []
    values = channel.values[_within(flight, channel)]
    return [
        Finding(
            "hover_estimate_at_limit",
            f"The autopilot's own estimate of the hover thrust stood at its {words}: it is not compared.",
        )
        for low, high, words in _ends(flight)
        if values.size and np.mean((values >= low) & (values <= high)) > AT_END_SHARE
    ]
