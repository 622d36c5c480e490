"""The rule of the rigid body's verdicts; the overall one is that of thrust, roll and pitch gain and the lag.

Each quantity is judged by the instruments of its own equation, and by its own interval:

* refused: instruments too weak for it, a gain that cannot be told from zero or has the wrong sign, rotors in
  another order than that of the vehicle file;
* provisional: a direct method, for want of references;
* identified: a half-width of at most a tenth of a gain, a half of a drag or a damping, .1 of a coupling, 10
  ms of the lag;
* weak otherwise, and drags across where a steady wind blew; everything where axes disagree about the lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import (
    disagreement_reasons,
    given_lag_reasons,
    instrument_reasons,
    moved,
    short_flight_reasons,
    told_of,
    untold,
    wide_lag_reasons,
)
from eivor.flights.quantity import Unjudged
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.rigid_body.filters_shown import FiltersNotPassed
from eivor.motions.rigid_body.lags_apart import LagsApart
from eivor.motions.rigid_body.parameters import COUPLING, DAMPING, DRAG, FRICTION, GAIN, LIFT, THRUST
from eivor.motions.rigid_body.rotor_order import Order
from eivor.motions.rigid_body.wind_shown import ACROSS, SteadyWind

GAIN_SHARE, SLOW_SHARE, COUPLING_WITHIN, LAG_WITHIN_S = 0.1, 0.5, 0.1, 0.01
SHORT_FLIGHT_S = 10.0
COMMAND_RATE_HZ = 45.0
FLY = (
    "Fly steps of roll, pitch, yaw and height at uneven times for 60 s, each by itself and some together, in "
    "calm air."
)
CORRECT_ROTORS = "Correct positions and spins in the vehicle file, in the order of the rotor commands."
LOG_REFERENCE = "Log the setpoints of height and attitude, or the pilot's sticks, at 20 Hz or more."
LOG_PLANNED = "Fly in a mode in which the sticks set the attitude, or inject a sweep."

_GAINS = {one.name for one in (*GAIN, THRUST)}
_SLOW = {one.name for one in (*DAMPING, *DRAG, FRICTION, LIFT)}
_COUPLINGS = {one.name for one in COUPLING}
_ACROSS = {one.name for one in ACROSS}


def all_grounds(
    quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
) -> dict[str, tuple[Reason, ...]]:
    """Grounds against every quantity that there is."""
    lag = (*_shared(told_of(strength), at), *_lag_reasons(quantities))
    found = {ACTUATOR_LAG.name: lag, DELAY.name: lag, "effective_lag": lag}
    wind = SteadyWind.of_numbers(at.numbers)
    for name, quantity in quantities.items():
        if name in found:
            continue
        moved_by = THRUST.name if name == FRICTION.name else name  # what trades is told together
        reasons = [*_shared(told_of(strength, moved_by), at), *_lag_reasons(quantities)]
        if not untold(name, strength):
            reasons += _interval_reasons(name, quantity, at)
        if wind is not None and name in _ACROSS:
            reasons.append(Reason(Status.WEAK, wind.sentence, wind.remedy))
        found[name] = tuple(reasons)
    return found


def _shared(strength: Strength, at: Circumstances) -> list[Reason]:
    reasons = instrument_reasons(strength, at, fly=FLY, log_reference=LOG_REFERENCE, log_planned=LOG_PLANNED)
    remedy = "Fly in calm air and away from the ground, and keep the motors from their limits."
    reasons += disagreement_reasons(strength, moves="moves", remedy=remedy)
    if at.command_rate_hz < COMMAND_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The rotors are logged at {at.command_rate_hz:.0f} Hz; {COMMAND_RATE_HZ:.0f} Hz are needed.",
                "Log them at 100 Hz or more.",
            )
        )
    reasons += short_flight_reasons(at, SHORT_FLIGHT_S)
    reasons.extend(given_lag_reasons(at))
    order = Order.of_numbers(at.numbers)
    if order is not None:
        reasons.append(Reason(Status.REFUSED, order.sentence, CORRECT_ROTORS))
    lags = LagsApart.of_numbers(at.numbers)
    if lags is not None:
        reasons.append(Reason(Status.WEAK, lags.sentence, lags.remedy))
    filters = FiltersNotPassed.of_numbers(at.numbers)
    if filters is not None:
        reasons.append(Reason(Status.WEAK, filters.sentence, filters.remedy))
    return reasons


def _interval_reasons(name: str, quantity: Unjudged, at: Circumstances) -> list[Reason]:
    words = name.replace("_", " ")
    low, high = quantity.interval
    if name in _GAINS:
        if high < 0.0:
            return [
                Reason(
                    Status.REFUSED,
                    f"The {words} came out at {quantity.value:.3g}, below zero: {_what_is_wrong(name)}.",
                    CORRECT_ROTORS,
                )
            ]
        if low <= 0.0:
            return [Reason(Status.REFUSED, f"The {words} cannot be told from zero.{moved(at)}", FLY)]
    if name in _SLOW and low <= 0.0:
        return [Reason(Status.WEAK, f"The {words} cannot be told from zero.{moved(at)}", FLY)]
    share = GAIN_SHARE if name in _GAINS else SLOW_SHARE if name in _SLOW else 0.0
    allowed = share * abs(quantity.value) if share else COUPLING_WITHIN if name in _COUPLINGS else inf
    if inf > quantity.half_width > allowed:
        return [
            Reason(
                Status.WEAK,
                f"The {words} is known to +-{quantity.half_width:.2g} only; identified asks for "
                f"+-{allowed:.2g}.",
                "Fly larger and quicker steps, or longer.",
            )
        ]
    return []


def _what_is_wrong(name: str) -> str:
    if name == THRUST.name:
        return "the rotor commands, or the accelerometer along z, have the wrong sign"
    if name == GAIN[2].name:
        return (
            "the rotors spin the other way than the vehicle file says, or the rate of yaw has the wrong sign"
        )
    axis = name.removesuffix("_gain")
    return (
        f"the rotors' order about {axis} is another than that of the vehicle file, or the rate of {axis} has "
        "the wrong sign"
    )


def _lag_reasons(quantities: Mapping[str, Unjudged]) -> list[Reason]:
    half_width = quantities["effective_lag"].half_width
    remedy = "Fly quicker steps, and log rotors and rates faster."
    return wide_lag_reasons(half_width, LAG_WITHIN_S, whose="rotors'", remedy=remedy)
