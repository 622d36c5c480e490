"""Grounds of verdicts that any motion may have: what its instruments tell, and where they come from."""

from __future__ import annotations

import numpy as np

from eivor.flights.motion import Circumstances, Strength
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status


def moved(at: Circumstances) -> str:
    """How much the flight moved, with a blank before it."""
    return f" {at.excitation}" if at.excitation else ""


def given_lag_reasons(at: Circumstances) -> list[Reason]:
    """Ground against everything that a lag from elsewhere moves, when the flight contradicts it."""
    given = at.given_lag
    if given is None or not given.contradicted:
        return []
    return [
        Reason(
            Status.WEAK,
            f"The lag that was given contradicts the flight: {given.sentence}.",
            "Check what was given: it is the lag and the delay together, in ms, and its standard deviation.",
        )
    ]


def instrument_reasons(
    strength: Strength, at: Circumstances, *, fly: str, log_reference: str, log_planned: str
) -> list[Reason]:
    """Grounds against everything that instruments are to tell.

    Parameters
    ----------
    strength : Strength
        What they tell.
    at : Circumstances
        Where they come from.
    fly : str
        What to fly when they tell too little.
    log_reference, log_planned : str
        What to log when there is none, and when it answers the vehicle.
    """
    if at.constant_reference:
        sentence = f"The reference never moved ({at.missing_reference}).{moved(at)}"
        return [Reason(Status.REFUSED, sentence, fly)]
    if at.direct:
        if at.missing_reference:
            return [
                Reason(
                    Status.PROVISIONAL,
                    f"No reference can serve as an instrument ({at.missing_reference}), so the numbers "
                    "come from nonlinear least squares, which disturbances bias.",
                    log_reference,
                )
            ]
        return [
            Reason(
                Status.PROVISIONAL,
                "A direct method is biased by disturbances in closed loop.",
                "Use reference_iv for a verdict.",
            )
        ]
    names, strengths = list(strength.first_stage), np.array(list(strength.first_stage.values()))
    reasons = []
    if not np.all(strengths >= STRONG_FIRST_STAGE):
        weakest = int(np.argmin(strengths))
        sentence = (
            f"The instruments tell too little about the {names[weakest].replace('_', ' ')}: "
            f"first-stage F is {strengths[weakest]:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
        )
        if at.single_frequency_hz and len(names) > 2:
            sentence += (
                f" The reference has one frequency ({at.single_frequency_hz:.2g} Hz), which tells two of "
                f"{len(names)} numbers: two frequencies are needed."
            )
        reasons.append(Reason(Status.REFUSED, f"{sentence}{moved(at)}", fly))
    if not at.exogenous:
        reasons.append(
            Reason(
                Status.WEAK,
                "The instruments answer the vehicle's own disturbances (past inputs, or a setpoint that a "
                "position loop computes).",
                log_planned,
            )
        )
    return reasons
