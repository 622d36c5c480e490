"""The rule of the rover's verdicts: gain and dry friction must be told from zero, and to a fifth."""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.motion import InstrumentStrength, VerdictInputs
from eivor.flights.quantity import QuantityEstimate
from eivor.flights.verdict import instrument_reasons, moved
from eivor.inference.verdict import Reason, Status

DRIVE = "Drive to and fro for 60 s with speeds that change every few seconds, on level ground."
LOG = "Log the speed that was asked for, as reference_forward_speed."
#: A parameter is identified when its half-width is within this share of its value.
SHARE = 0.2
#: The lag is, when its half-width is within this [s].
LAG_HALF_WIDTH_S = 0.02
J_P_VALUE = 0.001
MUST_BE_POSITIVE = ("drive_gain", "dry_friction", "rolling_drag")


def reasons(
    quantities: Mapping[str, QuantityEstimate], strength: InstrumentStrength, inputs: VerdictInputs
) -> dict[str, tuple[Reason, ...]]:
    """Grounds against every quantity; those that one parameter decides share its grounds."""
    shared = instrument_reasons(strength, inputs, fly=DRIVE, log_reference=LOG, log_planned=LOG)
    if strength.p_value < J_P_VALUE:
        sentence = f"The references disagree (J p-value {strength.p_value:.1g})."
        shared.append(Reason(Status.WEAK, sentence, "Drive on level ground, without slip."))
    selected = {
        name: (*shared, *_without_set(name, strength), *_too_wide(name, quantities[name], inputs))
        for name in MUST_BE_POSITIVE
    }
    lag = (*shared, *_rough_lag(quantities["effective_lag"]))
    return {
        **selected,
        "actuator_lag": lag,
        "delay": lag,
        "effective_lag": lag,
        "breakaway_command": (
            *selected["dry_friction"],
            *selected["drive_gain"],
            *_without_set("breakaway_command", strength),
        ),
        "time_constant": selected["rolling_drag"],
    }


def _without_set(name: str, strength: InstrumentStrength) -> list[Reason]:
    """Ground of weak instruments against what has no set that holds however weak they are."""
    if not strength.robust or name in strength.robust:  # without any the shared grounds say it
        return []
    sentence = f"The {name.replace('_', ' ')} has no interval that holds for instruments so weak."
    return [Reason(Status.REFUSED, sentence, DRIVE)]


def _too_wide(name: str, quantity: QuantityEstimate, inputs: VerdictInputs) -> list[Reason]:
    words = name.replace("_", " ")
    if quantity.interval[0] <= 0.0:
        sentence = f"The {words} cannot be told from zero.{moved(inputs)}"
        return [Reason(Status.REFUSED, sentence, DRIVE)]
    share = quantity.half_width / quantity.value
    if share <= SHARE:
        return []
    sentence = (
        f"The {words}'s interval is +-{share:.0%} wide; identified asks for +-{SHARE:.0%}.{moved(inputs)}"
    )
    return [Reason(Status.WEAK, sentence, "Drive longer, or give several drives.")]


def _rough_lag(lag: QuantityEstimate) -> list[Reason]:
    if lag.half_width <= LAG_HALF_WIDTH_S:
        return []
    sentence = f"The lag of the drive is known to +-{lag.half_width * 1e3:.0f} ms only."
    return [Reason(Status.WEAK, sentence, "Change the speed in quicker steps.")]
