"""Terms that a user adds to the equation of a motion, out of those that the motion has."""

from __future__ import annotations

from typing import Any

from eivor.errors import UsageError, did_you_mean
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions


def check_options(motion: Motion[Any], options: FlightOptions) -> None:
    """Refuse options that a motion does not have, its optional terms among them.

    Raises
    ------
    UsageError
        With what there is.
    """
    unknown = [word for word in options.terms if word not in motion.terms]
    if unknown:
        known = ", ".join(motion.terms)
        raise UsageError(
            f"terms out of {known}" if known else f"no optional terms: '{motion.name}' has none",
            ", ".join(f"'{word}'" for word in unknown),
            did_you_mean(unknown[0], motion.terms, "Leave it out."),
        )
    twice = sorted({word for word in options.terms if options.terms.count(word) > 1})
    if twice:
        raise UsageError("each term once", f"{', '.join(twice)} twice", "Name it once.")
    motion.check(options)
