"""Reasons and verdict of a flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.quantity import QuantityEstimate
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import BEYOND_DOUBT
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG


def moved(at: VerdictInputs) -> str:
    """How much the flight moved, with a blank before it."""
    return f" {at.excitation}" if at.excitation else ""


def lag_prior_reasons(inputs: VerdictInputs) -> list[Reason]:
    """Reason against everything that a lag from elsewhere moves, when the flight contradicts it."""
    given = inputs.lag_prior
    if given is None or not given.contradicted:
        return []
    return [
        Reason(
            Status.WEAK,
            f"The lag that was given contradicts the flight: {given.sentence}.",
            "Check what was given: it is the lag and the delay together, in ms.",
        )
    ]


def strength_of(strength: InstrumentStrength, *names: str) -> InstrumentStrength:
    """What instruments identify of some parameters, and of the lag that all share."""
    kept = (*names, ACTUATOR_LAG.name)
    return replace(
        strength,
        first_stage={name: f for name, f in strength.first_stage.items() if name in kept},
        robust={name: item for name, item in strength.robust.items() if name in kept},
    )


def disagreement_reasons(strength: InstrumentStrength, *, moves: str, remedy: str) -> list[Reason]:
    """Ground of references that disagree: what something does to the vehicle, and what to do."""
    if not strength.p_value < BEYOND_DOUBT:
        return []
    sentence = (
        f"The references disagree about the parameters (J p-value {strength.p_value:.1g}): something "
        f"{moves} the vehicle that the model does not have."
    )
    return [Reason(Status.WEAK, sentence, remedy)]


def short_flight_reasons(inputs: VerdictInputs, least_s: float) -> list[Reason]:
    """Ground of flights of which too little could be used."""
    if not inputs.used_s < least_s:
        return []
    sentence = f"Only {inputs.used_s:.3g} s could be used; {least_s:.0f} s are needed."
    return [Reason(Status.WEAK, sentence, "Fly longer, or pool several flights.")]


def longest_lag_reasons(strength: InstrumentStrength, *, remedy: str) -> list[Reason]:
    """Reason of a lag that ended at the longest that is searched."""
    lag = strength.searched.get(ACTUATOR_LAG.name)
    if lag is None or not lag.value >= 0.999 * lag.highest:
        return []
    sentence = f"The lag ran into the top of its grid ({lag.highest:.1f} s)."
    return [Reason(Status.WEAK, sentence, remedy)]


def untold(name: str, strength: InstrumentStrength) -> bool:
    """Whether a set that holds however weak the instruments are has no bounds."""
    return name in strength.robust and not strength.robust[name].is_bounded


def unbounded_reasons(quantity: QuantityEstimate, words: str, others: Sequence[Reason]) -> list[Reason]:
    """Reason against a number whose interval has no end, where no other ground refuses it."""
    if any(reason.status is Status.REFUSED for reason in others) or not any(
        math.isinf(end) for end in quantity.interval
    ):
        return []
    return [
        Reason(
            Status.REFUSED,
            f"The {words} has no interval with two ends: these data fit numbers however far away.",
            "Fly larger and quicker movements, or longer.",
        )
    ]


def weak_instrument_sentence(words: str, first_stage: float) -> str:
    """Sentence of a parameter about which instruments carry too little information."""
    return f"First-stage F of the {words} is {first_stage:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."


def wide_lag_reasons(half_width_s: float, needed_s: float, *, whose: str, remedy: str) -> list[Reason]:
    """Reason of a lag that is not known well."""
    if half_width_s <= needed_s:
        return []
    known = (
        f"is known to +-{half_width_s * 1e3:.0f} ms only"
        if math.isfinite(half_width_s)
        else "has no upper bound"
    )
    return [Reason(Status.WEAK, f"The {whose} lag {known}; +-{needed_s * 1e3:.0f} ms is needed.", remedy)]


def instrument_reasons(
    strength: InstrumentStrength, at: VerdictInputs, *, fly: str, log_reference: str, log_planned: str
) -> list[Reason]:
    """Reasons against everything that instruments are to identify.

    Parameters
    ----------
    strength : Strength
        What they identify; weak ones refuse what has no set that holds all the same.
    at : Circumstances
        Where they come from.
    fly : str
        What to fly when they carry too little information.
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
    weak = not np.all(strengths >= STRONG_FIRST_STAGE)
    if weak or strength.robust:
        weakest = int(np.argmin(strengths))
        sentence = (
            f"The instruments carry too little information about the {names[weakest].replace('_', ' ')}: "
            f"first-stage F is {strengths[weakest]:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
            if weak
            else "The instruments do not identify how long the lag is at most."
        )
        if at.single_frequency_hz and len(names) > 2:
            sentence += (
                f" The reference has one frequency ({at.single_frequency_hz:.2g} Hz), which "
                f"identifies two of "
                f"{len(names)} numbers: two frequencies are needed."
            )
        reasons.append(_of_weak(sentence, strength, at, fly))
    if at.past_inputs:
        sentence = (
            "Past inputs are the instruments: under control they answer past disturbances, which moves the "
            "numbers."
        )
        reasons.append(Reason(Status.PROVISIONAL, sentence, log_reference))
    elif not at.exogenous:
        reasons.append(
            Reason(
                Status.WEAK,
                "The instruments answer the vehicle's own disturbances (a setpoint that a position loop "
                "computes).",
                log_planned,
            )
        )
    return reasons


def _of_weak(sentence: str, strength: InstrumentStrength, inputs: VerdictInputs, fly: str) -> Reason:
    """Reason of weak instruments: weak where sets that hold all the same have bounds, else refused."""
    if inputs.lag_prior is None and ACTUATOR_LAG.name in strength.searched:
        fly = f"{fly} Or give the lag, where it is known: --lag MS:STD or --lag LOW..HIGH."
    for name, item in strength.robust.items():
        if untold(name, strength):
            low, high = item.hull
            left = f"They leave the {name.replace('_', ' ')} anywhere in [{low:.2g}, {high:.2g}]."
            return Reason(Status.REFUSED, f"{sentence} {left}{moved(inputs)}", fly)
    if not strength.robust:
        return Reason(Status.REFUSED, f"{sentence}{moved(inputs)}", fly)
    pieces = max(len(entry.intervals) for entry in strength.robust.values())
    spanned = f", here from the first to the last of its {pieces} pieces" if pieces > 1 else ""
    weak = f"{sentence} The interval is the set that holds however weak they are{spanned}."
    return Reason(Status.WEAK, weak, fly)
