"""Reasons and verdict of a flight."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.quantity import QuantityEstimate
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import BEYOND_DOUBT
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG

#: A rule is a generator of these: from a sentence and, where something helps, a remedy.
weak, provisional, refused = (
    partial(Reason, status) for status in (Status.WEAK, Status.PROVISIONAL, Status.REFUSED)
)
GIVE_LAG = "Or give the lag, where it is known: --lag MS:STD or --lag LOW..HIGH."


@dataclass(frozen=True, slots=True)
class FlightRule:
    """What the motions of one vehicle ask of instruments, logging and length, and what to do about each."""

    fly: str
    log_reference: str
    log_planned: str
    moves: str  # What something that the model does not have does to the vehicle
    undisturbed: str
    command_rate_hz: float
    slow_command: str  # With {rate:.0f} and {least:.0f}
    log_faster: str
    least_s: float

    def reasons(self, strength: InstrumentStrength, inputs: VerdictInputs) -> Iterator[Reason]:
        """Reasons that instruments, logging, length of the flight and a lag from elsewhere give."""
        yield from instrument_reasons(
            strength, inputs, fly=self.fly, log_reference=self.log_reference, log_planned=self.log_planned
        )
        yield from disagreement_reasons(strength, moves=self.moves, remedy=self.undisturbed)
        if inputs.command_rate_hz < self.command_rate_hz:
            rates = {"rate": inputs.command_rate_hz, "least": self.command_rate_hz}
            yield weak(self.slow_command.format(**rates), self.log_faster)
        if inputs.used_s < self.least_s:
            sentence = f"Only {inputs.used_s:.3g} s could be used; {self.least_s:.0f} s are needed."
            yield weak(sentence, "Fly longer, or pool several flights.")
        yield from lag_prior_reasons(inputs)


def moved(inputs: VerdictInputs) -> str:
    """How much the flight moved, with a blank before it."""
    return f" {inputs.excitation}" if inputs.excitation else ""


def lag_prior_reasons(inputs: VerdictInputs) -> Iterator[Reason]:
    """Reason against everything that a lag from elsewhere moves, when the flight contradicts it."""
    given = inputs.lag_prior
    if given is not None and given.contradicted:
        sentence = f"The lag that was given contradicts the flight: {given.sentence}."
        yield weak(sentence, "Check what was given: it is the lag and the delay together, in ms.")


def strength_of(strength: InstrumentStrength, *names: str) -> InstrumentStrength:
    """What instruments identify of some parameters, and of the lag that all share."""
    kept = {*names, ACTUATOR_LAG.name}
    return replace(
        strength,
        first_stage={name: f for name, f in strength.first_stage.items() if name in kept},
        robust={name: item for name, item in strength.robust.items() if name in kept},
    )


def disagreement_reasons(strength: InstrumentStrength, *, moves: str, remedy: str) -> Iterator[Reason]:
    """Reason of references that disagree: what something does to the vehicle, and what to do."""
    if strength.p_value < BEYOND_DOUBT:
        sentence = (
            f"The references disagree about the parameters (J p-value {strength.p_value:.1g}): something "
            f"{moves} the vehicle that the model does not have."
        )
        yield weak(sentence, remedy)


def longest_lag_reasons(strength: InstrumentStrength, *, remedy: str) -> Iterator[Reason]:
    """Reason of a lag that ended at the longest that is searched."""
    lag = strength.searched.get(ACTUATOR_LAG.name)
    if lag is not None and lag.value >= 0.999 * lag.highest:
        yield weak(f"The lag ran into the top of its grid ({lag.highest:.1f} s).", remedy)


def has_no_bounds(name: str, strength: InstrumentStrength) -> bool:
    """Whether a set that holds however weak the instruments are has no bounds."""
    return name in strength.robust and not strength.robust[name].is_bounded


def unbounded_reasons(quantity: QuantityEstimate, words: str, others: Sequence[Reason]) -> list[Reason]:
    """Reason against a number whose interval has no end, where no other one refuses it."""
    bounded = not any(math.isinf(end) for end in quantity.interval)
    if bounded or any(reason.status is Status.REFUSED for reason in others):
        return []
    sentence = f"The {words} has no interval with two ends: these data fit numbers however far away."
    return [refused(sentence, "Fly larger and quicker movements, or longer.")]


def weak_instrument_sentence(words: str, first_stage: float) -> str:
    """Sentence of a parameter about which instruments carry too little information."""
    return f"First-stage F of the {words} is {first_stage:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."


def wide_lag_reasons(half_width_s: float, needed_s: float, *, whose: str, remedy: str) -> Iterator[Reason]:
    """Reason of a lag that is not known well."""
    if not half_width_s <= needed_s:
        width = f"is known to +-{half_width_s * 1e3:.0f} ms only"
        known = width if math.isfinite(half_width_s) else "has no upper bound"
        yield weak(f"The {whose} lag {known}; +-{needed_s * 1e3:.0f} ms is needed.", remedy)


def instrument_reasons(
    strength: InstrumentStrength, inputs: VerdictInputs, *, fly: str, log_reference: str, log_planned: str
) -> list[Reason]:
    """Reasons against everything that instruments are to identify, with what to fly and to log."""
    if inputs.constant_reference:
        return [refused(f"The reference never moved ({inputs.missing_reference}).{moved(inputs)}", fly)]
    if inputs.direct and inputs.missing_reference:
        sentence = (
            f"No reference can serve as an instrument ({inputs.missing_reference}), so the numbers come from "
            "nonlinear least squares, which disturbances bias."
        )
        return [provisional(sentence, log_reference)]
    if inputs.direct:
        sentence = "A direct method is biased by disturbances in closed loop."
        return [provisional(sentence, "Use reference_iv for a verdict.")]
    names, strengths = list(strength.first_stage), np.array(list(strength.first_stage.values()))
    reasons = []
    weak_instruments = not np.all(strengths >= STRONG_FIRST_STAGE)
    if weak_instruments or strength.robust:
        sentence = "The instruments do not identify how long the lag is at most."
        if weak_instruments:
            weakest = int(np.argmin(strengths))
            sentence = (
                f"The instruments carry too little information about the {names[weakest].replace('_', ' ')}: "
                f"first-stage F is {strengths[weakest]:.1f}, and {STRONG_FIRST_STAGE:.0f} is needed."
            )
        if inputs.single_frequency_hz and len(names) > 2:
            sentence += (
                f" The reference has one frequency ({inputs.single_frequency_hz:.2g} Hz), which identifies "
                f"two of {len(names)} numbers: two frequencies are needed."
            )
        reasons.append(_of_weak(sentence, strength, inputs, fly))
    if inputs.past_inputs:
        sentence = (
            "Past inputs are the instruments: under control they answer past disturbances, which moves the "
            "numbers."
        )
        reasons.append(provisional(sentence, log_reference))
    elif not inputs.exogenous:
        who = "the vehicle's own disturbances (a setpoint that a position loop computes)"
        reasons.append(weak(f"The instruments answer {who}.", log_planned))
    return reasons


def _of_weak(sentence: str, strength: InstrumentStrength, inputs: VerdictInputs, fly: str) -> Reason:
    """Reason of weak instruments: weak where sets that hold all the same have bounds, else refused."""
    if inputs.lag_prior is None and ACTUATOR_LAG.name in strength.searched:
        fly = f"{fly} {GIVE_LAG}"
    for name, item in strength.robust.items():
        if not item.is_bounded:
            low, high = item.hull
            left = f"They leave the {name.replace('_', ' ')} anywhere in [{low:.2g}, {high:.2g}]."
            return refused(f"{sentence} {left}{moved(inputs)}", fly)
    if not strength.robust:
        return refused(f"{sentence}{moved(inputs)}", fly)
    pieces = max(len(entry.intervals) for entry in strength.robust.values())
    spanned = f", here from the first to the last of its {pieces} pieces" if pieces > 1 else ""
    return weak(f"{sentence} The interval is the set that holds however weak they are{spanned}.", fly)
