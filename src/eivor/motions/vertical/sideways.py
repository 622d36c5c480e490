"""Grounds from fast sideways flight: an attitude that may lean, and air that crosses the rotors."""

from __future__ import annotations

import numpy as np

from eivor.flights.circumstances import Circumstances
from eivor.inference.verdict import Reason, Status
from eivor.motions.vertical.sensors import TILTS

#: Root mean square of the horizontal speed [m/s]; from where on a tilt between attitude and accelerometer
#: matters, and how well it must be known [rad].
SIDEWAYS = "sideways_speed"
FAST_SIDEWAYS = 3.0
TILT_KNOWN = float(np.deg2rad(1.5))


def sideways_reasons(at: Circumstances) -> list[Reason]:
    """Ground against the friction: fast sideways flight, with an attitude that may lean."""
    speed = at.numbers.get(SIDEWAYS, np.nan)
    if not speed > FAST_SIDEWAYS:
        return []
    tilts = {tilt.name for tilt in TILTS.values()}
    known = {} if at.sensors is None else at.sensors.differences
    widths = [one.half_width for name, one in known.items() if name in tilts]
    if widths and max(widths) <= TILT_KNOWN:
        return []
    degrees = f"to ±{np.rad2deg(max(widths)):.1f} degrees only" if widths else "not at all"
    return [
        Reason(
            Status.WEAK,
            f"The vehicle flew sideways at {speed:.1f} m/s (rms), and the angle between attitude and "
            f"accelerometer is known {degrees}.",
            "Fly up and down without sideways motion, or sideways at other times than up and down.",
        )
    ]


def fast_sideways_reasons(at: Circumstances) -> list[Reason]:
    """Ground against the gain: air that crosses the rotors fast changes what they give."""
    speed = at.numbers.get(SIDEWAYS, np.nan)
    if not speed > FAST_SIDEWAYS:
        return []
    return [
        Reason(
            Status.WEAK,
            f"The vehicle flew sideways at {speed:.1f} m/s (rms): rotors give another thrust in air that "
            "crosses them, and the gain takes it up.",
            "Fly up and down without fast sideways motion.",
        )
    ]
