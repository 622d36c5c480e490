"""The rule of the verdicts of turning, one ground at a time; the overall one is that of roll and pitch.

On an axis' effectiveness:

* refused: no reference of it varies, it cannot be told from zero or has the wrong sign, or the conditional
  first-stage F of it or of the lag is below 10 and it has no bounded set that holds however weak the
  instruments are;
* provisional: no exogenous reference, so that a direct method had to serve: the setpoint holds the
  vehicle's own noise, and least squares has the effectiveness too small by half and more;
* identified: half-width <= G/4, the lag's <= 20 ms, the lag below the top of its grid, J's p-value >= .001,
  setpoints logged at 45 Hz or more, 15 s of flight or more, and instruments that contain no feedback;
* weak otherwise.

Damping shares them, and asks for a half-width <= D/2; one below zero says that torques of the air moved the
vehicle with the references.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import (
    disagreement_reasons,
    given_lag_reasons,
    instrument_reasons,
    longest_lag_reasons,
    moved,
    short_flight_reasons,
    told_of,
    untold,
    wide_lag_reasons,
)
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.rates.axes import AXES, Axis

EFFECTIVENESS_SHARE = 0.25
DAMPING_SHARE = 0.5
LAG_HALF_WIDTH_S = 0.02
COMMAND_RATE_HZ = 45.0
SHORT_FLIGHT_S = 15.0

FLY = (
    "Fly quick steps of roll and pitch of about 15 degrees to both sides for 60 s, in a mode in which the "
    "sticks set the attitude."
)
LOG_REFERENCE = "Log the attitude setpoint, or the pilot's roll and pitch sticks, at 20 Hz or more."
LOG_PLANNED = "Fly in a mode in which the sticks set the attitude, or inject a sweep."


def all_grounds(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> dict[str, tuple[Reason, ...]]:
    """Grounds against every quantity that there is."""
    found: dict[str, tuple[Reason, ...]] = {}
    for axis in AXES:
        if axis.effectiveness.name not in quantities:
            continue
        effect, damping = axis.effectiveness.name, axis.damping.name
        found[effect] = (
            *shared_reasons(told_of(strength, effect), at),
            *effectiveness_reasons(axis, quantities[effect], strength, at),
            *rough_lag_reasons(quantities, strength),
        )
        found[damping] = (
            *shared_reasons(told_of(strength, effect, damping), at),
            *damping_reasons(axis, quantities[damping], at),
            *rough_lag_reasons(quantities, strength),
        )
        if axis.reacts:
            name = axis.reaction.name
            found[name] = (
                *shared_reasons(told_of(strength, effect, name), at),
                *rough_lag_reasons(quantities, strength),
            )
    lag = (*shared_reasons(told_of(strength), at), *rough_lag_reasons(quantities, strength))
    return {**found, ACTUATOR_LAG.name: lag, DELAY.name: lag, "effective_lag": lag}


def shared_reasons(strength: Strength, at: Circumstances) -> list[Reason]:
    """Grounds that instruments, logging and length of the flight give."""
    reasons = instrument_reasons(strength, at, fly=FLY, log_reference=LOG_REFERENCE, log_planned=LOG_PLANNED)
    remedy = "Fly slowly and away from walls and ground; keep the motors from their limits."
    reasons += disagreement_reasons(strength, moves="turns", remedy=remedy)
    if at.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The torque setpoints are logged at {at.command_rate_hz:.0f} Hz; below "
                f"{COMMAND_RATE_HZ:.0f} Hz the intervals do not hold.",
                "Log them at 50 Hz or more.",
            )
        )
    reasons += short_flight_reasons(at, SHORT_FLIGHT_S)
    reasons.extend(given_lag_reasons(at))
    return reasons


def effectiveness_reasons(
    axis: Axis, effect: Unjudged, strength: Strength, at: Circumstances
) -> list[Reason]:
    """Grounds that the interval of an axis' effectiveness gives."""
    if untold(axis.effectiveness.name, strength):
        return []
    low, high = effect.interval
    if high < 0.0:
        return [
            Reason(
                Status.REFUSED,
                f"The {axis.name} effectiveness came out at {effect.value:.3g} rad/s^2, below zero: "
                f"setpoint and rate of {axis.name} have opposite signs.",
                f"Check the axes and signs of {axis.torque} and {axis.rate}.",
            )
        ]
    if effect.value <= 0.0 or low <= 0.0:
        return [
            Reason(
                Status.REFUSED,
                f"The {axis.name} effectiveness cannot be told from zero: its interval is [{low:.2g}, "
                f"{high:.2g}] rad/s^2.{moved(at)}",
                FLY,
            )
        ]
    if inf > effect.half_width > EFFECTIVENESS_SHARE * effect.value:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} effectiveness' interval is +-{effect.half_width / effect.value:.1%} "
                f"wide; identified asks for +-{EFFECTIVENESS_SHARE:.0%}.{moved(at)}",
                "Fly larger and quicker steps, or longer.",
            )
        ]
    return []


def damping_reasons(axis: Axis, damping: Unjudged, at: Circumstances) -> list[Reason]:
    """Grounds that the interval of an axis' damping gives."""
    if damping.interval[1] < 0.0:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping came out at {damping.value:.3g} 1/s, below zero: a torque "
                "of the air moved with the references.",
                "Fly in calm air.",
            )
        ]
    if damping.interval[0] <= 0.0:
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping cannot be told from zero.{moved(at)}",
                "Fly turns that last longer.",
            )
        ]
    if inf > damping.half_width > DAMPING_SHARE * damping.value:
        share = damping.half_width / damping.value
        return [
            Reason(
                Status.WEAK,
                f"The {axis.name} damping's interval is +-{share:.0%} wide; identified asks for "
                f"+-{DAMPING_SHARE:.0%}.",
                "Fly turns that last longer.",
            )
        ]
    return []


def rough_lag_reasons(quantities: Mapping[str, Unjudged], strength: Strength) -> list[Reason]:
    """Grounds that a lag gives that is not well known."""
    if ACTUATOR_LAG.name not in strength.searched:
        return []
    half_width = quantities["effective_lag"].half_width
    quicker = "Fly quicker steps, and log setpoints and rates faster."
    remedy = "Check that the setpoints are those of this vehicle, and their time stamps."
    return [
        *wide_lag_reasons(half_width, LAG_HALF_WIDTH_S, whose="actuators'", remedy=quicker),
        *longest_lag_reasons(strength, remedy=remedy),
    ]
