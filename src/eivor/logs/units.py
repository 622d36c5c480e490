"""Units that a channel map may name, and what one of each is in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping

from eivor.signals.canonical import CanonicalChannel

#: Unit as written in a map: its SI unit, and how many of that one of it is.
UNITS: Mapping[str, tuple[str, float]] = {
    "": ("", 1.0),
    "1": ("", 1.0),
    "%": ("", 0.01),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "ft": ("m", 0.3048),
    "m/s": ("m/s", 1.0),
    "cm/s": ("m/s", 1e-2),
    "mm/s": ("m/s", 1e-3),
    "km/h": ("m/s", 1.0 / 3.6),
    "m/s^2": ("m/s^2", 1.0),
    "cm/s^2": ("m/s^2", 1e-2),
    "mm/s^2": ("m/s^2", 1e-3),
    "g": ("m/s^2", 9.80665),
    "mg": ("m/s^2", 9.80665e-3),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180.0),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "rpm": ("rad/s", math.pi / 30.0),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "N": ("N", 1.0),
    "us": ("us", 1.0),
}

#: Seconds in one unit of a clock.
TIME_UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def unit_fits(channel: CanonicalChannel, si_unit: str) -> bool:
    """Say whether a quantity of `si_unit` can be the channel."""
    return si_unit == channel.unit or channel.free_unit
