"""Systematic parts of the intervals of vertical motion, which a flight's own scatter cannot show.

* The hover input is that of one flight: its wind, its height, its speed over ground, the trim of its rotors.
  No second flight has the same to better than half a percent.
* An estimator that learns an accelerometer's bias with the time constant T gives an acceleration that lacks
  V / T, which adds 1 / T to the viscous friction, and one that fuses velocity late adds as much. Seen in
  vehicles without friction: .02 to .03 1/s.
* Where a log does not tell how often its command was issued, the lag is known up to a quarter of the log's
  step: a command that is late throughout is a shorter lag, and moves neither friction nor gain.
* Sensors that disagree, see `eivor.motions.vertical.sensors`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from eivor.flights.allowance import Allowance, Counts, clock_allowance
from eivor.flights.circumstances import Circumstances
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.motions.vertical.sensors import sensor_allowances

#: No interval of the hover input reaches less far than this share of it.
HOVER_FLOOR = 0.005
#: Friction that an estimator's own dynamics may look like [1/s].
ESTIMATOR_FRICTION = 0.03


def all_allowances(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Unjudged], at: Circumstances
) -> dict[str, tuple[Allowance, ...]]:
    """Systematic parts by quantity."""
    slack_s = max(flight.command_slack_s for flight in flights)
    causes = (
        {"viscous_friction": _of_estimators(flights)},
        {"hover_input": _at_these_conditions(quantities["hover_input"].value)},
        {name: clock_allowance(slack_s) for name in ("actuator_lag", "effective_lag")},
        sensor_allowances(at.sensors, quantities, aligned=at.aligned),
    )
    parts = {name: [part for cause in causes for part in cause.get(name, ())] for name in quantities}
    return {name: tuple(found) for name, found in parts.items() if found}


def _of_estimators(flights: tuple[PreparedFlight, ...]) -> list[Allowance]:
    """What an estimator behind velocity or acceleration may add to the friction."""
    roles = sorted({role for flight in flights for role in flight.estimated})
    if not roles:
        return []
    sentence = (
        f"{' and '.join(roles).capitalize()} from an estimator: its own dynamics can look like a "
        f"friction of up to {ESTIMATOR_FRICTION:g} 1/s; identified keeps as much in reserve."
    )
    return [Allowance(Counts.RESERVED, ESTIMATOR_FRICTION, ESTIMATOR_FRICTION, sentence)]


def _at_these_conditions(hover: float) -> list[Allowance]:
    """What another flight's conditions may change of the hover input."""
    if not (math.isfinite(hover) and hover > 0.0):
        return []
    floor = HOVER_FLOOR * hover
    sentence = (
        f"It is that of this flight's conditions (wind, height, speed, battery): the interval is at least "
        f"±{HOVER_FLOOR:.1%} wide."
    )
    return [Allowance(Counts.AT_LEAST, floor, floor, sentence)]
