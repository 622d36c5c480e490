"""Systematic parts of turning: what rotors do that one lag does not describe, and the stamps of setpoints.

What lags is a rotor's speed w, and its thrust goes with w^2. A setpoint that varies with a variance of s T^2
about a rotor's thrust T, by steps or by noise of the gyroscope that the controller passes on, is smoothed as
a speed: sqrt(T) has a mean of 1 - s/8 and a slope of 1 + 3 s/8 of what they are without it, so that torque is
1 + s/4 of what was asked for. A standard deviation of a quarter of the thrust, usual in quick turns, makes
that a percent and a half.
"""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.allowance import Allowance, Counts, clock_allowance
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.motions.rates.axes import AXES

#: What that does to an effectiveness, as a share of it, and to the lag [s].
ROTOR_SHARE, ROTOR_LAG_S = 0.02, 0.001
ROTORS = "Rotors lag in speed, and their thrust goes with its square: large or noisy setpoints change the "


def all_allowances(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Unjudged]
) -> dict[str, tuple[Allowance, ...]]:
    """Systematic parts of effectiveness and lag."""
    found: dict[str, tuple[Allowance, ...]] = {}
    for axis in AXES:
        name = axis.effectiveness.name
        if name in quantities:
            part = ROTOR_SHARE * abs(quantities[name].value)
            found[name] = (Allowance(Counts.ADDED, part, part, f"{ROTORS}effectiveness by 2 %."),)
    by_rotors = Allowance(Counts.ADDED, ROTOR_LAG_S, ROTOR_LAG_S, f"{ROTORS}lag by 1 ms.")
    by_stamps = clock_allowance(max(flight.command_slack_s for flight in flights))
    return {**found, **dict.fromkeys((ACTUATOR_LAG.name, EFFECTIVE_LAG), (*by_stamps, by_rotors))}
