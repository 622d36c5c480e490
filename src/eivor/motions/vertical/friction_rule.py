"""Grounds against the viscous friction: what instruments and its interval tell, and signs and units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import disagreement_reasons, instrument_reasons, moved, untold
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason, Status
from eivor.motions.vertical.lag_rule import rough_lag_reasons
from eivor.motions.vertical.remedies import FLY, LOG_REFERENCE

FRICTION_SHARE = 0.5
COMMAND_RATE_HZ = 45.0
#: In simulated flights of 15 and 20 s the friction's interval held it in .81 and .85, of 25 s in .93 [s].
SHORT_FLIGHT_S = 25.0
LARGE_INTERCEPT = 5.0
LOG_PLANNED = "Log the trajectory's position setpoint."


def friction_reasons(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> list[Reason]:
    """Grounds against the viscous friction."""
    reasons = instrument_reasons(
        strength,
        at,
        fly=FLY,
        log_reference=LOG_REFERENCE,
        log_planned=LOG_PLANNED,
    )
    if not untold("viscous_friction", strength):
        reasons.extend(_interval_reasons(quantities["viscous_friction"], at))
    reasons.extend(rough_lag_reasons(quantities, strength))
    reasons.extend(_unit_reasons(quantities))
    remedy = "Keep the tilt small, stay off the ground, and check the input map."
    reasons += disagreement_reasons(strength, moves="moves", remedy=remedy)
    if at.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The command is logged at {at.command_rate_hz:.0f} Hz; below {COMMAND_RATE_HZ:.0f} Hz the "
                "intervals do not hold.",
                "Log the thrust setpoint or the rotor commands at 50 Hz or more.",
            )
        )
    if at.used_s < SHORT_FLIGHT_S:
        reasons.append(
            Reason(
                Status.WEAK,
                f"Only {at.used_s:.3g} s could be used: intervals of less than {SHORT_FLIGHT_S:.0f} s hold "
                "the friction too seldom.",
                "Fly longer, or pool several flights.",
            )
        )
    return reasons


def _interval_reasons(friction: Unjudged, at: Circumstances) -> list[Reason]:
    """Grounds against the viscous friction that its interval gives."""
    reasons = []
    low, high = friction.interval
    if high < 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction came out at {friction.value:.3g} 1/s, which no vehicle has: the air "
                f"or a feedback moved the vehicle more than the reference did.{moved(at)}",
                FLY,
            )
        )
    elif friction.value <= 0.0 or low <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                f"The viscous friction cannot be told from zero: its interval is [{low:.2g}, {high:.2g}] "
                f"1/s.{moved(at)}",
                FLY,
            )
        )
    elif np.inf > friction.half_width + friction.reserved > FRICTION_SHARE * friction.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The viscous friction's interval is +-{friction.half_width / friction.value:.1%} wide"
                f"{_reserve(friction)}; identified asks for +-{FRICTION_SHARE:.0%}.{moved(at)}",
                "Fly longer, faster climbs and descents, or pool several flights.",
            )
        )
    elif low <= friction.reserved and friction.reserved > 0.0:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The viscous friction's interval begins at {low:.2g} 1/s, and up to "
                f"{friction.reserved:.2g} 1/s cannot be told from an estimator's own dynamics.",
                "Fly longer, faster climbs and descents, or log a velocity that is measured.",
            )
        )
    return reasons


def _reserve(friction: Unjudged) -> str:
    """What identified asks for beside the interval, with words before it; empty for nothing."""
    if not friction.reserved:
        return ""
    return f", and the estimator behind velocity or acceleration may add {friction.reserved:.2g} 1/s"


def _unit_reasons(quantities: Mapping[str, Unjudged]) -> list[Reason]:
    """Grounds that speak of signs and units: a gain that pulls down, an intercept that no sensor has."""
    reasons = []
    if quantities["input_gain"].value <= 0.0:
        reasons.append(
            Reason(
                Status.REFUSED,
                "The input gain is not positive: the input, or the acceleration, has the wrong sign.",
                "Check the frame (z up, or NED), the input's sign and its map.",
            )
        )
    intercept = quantities.get("intercept")
    if intercept is not None and abs(intercept.value) - intercept.half_width > LARGE_INTERCEPT:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The intercept is {intercept.value:.1f} m/s^2, far beyond the bias of an accelerometer.",
                "Check the units and signs of velocity and acceleration, the clock, and the input map.",
            )
        )
    return reasons
