"""The gain of the input over a flight: what tells it when the vehicle hardly moves.

In hover K_u U = g - b: the level of the input tells the gain as well as the intercept b is known, which is
that of an accelerometer's bias where the input map is right. Friction and intercept are the whole flight's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from eivor.flights.options import FlightOptions
from eivor.flights.quantity import Quantity
from eivor.flights.tracked import Followed
from eivor.inference.verdict import Status
from eivor.models.separable import Prior
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.model import GRAVITY

#: Friction of a multirotor of which nothing is known [1/s].
ANY_FRICTION = Prior(0.3, 0.3)


def followed_gain(
    problem: VerticalFlights, quantities: Mapping[str, Quantity], options: FlightOptions
) -> Followed:
    """Rows that tell K_u over a flight, and what is known of K and the intercept.

    Parameters
    ----------
    problem : VerticalFlights
        Of one flight.
    quantities : mapping of str to Quantity
        Of the flight as a whole.
    options : FlightOptions
        With the standard deviation of the accelerometer's bias.
    """
    found = quantities["viscous_friction"]
    friction = ANY_FRICTION
    source = "as of any multirotor: the flight does not tell it"
    if found.verdict is not Status.REFUSED and 0.0 < found.half_width < math.inf:
        friction = Prior(found.value, max(found.std_error, 0.5 * found.half_width))
        source = "as the whole flight tells it"
    bias = options.accelerometer_bias
    known_bias = math.isfinite(bias)
    intercept = Prior(-GRAVITY, bias) if known_bias else None
    level = (
        f"Intercept 0 ± {1.96 * bias:.2g} m/s²: the input map is right, and the accelerometer's bias small "
        "(--accelerometer-bias)."
        if known_bias
        else "Nothing is known of the intercept: only movement tells the gain."
    )
    return Followed(
        "input_gain",
        problem.runs,
        {"viscous_friction": friction},
        intercept,
        (f"Friction {friction.mean:.3g} ± {1.96 * friction.std:.2g} 1/s, {source}.", level),
    )
