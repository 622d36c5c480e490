"""Grounds against input gain and hover input: wide intervals, slow logs, and terms that are missed."""

from __future__ import annotations

import numpy as np

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import moved, weakly_told
from eivor.flights.quantity import Unjudged
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.motions.vertical.left_out import VOLTAGE_CHANGE, left_out_sentence, missed
from eivor.motions.vertical.remedies import LOG_REFERENCE
from eivor.motions.vertical.terms import GROUND, SUPPLY

GAIN_SHARE = 0.1
HOVER_SHARE = 0.05
GAIN_RATE_HZ = 20.0
LARGER_STEPS = "Fly quicker and larger steps, which change the thrust more."
#: Terms that harm the gain when they are missed, and what to do.
LEFT_OUT = {
    SUPPLY: "Log battery_voltage, start with a full battery, or identify a part of the flight with --window.",
    GROUND: "Fly higher over the ground, four radii of a rotor and more.",
}
#: The same for the supply whose voltage is logged.
WITH_VOLTAGE = "Add the term with --term voltage, or identify a part of the flight with --window."


def gain_reasons(gain: Unjudged, strength: Strength, at: Circumstances) -> list[Reason]:
    """Grounds against the input gain."""
    if gain.value <= 0.0:
        return [Reason(Status.REFUSED, "The input gain is not positive.", "Check the input's sign and map.")]
    if np.inf > gain.half_width and gain.interval[0] <= 0.0:
        low, high = (f"{end:.3g}" for end in gain.interval)
        sentence = f"The input gain cannot be told from zero: its interval is [{low}, {high}] m/s^2."
        return [Reason(Status.REFUSED, f"{sentence}{moved(at)}", LARGER_STEPS)]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the input gain.", LOG_REFERENCE))
    if np.inf > gain.half_width > GAIN_SHARE * gain.value:
        sentence = (
            f"The input gain's interval is +-{gain.half_width / gain.value:.1%} wide; identified asks "
            f"for +-{GAIN_SHARE:.0%}."
        )
        first_stage = strength.first_stage.get("input_gain", np.nan)
        if first_stage < STRONG_FIRST_STAGE:
            sentence += f" {weakly_told('input gain', first_stage)}"
        reasons.append(
            Reason(
                Status.WEAK,
                f"{sentence}{moved(at)}",
                LARGER_STEPS,
            )
        )
    if at.response_rate_hz < GAIN_RATE_HZ:
        reasons.append(
            Reason(
                Status.WEAK,
                f"Velocity and acceleration are logged at {at.response_rate_hz:.0f} Hz at most.",
                "Log one of them at 20 Hz or more.",
            )
        )
    return reasons


def left_out_reasons(at: Circumstances) -> list[Reason]:
    """Grounds against the gain: thrust that goes with the supply, or with the height over the ground."""
    reasons = []
    for name, remedy in LEFT_OUT.items():
        if missed(at.numbers, name):
            told = left_out_sentence(at.numbers, name)
            by_voltage = name == SUPPLY and VOLTAGE_CHANGE in at.numbers
            told_remedy = WITH_VOLTAGE if by_voltage else remedy
            reasons.append(Reason(Status.WEAK, f"{told[0].upper()}{told[1:]}.", told_remedy))
    return reasons


def hover_reasons(hover: Unjudged, at: Circumstances) -> list[Reason]:
    """Grounds against the hover input."""
    if not (np.isfinite(hover.value) and hover.value > 0.0):
        return [Reason(Status.REFUSED, "The hover input is not positive.", "Check the input's sign and map.")]
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the hover input.", LOG_REFERENCE))
    if hover.half_width != np.inf and not hover.half_width <= HOVER_SHARE * hover.value:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The hover input's interval is +-{hover.half_width / hover.value:.1%} wide; identified asks "
                f"for +-{HOVER_SHARE:.0%}.",
                "Fly longer, and come to rest between the climbs.",
            )
        )
    return reasons
