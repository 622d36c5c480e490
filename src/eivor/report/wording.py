"""Numbers in words, the flight card and advice on logging."""

from __future__ import annotations

import math
from typing import Any

from eivor.flights.motion import Motion
from eivor.flights.quantity import CardSection, Choice, Quantity, Wording
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.logs.read import log_format
from eivor.signals.recording import Recording

# -- Card --


def flight_card(result: FlightEstimate) -> tuple[CardSection, ...]:
    """What to fly and log instead; empty when the flight is identified."""
    if result.verdict.status is Status.IDENTIFIED:
        return ()
    return result.motion.advice(result.prepared[0].recording.format)


def missing_channels(recording: Recording, motion: Motion[Any]) -> tuple[str, ...]:
    """Channels without which the motion cannot be identified, and that the log lacks."""
    missing = [name for name in motion.needed if name not in recording.channels]
    if not any(recording.family(family.name) for family in motion.inputs):
        missing.append("input")
    return tuple(missing)


def logging_advice_for(recording: Recording, channel: str) -> tuple[str, ...]:
    """What to log so that `channel` is there; empty for logs whose format has no advice."""
    known = log_format(recording.format)
    return known.advice(channel) if known is not None else ()


# -- Wording --

#: What to print where there is no number.
NO_NUMBER = "–"
#: Values outside this range are written with an exponent.
PLAIN_RANGE = (1e-3, 1e6)


def numbers(quantity: Quantity, wording: Wording) -> tuple[str, str]:
    """Value and interval of a quantity in its shown unit, with digits that the interval supports.

    Returns
    -------
    value, interval : str
        "0.186" and "[0.162, 0.210]"; `NO_NUMBER` where there is none. What was chosen out of a few values
        has those that fit in place of an interval: "0 or 10 (5 tried)".
    """
    if quantity.choice is not None:
        return f"{quantity.value * wording.scale:g}", _choice(quantity.choice, wording.scale)
    low, high = quantity.interval
    return plain_numbers(quantity.value * wording.scale, (low * wording.scale, high * wording.scale))


def plain_numbers(value: float, interval: tuple[float, float]) -> tuple[str, str]:
    """Value and interval as `numbers` shows them, of numbers in the unit that is shown."""
    low, high = interval
    bounded = math.isfinite(low) and math.isfinite(high)
    position = _decimals(0.5 * (high - low)) if bounded and high > low else _decimals(value, digits=4)
    exponent = _exponent(max(abs(x) for x in (value, low, high) if math.isfinite(x)) if bounded else value)
    number = _number(value, position, exponent)
    if not bounded:
        return number, NO_NUMBER
    return number, f"[{_number(low, position, exponent)}, {_number(high, position, exponent)}]"


def _choice(choice: Choice, scale: float) -> str:
    """Values that fit, and out of how many; nothing to choose is no number."""
    if len(choice.tried) < 2:
        return NO_NUMBER
    *others, last = [f"{value * scale:g}" for value in choice.fitting]
    fitting = f"{', '.join(others)} or {last}" if others else last
    return f"{fitting} ({len(choice.tried)} tried)"


def _decimals(spread: float, digits: int = 2) -> int:
    """Number of decimals that shows `spread` to so many significant digits; negative left of the point."""
    if not math.isfinite(spread) or spread == 0.0:
        return 0
    return digits - 1 - math.floor(math.log10(abs(spread)))


def _exponent(size: float) -> int:
    """Power of ten to take out; zero for sizes that are read without one."""
    if not math.isfinite(size) or size == 0.0 or PLAIN_RANGE[0] <= abs(size) < PLAIN_RANGE[1]:
        return 0
    return math.floor(math.log10(abs(size)))


def _number(value: float, position: int, exponent: int) -> str:
    if not math.isfinite(value):
        return NO_NUMBER
    decimals = position + exponent
    rounded = round(value / 10.0**exponent, decimals) + 0.0  # plus zero: no "-0"
    return f"{rounded:.{max(decimals, 0)}f}" + (f"e{exponent}" if exponent else "")


def used(result: FlightEstimate) -> str:
    """How much of the flights was used, in one line."""
    flights = [flight for flight in result.prepared if flight.runs]
    if not flights:
        return "no usable sample"
    runs = sum(len(flight.runs) for flight in flights)
    seconds = sum(flight.used_s for flight in flights)
    rates = sorted({round(flight.signals.rate_hz) for flight in flights})
    span = ""
    if result.window_s is not None:
        span = f" between {result.window_s[0]:.1f} and {result.window_s[1]:.1f} s"
    run = "one run" if runs == 1 else f"{runs} runs"
    return f"{seconds:.1f} s in {run}{span}, on a grid of {' and '.join(map(str, rates))} Hz"
