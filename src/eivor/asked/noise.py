"""What is typed of the measurement noise of channels."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from eivor.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from eivor.flights.declared_noise import Declared
    from eivor.signals.data_sheet import DataSheet

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf))\s*(.*)", re.IGNORECASE)
#: Words of a data sheet.
_SHEET = ("density", "bandwidth", "step")
_REMEDY = (
    "Give --noise velocity_z=0.02, with a unit where it is not SI (2cm/s), --noise "
    "velocity_z=density:0.002,bandwidth:50,step:0.01, or --noise estimate."
)


def noise(texts: Iterable[str]) -> Mapping[str, Declared] | str | None:
    """Noise by channel of ``NAME=STD``, ``NAME=density:D,bandwidth:HZ,step:S``, or ``estimate``.

    Parameters
    ----------
    texts : iterable of str
        Each with one channel or, between commas, several.

    Raises
    ------
    UsageError
        When it is none of them, the number is no standard deviation, or the unit is not the channel's.
    """
    from eivor.flights.declared_noise import ESTIMATE

    given = [text.strip() for text in texts]
    if not given:
        return None
    if ESTIMATE in given:
        if len(given) > 1:
            raise UsageError("--noise estimate alone", f"{len(given)} of --noise", "Leave out the others.")
        return ESTIMATE
    found: dict[str, Declared] = {}
    for text in given:
        for name, values in _by_name(text).items():
            if name in found:
                raise UsageError("the noise of a channel once", f"{name} twice", "Leave out one of them.")
            found[name] = _declared(name, values)
    return found


def _by_name(text: str) -> dict[str, list[str]]:
    """What is said of each channel: ``a=1,b=density:2,step:3`` is one thing of a and two of b."""
    parts: dict[str, list[str]] = {}
    name = ""
    for piece in text.split(","):
        before, equals, value = piece.partition("=")
        if equals:
            name = before.strip()
            if name in parts:
                raise UsageError("the noise of a channel once", f"{name} twice", "Leave out one of them.")
        else:
            value = piece
        if not name or not value.strip():
            raise UsageError("a noise NAME=STD", f"'{text}'", _REMEDY)
        parts.setdefault(name, []).append(value.strip())
    return parts


def _declared(name: str, values: list[str]) -> Declared:
    if len(values) == 1 and ":" not in values[0]:
        return _size(name, values[0], "standard deviation")
    return _sheet(name, values)


def _sheet(name: str, values: list[str]) -> DataSheet:
    from eivor.signals.data_sheet import DataSheet

    told: dict[str, float] = {}
    for value in values:
        word, colon, number = value.partition(":")
        word = word.strip()
        if not colon or word not in _SHEET:
            remedy = did_you_mean(word, _SHEET, _REMEDY)
            raise UsageError(f"of the data sheet of {name}: {', '.join(_SHEET)}", f"'{value}'", remedy)
        if word == "bandwidth":
            told["bandwidth_hz"] = _number(name, number.strip().removesuffix("Hz"), "bandwidth in Hz")[0]
        else:
            told[word] = _size(name, number, word)
    if not (told.get("density") or told.get("step")):
        raise UsageError(
            f"a noise density or a quantisation step above zero of the data sheet of {name}",
            f"'{','.join(values)}'",
            _REMEDY,
        )
    return DataSheet(**told)


def _number(name: str, text: str, what: str) -> tuple[float, str]:
    """A number of zero or more, and what stands behind it."""
    matched = _NUMBER.fullmatch(text)
    value = float(matched.group(1)) if matched else math.nan
    if matched is None or not 0.0 <= value < math.inf:
        raise UsageError(f"a {what} of zero or more for {name}", f"'{text}'", _REMEDY)
    return value, matched.group(2).strip()


def _size(name: str, text: str, what: str) -> float:
    """A size in the channel's SI unit; a noise density may be in its unit over the root of a hertz."""
    from eivor.logs.units import UNITS, unit_fits
    from eivor.signals.canonical import canonical_channel

    value, unit = _number(name, text, what)
    if what == "density":
        unit = unit.removesuffix("/sqrt(Hz)").removesuffix("/rtHz")
    if not unit:
        return value
    channel = canonical_channel(name)
    si_unit, to_si = UNITS.get(unit, ("", math.nan))
    if math.isnan(to_si) or (channel is not None and not unit_fits(channel, si_unit)):
        own = channel.unit if channel is not None else ""
        raise UsageError(
            f"a {what} of {name} in {own or 'its unit'}" + (", or a unit of that kind" if own else ""),
            f"'{text}', in {unit}",
            f"Units are {', '.join(word for word in UNITS if word)}.",
        )
    return value * to_si
