"""Words, numbers and strings of a result as a person reads them: shared by tables, cards and figures.

Conventions, settled here once:

* The interval decides the digits: its half-width is shown to two significant digits, and value and ends
  to the same decimal place.
* Lags are computed in seconds and shown in milliseconds.
* A string that came from a log or from the file system goes through `printable` before it is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from eivor.flights.result import FlightEstimate, Quantity

#: What to print where there is no number.
NO_NUMBER = "–"
#: Values outside this range are written with an exponent.
PLAIN_RANGE = (1e-3, 1e6)


@dataclass(frozen=True, slots=True)
class Wording:
    """How a quantity is called.

    Parameters
    ----------
    words : str
        In words.
    symbol : str
        As in the equation of motion.
    unit : str
        Shown unit; empty for the unit of the input.
    scale : float
        From the SI unit to the shown one.
    """

    words: str
    symbol: str
    unit: str
    scale: float = 1.0


#: Every quantity, in the order of reports.
QUANTITIES = {
    "viscous_friction": Wording("viscous friction", "K", "1/s"),
    "time_constant": Wording("time constant", "1/K", "s"),
    "input_gain": Wording("input gain", "K_u", "m/s²"),
    "hover_input": Wording("hover input", "u_h", ""),
    "effective_lag": Wording("effective lag", "τ + d", "ms", 1e3),
    "actuator_lag": Wording("actuator lag", "τ", "ms", 1e3),
    "delay": Wording("delay", "d", "ms", 1e3),
    "intercept": Wording("intercept", "b", "m/s²"),
}


def printable(text: str) -> str:
    r"""`text` with everything that a terminal or a figure would act on made visible.

    Control characters (the escape character, line breaks), marks that turn the reading direction and
    bytes that are no text become backslash escapes; letters of any script stay.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def numbers(quantity: Quantity, wording: Wording) -> tuple[str, str]:
    """Value and interval of a quantity in its shown unit, with digits that the interval supports.

    Returns
    -------
    value, interval : str
        "0.186" and "[0.162, 0.210]"; `NO_NUMBER` where there is none.
    """
    value = quantity.value * wording.scale
    low, high = (end * wording.scale for end in quantity.interval)
    bounded = math.isfinite(low) and math.isfinite(high)
    place = _decimal_place(0.5 * (high - low)) if bounded and high > low else _decimal_place(value, digits=4)
    exponent = _exponent(max(abs(x) for x in (value, low, high) if math.isfinite(x)) if bounded else value)
    shown = _number(value, place, exponent)
    if not bounded:
        return shown, NO_NUMBER
    return shown, f"[{_number(low, place, exponent)}, {_number(high, place, exponent)}]"


def _decimal_place(spread: float, digits: int = 2) -> int:
    """Number of decimals that shows `spread` to so many significant digits; negative left of the point."""
    if not math.isfinite(spread) or spread == 0.0:
        return 0
    return digits - 1 - math.floor(math.log10(abs(spread)))


def _exponent(size: float) -> int:
    """Power of ten to take out; zero for sizes that are read without one."""
    if not math.isfinite(size) or size == 0.0 or PLAIN_RANGE[0] <= abs(size) < PLAIN_RANGE[1]:
        return 0
    return math.floor(math.log10(abs(size)))


def _number(value: float, place: int, exponent: int) -> str:
    if not math.isfinite(value):
        return NO_NUMBER
    decimals = place + exponent
    rounded = round(value / 10.0**exponent, decimals) + 0.0  # plus zero: no "-0"
    return f"{rounded:.{max(decimals, 0)}f}" + (f"e{exponent}" if exponent else "")


def equation(result: FlightEstimate) -> tuple[str, str]:
    """Model in one line, and a line that says what U is."""
    flight = result.prepared[0]
    names = f"the mean of the mapped {flight.flight.input}" if _rotors(result) > 1 else flight.flight.input
    mapped = f"{names} (map: {flight.input_map})"
    moved = "measured, without lag" if flight.flight.measured else "behind a lag τ and a delay d"
    return "z'' + g = K_u U − K z' + b", f"U = cos(tilt) × {mapped}, {moved}"


def _rotors(result: FlightEstimate) -> int:
    flight = result.prepared[0].flight
    return int(flight.signals.family(flight.input).shape[1])


def instruments(result: FlightEstimate) -> str:
    """Instruments in words."""
    return "no instruments" if result.instruments == "none" else f"instruments: {result.instruments}"


def used(result: FlightEstimate) -> str:
    """How much of the flights was used, in one line."""
    flights = [flight for flight in result.prepared if flight.flight.runs]
    if not flights:
        return "no usable sample"
    runs = sum(len(flight.flight.runs) for flight in flights)
    seconds = sum(float(flight.used.sum()) * flight.flight.signals.step_s for flight in flights)
    rates = sorted({round(flight.flight.signals.rate_hz) for flight in flights})
    span = ""
    if result.window_s is not None:
        span = f" between {result.window_s[0]:.1f} and {result.window_s[1]:.1f} s"
    run = "one run" if runs == 1 else f"{runs} runs"
    return f"{seconds:.1f} s in {run}{span}, on a grid of {' and '.join(map(str, rates))} Hz"
