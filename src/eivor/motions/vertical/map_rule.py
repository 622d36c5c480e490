"""Grounds against an input map: an intercept that says that thrust grows with another power of the command.

With m the map's own exponent at hover, d ln U / d ln w, and hover balanced by g = K_u U_h + b, thrust goes as
w^p with p = m K_u U_h / g = m (1 - b / g).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.circumstances import Circumstances
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason, Status
from eivor.motions.vertical.curve_rule import CLEAR_INTERCEPT
from eivor.motions.vertical.left_out import CURVATURE, PREFIX
from eivor.motions.vertical.model import GRAVITY

LEAST_EXPONENT = 0.95
#: A map does not fit below this p-value.
FITS = 0.05
#: The bend is told beside the intercept below this p-value.
BENDS = 0.1
#: Numbers of this motion among those of the circumstances: the least intercept in its set, the p-value of
#: the test that the map fits, the exponent of thrust near hover, that of the input map there, and one for a
#: command of thrust: a linear or mixed map.
LEAST_INTERCEPT, MAP_P_VALUE = "least_intercept", "input_map_p_value"
THRUST_EXPONENT, MAP_EXPONENT, IS_THRUST = "thrust_exponent", "map_exponent", "thrust_command"


def thrust_curve_reasons(quantities: Mapping[str, Unjudged], at: Circumstances) -> list[Reason]:
    """Grounds against the gain: intercept and bend that say that the input map is another one."""
    intercept = quantities["intercept"]
    exponent = at.numbers.get(THRUST_EXPONENT, np.nan)
    if not (at.numbers.get(MAP_P_VALUE, 1.0) < FITS and np.isfinite(exponent)):
        return []
    told = (
        f"The intercept is {intercept.value:+.2g} m/s^2, which an input map that fits does not leave: near "
        f"hover thrust grows as the command to the power {exponent:.2f}, and the map says "
        f"{at.numbers[MAP_EXPONENT]:.2f}.{_bend(intercept, at)}"
    )
    return [Reason(Status.WEAK, told, _fitting_map(exponent, quantities["hover_input"].value, at))]


def intercept_reasons(quantities: Mapping[str, Unjudged], at: Circumstances) -> list[Reason]:
    """Grounds against the hover input: the same, of an intercept that is clear without the bend.

    The flight hovers within what it has flown: a curve that only bends there moves the balance little.
    """
    intercept = quantities["intercept"]
    least = at.numbers.get(LEAST_INTERCEPT, abs(intercept.value) - intercept.half_width)
    return thrust_curve_reasons(quantities, at) if least > CLEAR_INTERCEPT else []


def _bend(intercept: Unjudged, at: Circumstances) -> str:
    """What the bend of the thrust curve adds to that, with a blank before it; empty for nothing.

    With thrust as the power p and a map of the exponent m, a curve over the mapped input bends by
    (p / m - 1) / 2 = -b / (2 g), as a share of the gain.
    """
    name = f"{PREFIX}{CURVATURE}"
    bend, half = at.numbers.get(name, np.nan), at.numbers.get(f"{name}_half_width", np.nan)
    if not (at.numbers.get(f"{name}_p_value", 1.0) < BENDS and bend * intercept.value < 0.0):
        return ""
    of_power, uncertain = -intercept.value / (2.0 * GRAVITY), intercept.half_width / (2.0 * GRAVITY)
    told = f" The curve bends as well ({bend:+.2g} ± {half:.2g})"
    if bend + half < of_power - uncertain:
        return f"{told}, more than such a power does ({of_power:+.2g}): so does thrust that sags under load."
    return f"{told}."


def _fitting_map(exponent: float, hover: float, at: Circumstances) -> str:
    """The input map that has an exponent near hover."""
    if exponent < LEAST_EXPONENT:
        return (
            "No propeller's thrust grows so slowly: look for a supply that sags under load, and check that "
            "the input is the command of this vehicle."
        )
    if at.numbers[IS_THRUST] and 1.0 < exponent < 2.0 and 0.0 < hover < 1.0:
        # (1 - s) u + s u^2 has the exponent r at u_h for s = (r - 1) / ((r - 1) + (2 - r) u_h)
        share = (exponent - 1.0) / ((exponent - 1.0) + (2.0 - exponent) * hover)
        return f"Use --input-map mixed:{share:.2g} if nothing else is wrong; a sagging supply looks alike."
    known = {1.0: "linear", 2.0: "square"}.get(round(exponent, 1), f"power:{exponent:.2g}")
    return f"Use --input-map {known} if nothing else is wrong; a supply that sags under load looks alike."
