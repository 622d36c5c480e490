"""Units of expressions: every term of an equation must have the unit of its response."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np

from eivor.errors import did_you_mean
from eivor.logs.channel_map import CONDITIONS, Expression, InTime
from eivor.logs.common import UNITS

#: Powers of base units; none of a pure number. Angles are pure numbers, as in SI.
Unit = Mapping[str, Fraction]

#: What units that are products of others are made of.
_MADE_OF = {"N": "kg m/s^2", "J": "kg m^2/s^2", "W": "kg m^2/s^3", "Pa": "kg/m/s^2", "Hz": "1/s"}
_MADE_OF |= {"rad": "", "1": ""}
_BASE = ("kg", "m", "s", "A", "V", "K", "degC", "us")
#: Products that are shown by a name.
_SHOWN = {"kg m/s^2": "N", "kg m^2/s^2": "N m", "kg/s": "N s/m", "kg m^2/s": "N m s"}
_FACTOR = re.compile(r"\s*([*/·]?)\s*([A-Za-z]+|1)(?:\^(-?\d)|([²³]))?")


class UnitError(ValueError):
    """Units that do not fit, in words; the second argument says what to do."""


def parsed_unit(text: str) -> Unit:
    """Powers of base units of a text such as ``rad/s^2`` or ``N m``."""
    powers: dict[str, Fraction] = {}
    offset, stripped = 0, text.strip()
    while offset < len(stripped):
        match = _FACTOR.match(stripped, offset)
        if match is None:
            raise UnitError(f"the unit '{text}'", "Write it as m/s^2, N m or 1/s.")
        sign, name, digits, raised = match.groups()
        power = int(digits or {"²": 2, "³": 3}.get(raised, 1)) * (-1 if sign == "/" else 1)
        if name in _MADE_OF:
            powers = dict(_times(powers, parsed_unit(_MADE_OF[name]) if name != "1" else {}, power))
        elif name in _BASE:
            powers = dict(_times(powers, {name: Fraction(1)}, power))
        else:
            si = UNITS.get("deg" if name.startswith("degree") else name, ("", 0.0))[0]
            remedy = f"Give it in {si}, and convert in a channel map." if si else "Units are those of SI."
            names = (*_BASE, *_MADE_OF)
            raise UnitError(f"the unit '{text}'", remedy if si else did_you_mean(name, names, remedy))
        offset = match.end()
    return powers


def _times(first: Unit, other: Unit, power: int | Fraction = 1) -> Unit:
    names = dict.fromkeys((*first, *other))
    result = {name: first.get(name, Fraction(0)) + power * other.get(name, Fraction(0)) for name in names}
    return {name: value for name, value in result.items() if value}


def over(above: Unit, below: Unit) -> Unit:
    """Quotient of two units."""
    return _times(above, below, -1)


def unit_text(unit: Unit) -> str:
    """A unit as it is written; empty for a pure number."""
    order = [name for name in _BASE if name in unit]

    def factor(name: str, power: Fraction) -> str:
        return name if power == 1 else f"{name}^{power}"

    above = " ".join(factor(name, unit[name]) for name in order if unit[name] > 0)
    below = "".join(f"/{factor(name, -unit[name])}" for name in order if unit[name] < 0)
    text = (above or ("1" if below else "")) + below
    return _SHOWN.get(text, text)


_LIKE = {np.add, np.subtract, np.maximum, np.minimum, np.hypot, np.arctan2}
_CONDITIONS = set(CONDITIONS.values())
_KEEPING = {np.negative, np.absolute}
_PURE_RESULT = {np.sign, np.arctan2, *_CONDITIONS}
_LOGICAL = {np.logical_and, np.logical_or, np.logical_not}


def unit_of(expression: Expression, units: Mapping[str, Unit]) -> tuple[Unit, bool]:
    """Unit of an expression over columns of known units, and whether a number is it, or a factor of it."""
    stack: list[tuple[Unit, float | None]] = []
    scaled = not expression.columns
    for step in expression.steps:
        if isinstance(step, str):
            stack.append((units[step], None))
        elif isinstance(step, float):
            stack.append(({}, step))
        elif isinstance(step, InTime):
            unit, _ = stack.pop()
            stack.append((_times(unit, {"s": Fraction(1)}, -1) if step.lag_s is None else unit, None))
        else:
            arguments = [stack.pop() for _ in range(step.nin)][::-1]
            scaled |= step in (np.multiply, np.divide) and any(number is not None for _, number in arguments)
            number = None if any(item is None for _, item in arguments) else math.nan
            stack.append((_result(step, arguments, expression.text), number))
    return stack.pop()[0], scaled


def _result(step: np.ufunc, arguments: Sequence[tuple[Unit, float | None]], text: str) -> Unit:
    first, last = arguments[0][0], arguments[-1][0]
    if step in (np.multiply, np.divide):
        return _times(first, last, 1 if step is np.multiply else -1)
    exponent = 0.5 if step is np.sqrt else arguments[1][1] if step is np.power else None
    if exponent is not None and math.isfinite(exponent):
        return {name: value * Fraction(exponent).limit_denominator(8) for name, value in first.items()}
    if step in _LIKE or (step in _CONDITIONS and step not in _LOGICAL):
        kinds = [unit for unit, number in arguments if number is None]
        if any(unit != kinds[0] for unit in kinds):
            pair = " and ".join(unit_text(unit) or "a pure number" for unit in kinds)
            raise UnitError(f"'{text}', which joins {pair}", "Give both the same unit.")
        return {} if step in _PURE_RESULT or not kinds else kinds[0]
    if step in _KEEPING:
        return first
    if step in _PURE_RESULT or step in _LOGICAL:
        return {}
    if any(unit for unit, _ in arguments):
        received = f"'{text}', with {step.__name__} of {unit_text(first or last)}"
        raise UnitError(received, "Divide by a scale of that unit first.")
    return {}
