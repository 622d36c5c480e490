"""What a user knows beside a flight, as it is typed: mass, priors, vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from eivor.errors import UsageError

if TYPE_CHECKING:
    from eivor.exports.fitted import Supplied
    from eivor.motions.rigid_body.known_number import KnownNumber


def supplied(mass: str, priors: Sequence[str], vehicle: str) -> Supplied:
    """What is known beside a flight, of ``KG[:STD]``, ``NAME=VALUE[:STD]`` and a vehicle's name or file.

    Raises
    ------
    UsageError
        When one is no such text, or no such number can be.
    InputError
        When the vehicle cannot be read.
    """
    from eivor.exports.fitted import Supplied
    from eivor.motions.rigid_body.vehicle_file import load_vehicle

    known = {}
    for text in priors:
        name, equals, number = text.partition("=")
        if not equals:
            raise UsageError("a prior NAME=VALUE:STD", f"'{text}'", "Give delay=0.01:0.002, for example.")
        known[name.strip()] = _known(number, "--prior")
    return Supplied(
        _known(mass, "--mass") if mass else None, known, load_vehicle(vehicle) if vehicle else None
    )


def _known(text: str, option: str) -> KnownNumber:
    """Number of ``VALUE`` or ``VALUE:STD``."""
    from eivor.exports.fitted import known_number

    value_text, colon, std_text = text.partition(":")
    try:
        value, std = float(value_text), float(std_text) if colon else 0.0
    except ValueError:
        value = std = math.nan
    if not math.isfinite(value):
        raise UsageError(f"VALUE or VALUE:STD for {option}", f"'{text}'", "Give 1.53:0.02, for example.")
    return known_number(value, std)
