"""Grounds against a curve of thrust that was found out.

Identified asks for a half-width of at most .15, of an exponent as of a share, and for a curve that a
propeller can have; a half-width of half the range of shares tells nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.circumstances import Circumstances
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason, Status

CURVE_HALF_WIDTH = 0.15
UNTOLD_HALF_WIDTH = 0.5
#: An intercept clearly beyond it is no bias of an accelerometer [m/s^2].
CLEAR_INTERCEPT = 0.4

STRONGER = "Fly quicker and larger steps, which change the thrust more."
CHECK_INPUT = "Check units and signs, and that the input is the command of this vehicle."
BIAS = "Say how large the accelerometer's bias may be: --accelerometer-bias 0.1 (m/s^2)."


def curve_reasons(quantities: Mapping[str, Unjudged], at: Circumstances) -> list[Reason]:
    """Grounds against the curve; none where it was not asked for."""
    curve = quantities.get("thrust_curve")
    if curve is None:
        return []
    if not np.isfinite(curve.half_width):
        untold = (
            "Curvature alone does not tell the thrust curve, and the intercept cannot while nothing is known "
            "of the accelerometer's bias."
        )
        return [Reason(Status.REFUSED, untold, BIAS)]
    intercept = quantities["intercept"]
    left = abs(intercept.value) - intercept.half_width
    if np.isfinite(left) and left > CLEAR_INTERCEPT:
        none = (
            f"No thrust curve of this kind fits: the intercept is still {intercept.value:+.2g} m/s^2 with "
            "the one that comes nearest."
        )
        return [Reason(Status.REFUSED, none, CHECK_INPUT)]
    if curve.half_width > UNTOLD_HALF_WIDTH:
        wide = (
            f"The thrust curve is known to +-{curve.half_width:.2g} only, which leaves every curve possible."
        )
        return [Reason(Status.REFUSED, wide, STRONGER)]
    reasons = []
    if at.direct:
        sentence = "A direct method made the thrust curve."
        reasons.append(Reason(Status.PROVISIONAL, sentence, "Log the position setpoint."))
    if curve.half_width > CURVE_HALF_WIDTH:
        rough = (
            f"The thrust curve is known to +-{curve.half_width:.3g}; identified asks for "
            f"+-{CURVE_HALF_WIDTH:.2g}."
        )
        reasons.append(Reason(Status.WEAK, rough, STRONGER))
    return reasons
