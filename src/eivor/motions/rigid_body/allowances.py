"""Systematic parts of the rigid body: what a log that holds but some of the commands leaves open.

A controller of several loops answers its slower ones at every second command or so. Between these the rate
turns on under a demand that stays, and commands fall by K p' t: a saw-tooth that goes with the torque. A log
that holds every fourth command sees it at the same point of a tooth each time, and has commands that are too
large or too small throughout by K p' d, d half of the time between two commands: gains are wrong by the
share alpha K d, and the lag by d at most, beside what the stamps leave open. Which point, no log tells.
alpha K is how quickly the loop of a rate turns off an error: no loop around rotors of a lag tau is quicker
than 1 / tau and calm, so that d / tau is allowed for. In simulated flights with 125 of 500 commands a second
and another loop at 250 Hz it was .7 % of 1 %.
"""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.allowance import Allowance, Counts, clock_allowance
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.motions.rigid_body.parameters import GAIN


def all_allowances(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Unjudged]
) -> dict[str, tuple[Allowance, ...]]:
    """Systematic parts of the gains of turning and of the lag."""
    by_stamps = clock_allowance(max(flight.command_slack_s for flight in flights))
    found = {name: by_stamps for name in (ACTUATOR_LAG.name, EFFECTIVE_LAG) if by_stamps}
    half_s = 0.5 * max(flight.unlogged_step_s for flight in flights)
    lag = quantities.get(EFFECTIVE_LAG)
    if not half_s or lag is None or not lag.value > half_s:
        return found
    share = half_s / lag.value
    why = "The log holds but some of the commands, perhaps always those at one point of a slower loop: "
    for parameter in GAIN:
        if parameter.name in quantities:
            part = share * abs(quantities[parameter.name].value)
            sentence = f"{why}the gain may be {100.0 * share:.2g} % larger or smaller."
            found[parameter.name] = (Allowance(Counts.INDEPENDENT, part, part, sentence),)
    sentence = f"{why}the lag may be {1e3 * half_s:.2g} ms longer or shorter."
    late = Allowance(Counts.INDEPENDENT, half_s, half_s, sentence)
    for name in (ACTUATOR_LAG.name, EFFECTIVE_LAG):
        found[name] = (*found.get(name, ()), late)
    return found
