"""Grounds against the actuators' lag and delay: intervals that are wide, and grids that end."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.grounds import longest_lag_reasons, weakly_told, wide_lag_reasons
from eivor.flights.quantity import Unjudged
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, FURTHEST_DELAY_S
from eivor.motions.vertical.remedies import LOG_REFERENCE, QUICKER

LAG_HALF_WIDTH_S = 0.1
LAG_SHARE = 0.5
LAG_KNOWN_S = 0.01


def lag_reasons(quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances) -> list[Reason]:
    """Grounds against the actuator's lag: those that count against the friction, and a rough lag."""
    reasons = rough_lag_reasons(quantities, strength)
    lag = quantities["effective_lag"]
    if np.inf > lag.half_width > max(lag.value, LAG_HALF_WIDTH_S):
        low, high = (1e3 * max(end, 0.0) for end in lag.interval)
        sentence = f"The lag may be anything from {low:.0f} to {high:.0f} ms."
        reasons.append(Reason(Status.REFUSED, sentence, QUICKER))
    elif np.inf > lag.half_width > max(LAG_SHARE * lag.value, LAG_KNOWN_S):
        sentence = f"The lag's interval is +-{lag.half_width * 1e3:.0f} ms wide."
        reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    if at.direct:
        reasons.append(Reason(Status.PROVISIONAL, "A direct method made the lag.", LOG_REFERENCE))
    for name in {ACTUATOR_LAG.name, DELAY.name} & strength.first_stage.keys() if not at.direct else ():
        first_stage = strength.first_stage[name]
        if first_stage < STRONG_FIRST_STAGE:
            sentence = weakly_told("lag", first_stage)
            reasons.append(Reason(Status.WEAK, sentence, QUICKER))
    return reasons


def rough_lag_reasons(quantities: Mapping[str, Unjudged], strength: Strength) -> list[Reason]:
    """Grounds that count against the friction as well: a lag that is hardly known, grids that end."""
    delay = strength.searched.get(DELAY.name)
    if delay is not None and abs(delay.value) >= 0.999 * delay.highest:
        return [
            Reason(
                Status.WEAK,
                f"The delay of the measured rotors ran into the end of its grid "
                f"({delay.highest * 1e3:.0f} ms).",
                "Check the clock of the rotors' telemetry, or use the commands with --input.",
            )
        ]
    if ACTUATOR_LAG.name not in strength.searched:
        return []
    half_width = quantities["effective_lag"].half_width
    remedy = "Check that the input is the command of this vehicle, and its time stamps."
    return [
        *wide_lag_reasons(half_width, LAG_HALF_WIDTH_S, whose="actuator's", remedy=QUICKER),
        *longest_lag_reasons(strength, remedy=remedy),
        *_longest_delay_reasons(quantities["delay"], remedy=remedy),
    ]


def _longest_delay_reasons(delay: Unjudged, *, remedy: str) -> list[Reason]:
    """Ground of a delay that ended at the longest that is tried."""
    if delay.choice is None or not delay.value >= 0.999 * FURTHEST_DELAY_S:
        return []
    sentence = f"The delay ran into the top of its grid ({FURTHEST_DELAY_S:.1f} s)."
    return [Reason(Status.WEAK, sentence, remedy)]


def delay_reasons(delay: Unjudged) -> list[Reason]:
    """Grounds against the delay beside those against the lag: that none of those tried can be left out."""
    if (
        delay.choice is None
        or len(delay.choice.tried) < 2
        or len(delay.choice.fitting) < len(delay.choice.tried)
    ):
        return []
    return [Reason(Status.WEAK, "Every delay that was tried fits.", QUICKER)]
