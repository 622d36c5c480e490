"""Checks of arguments, with readable errors."""

from __future__ import annotations

import math
import os
import reprlib
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, get_type_hints

import numpy as np

from eivor.errors import DataError, ParameterError, UsageError, did_you_mean
from eivor.tools import Float

#: What counts as a real number by itself; booleans are no numbers.
NUMBERS = (int, float, np.integer, np.floating)
#: Largest number of 64 bits, which arrays are counted in.
LARGEST_WHOLE = 2**63 - 1
#: Letters of NumPy's types that are real numbers in arrays: booleans and whole numbers are converted.
REAL_KINDS = frozenset("biuf")


def kind(
    name: str, value: object, types: type | tuple[type, ...], expected: str, remedy: str = "Correct the call."
) -> None:
    """Refuse what is none of some types."""
    if not isinstance(value, types):
        raise UsageError(f"{expected} for {name}", described(value), remedy)


def text(name: str, value: object) -> None:
    """Refuse what is no text."""
    kind(name, value, str, "text")


def index_of(what: str, name: str, known: Iterable[str], remedy: str = "Name one of them.") -> int:
    """Position of a name among those that are known; refuse any other, and propose the nearest."""
    names = list(known)
    text("name", name)
    if name not in names:
        raise UsageError(f"{what} out of {', '.join(names)}", f"'{name}'", did_you_mean(name, names, remedy))
    return names.index(name)


def number(name: str, value: object) -> None:
    """Refuse what is no real number, and whole ones beyond the largest double; NaN and infinity are some."""
    if type(value) is float:
        return
    if isinstance(value, bool):
        raise UsageError(f"a number for {name}", described(value), "Correct the call.")
    kind(name, value, NUMBERS, "a number")
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise UsageError(f"a number below 1.8e308 for {name}", described(value), "Correct the call.")


def whole(name: str, value: object) -> None:
    """Refuse what is no whole number, and what no count of anything can be."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise UsageError(f"a whole number for {name}", described(value), "Correct the call.")
    if isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        raise UsageError(f"a whole number below 9.2e18 for {name}", described(value), "Correct the call.")


def counted(name: str, value: int, least: int, expected: str, remedy: str) -> None:
    """Refuse what is no whole number, or less than some."""
    whole(name, value)
    require(value >= least, expected, f"{value}", remedy)


def seed(value: int) -> None:
    """Refuse what is no seed."""
    counted("seed", value, 0, "a seed of zero or more", "Any such integer will do.")


def level(value: float) -> None:
    """Refuse a confidence level that is none."""
    number("level", value)
    require(0.0 < value < 1.0, "a confidence level between 0 and 1", f"{value}", "Use 0.95, for example.")


def path(name: str, value: object) -> None:
    """Refuse what is no path: a number would be taken for an open file."""
    kind(name, value, (str, os.PathLike), "a path, as a text or a Path", 'Give its text: "flight.ulg".')


def function(expected: str, value: object, remedy: str) -> None:
    """Refuse what cannot be called."""
    if not callable(value):
        raise UsageError(expected, described(value), remedy)


def flag(name: str, value: object) -> None:
    """Refuse what is neither true nor false."""
    kind(name, value, (bool, np.bool_), "True or False")


def items(
    name: str,
    values: object,
    types: type | tuple[type, ...],
    expected: str,
    remedy: str = "Correct the call.",
) -> None:
    """Refuse what is no tuple or list of some types."""
    kind(name, values, (tuple, list), f"a tuple of {expected}", remedy)
    assert isinstance(values, tuple | list)  # noqa: S101 - `kind` has refused anything else
    for value in values:
        if not isinstance(value, types):
            raise UsageError(f"a tuple of {expected} for {name}", f"{described(value)} in it", remedy)


def texts(name: str, values: object, remedy: str = "Correct the call.") -> None:
    """Refuse what are no several texts; a single one would be taken for its letters."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise UsageError(f"several texts for {name}", described(values), remedy)
    for value in values:
        if not isinstance(value, str):
            raise UsageError(f"several texts for {name}", f"{described(value)} among them", remedy)


def mapping(name: str, value: object, types: type | tuple[type, ...], expected: str) -> None:
    """Refuse what is no mapping from texts to some types."""
    expected = f"a mapping of names to {expected}"
    kind(name, value, Mapping, expected, "Give a dictionary.")
    assert isinstance(value, Mapping)  # noqa: S101 - `kind` has refused anything else
    for key, item in value.items():
        if not isinstance(key, str) or not isinstance(item, types):
            received = f"{described(item)} for {described(key)}"
            raise UsageError(f"{expected} for {name}", received, "Correct the call.")


def real_array(name: str, values: Any) -> Float[np.ndarray, "*shape"]:
    """Array in double precision; what a mask hides is NaN, as it is no value."""
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    try:
        array = _unmasked(values)
        if array.dtype.kind == "O" and not any(isinstance(item, str | bytes) for item in array.flat):
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"real numbers in {name}", f"{error}", "Convert them first.") from error
    if array.dtype.kind not in REAL_KINDS:
        complex_numbers = array.dtype.kind == "c"
        received = "complex ones" if complex_numbers else f"values of the type {array.dtype}"
        remedy = "Take their real part or their absolute value." if complex_numbers else "Convert them first."
        raise DataError(f"real numbers in {name}", received, remedy)
    return np.asarray(array, dtype=np.float64)


def _unmasked(values: Any) -> np.ndarray:
    """Array of what is given, NaN where it is masked."""
    parts = values if isinstance(values, list | tuple) else ()
    if not (np.ma.isMaskedArray(values) or any(np.ma.isMaskedArray(part) for part in parts)):
        return np.asarray(values)
    masked = np.ma.masked_array(values)
    if masked.dtype.kind not in REAL_KINDS:
        return np.asarray(masked.data)
    return np.where(np.ma.getmaskarray(masked), np.nan, masked.data.astype(np.float64))


def described(value: object) -> str:
    """A value in a few characters, and its type."""
    return f"{reprlib.repr(value)} ({type(value).__name__})"


# -- Ranges of parameters --

REMEDY = "Correct it, or leave it out where it has a default."


def require(condition: bool, expected: str, received: str, remedy: str = REMEDY) -> None:
    """Raise ParameterError unless the condition holds."""
    if not condition:
        raise ParameterError(expected, received, remedy)


def finite(name: str, *values: float, remedy: str = REMEDY) -> None:
    """Refuse NaN and infinity."""
    for value in values:
        require(math.isfinite(value), f"a finite {name}", f"{name}={value}", remedy)


def positive(name: str, *values: float, remedy: str = REMEDY) -> None:
    """Refuse what is not finite and above zero."""
    for value in values:
        sound = math.isfinite(value) and value > 0.0
        require(sound, f"a finite {name} above zero", f"{name}={value}", remedy)


def non_negative(name: str, *values: float, remedy: str = REMEDY) -> None:
    """Refuse what is not finite and zero or more."""
    for value in values:
        sound = math.isfinite(value) and value >= 0.0
        require(sound, f"a finite {name} of zero or more", f"{name}={value}", remedy)


def given(name: str, *values: object, remedy: str = REMEDY) -> None:
    """Refuse an empty list."""
    require(bool(values), f"one or more {name}", "none", remedy)


def between(name: str, value: object, low: float, high: float, remedy: str) -> None:
    """Refuse what is no number, or out of its range."""
    number(name, value)
    assert isinstance(value, NUMBERS)  # noqa: S101 - `number` has refused anything else
    require(bool(low <= value <= high), f"{name} between {low:g} and {high:g}", f"{float(value):g}", remedy)


@cache
def annotated(made_by: Callable[..., object]) -> dict[str, tuple[Any, ...]]:
    """What a class annotates its fields with, beside their types."""
    hints = get_type_hints(made_by, include_extras=True)
    return {name: hint.__metadata__ for name, hint in hints.items() if hasattr(hint, "__metadata__")}


def in_ranges(checked: object, remedy: str = REMEDY) -> None:
    """Refuse attributes that are not as they are annotated: with a range, or with checks of this module.

    Such as `Annotated[float, (0.0, 1.0)]`, `Annotated[float, positive]`, or `Annotated[tuple[float, ...],
    given, (finite, "level")]` with the word for one of several.
    """
    made_by: Callable[..., object] = type(checked)
    for name, rules in annotated(made_by).items():
        value = getattr(checked, name)
        values = value if isinstance(value, tuple) else (value,)
        for rule in rules:
            if callable(rule):
                rule(name, *values, remedy=remedy)
            elif callable(rule[0]):
                rule[0](rule[1], *values, remedy=remedy)
            else:
                between(name, value, rule[0], rule[1], remedy)
