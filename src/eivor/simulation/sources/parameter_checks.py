"""Checks of the numbers that describe noises, disturbances and excitations."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from eivor.errors import ParameterError
from eivor.shapes import Float

REMEDY = "Correct it, or leave it out where it has a default."


def finite(name: str, *values: float) -> None:
    """Refuse NaN and infinity."""
    for value in values:
        require(math.isfinite(value), f"a finite {name}", f"{name}={value}")


def positive(name: str, *values: float) -> None:
    """Refuse what is not finite and above zero."""
    for value in values:
        require(math.isfinite(value) and value > 0.0, f"a finite {name} above zero", f"{name}={value}")


def non_negative(name: str, *values: float) -> None:
    """Refuse what is not finite and zero or more."""
    for value in values:
        require(math.isfinite(value) and value >= 0.0, f"a finite {name} of zero or more", f"{name}={value}")


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a count below `least`."""
    require(value >= least, f"{name} of {least} or more", f"{name}={value}")


def given(name: str, values: Iterable[object]) -> None:
    """Refuse an empty list."""
    require(bool(tuple(values)), f"one or more {name}", "none")


def equally_many(
    first: str, first_values: tuple[object, ...], other: str, others: tuple[object, ...]
) -> None:
    """Refuse lists of unequal length."""
    require(
        len(first_values) == len(others),
        f"as many {other} as {first}",
        f"{len(others)} {other} and {len(first_values)} {first}",
    )


def require(condition: bool, expected: str, received: str, remedy: str = REMEDY) -> None:
    """Raise ParameterError unless the condition holds."""
    if not condition:
        raise ParameterError(expected, received, remedy)


def beginning_of(values: tuple[float, ...], count: int) -> Float[np.ndarray, " count"]:
    """Beginning of a user's own series, which must be as long as the record."""
    require(
        len(values) >= count,
        f"a series of {count} values or more, as many as the record has samples",
        f"{len(values)}",
        "Give a longer one, or ask for fewer samples.",
    )
    return np.array(values[:count])
