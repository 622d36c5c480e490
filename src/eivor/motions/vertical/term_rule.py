"""Grounds against the coefficient of an optional term."""

from __future__ import annotations

import numpy as np

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import given_lag_reasons, weakly_told
from eivor.flights.quantity import Unjudged
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.models.equation import Parameter
from eivor.motions.vertical.remedies import FLY, LOG_REFERENCE
from eivor.motions.vertical.sensor_rule import unit_reasons


def term_reasons(
    coefficient: Unjudged, parameter: Parameter, strength: Strength, at: Circumstances
) -> list[Reason]:
    """Grounds against the coefficient of an optional term."""
    words = parameter.name.replace("_", " ")
    reasons = []
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, f"A direct method made the {words}.", LOG_REFERENCE))
    first_stage = strength.first_stage.get(parameter.name, np.nan)
    if first_stage < STRONG_FIRST_STAGE:
        reasons.append(Reason(Status.WEAK, weakly_told(words, first_stage), FLY))
    low, high = coefficient.interval
    if low <= 0.0 <= high:
        reasons.append(
            Reason(
                Status.WEAK,
                f"The {words} cannot be told from zero: its interval is [{low:.2g}, {high:.2g}]"
                f"{f' {parameter.unit}' if parameter.unit else ''}.",
                "Leave the term out, and what remains is told more closely; or fly so that it shows.",
            )
        )
    return [*reasons, *given_lag_reasons(at), *unit_reasons(at)]
