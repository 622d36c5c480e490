"""What the numbers of a vehicle may be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sized

from eivor.errors import ParameterError

_REMEDY = "Correct the vehicle's description."
#: By how much inertias may be those of no body before it is said: some that were published are by 1 %.
NO_BODY_ALLOWANCE = 0.05


def finite(name: str, *values: float) -> None:
    """Refuse NaN and infinity."""
    for value in values:
        if not math.isfinite(value):
            raise ParameterError(f"a finite {name}", f"{name}={value}", _REMEDY)


def positive(name: str, *values: float) -> None:
    """Refuse what is not finite and above zero."""
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise ParameterError(f"a finite {name} above zero", f"{name}={value}", _REMEDY)


def non_negative(name: str, *values: float) -> None:
    """Refuse what is not finite and zero or more."""
    for value in values:
        if not (math.isfinite(value) and value >= 0.0):
            raise ParameterError(f"a finite {name} of zero or more", f"{name}={value}", _REMEDY)


def triple(name: str, values: Sized) -> None:
    """Refuse what has not three numbers, one for each axis."""
    if len(values) != 3:
        raise ParameterError(f"three numbers for {name}, forward, left, up", f"{len(values)}", _REMEDY)


def within(given: object, ranges: Mapping[str, tuple[float, float]], remedy: str) -> None:
    """Refuse attributes that are out of their ranges."""
    for name, (low, high) in ranges.items():
        value = getattr(given, name)
        if not low <= value <= high:
            raise ParameterError(f"{name} between {low:g} and {high:g}", f"{value}", remedy)
