"""Systematic parts of the rigid body: what a log does not say of commands, and of an onboard filter.

A controller of several loops answers its slower ones at every second command or so. Between these the rate
turns on under a demand that stays, and commands fall by K p' t: a saw-tooth that goes with the torque. A log
that holds every fourth command sees it at the same point of a tooth each time, and has commands that are too
large or too small throughout by K p' d, d half of the time between two commands: gains are wrong by the
share alpha K d, and the lag by d at most, beside what the stamps leave open. Which point, no log tells.
alpha K is how quickly the loop of a rate turns off an error: no loop around rotors of a lag tau is quicker
than 1 / tau and calm, so that d / tau is allowed for. In simulated flights with 125 of 500 commands a second
and another loop at 250 Hz it was .8 % of 1.4 %.

Where no stamp tells how much time h there is between two commands, it is as long as the next command can be
waited for, H, at most; half of that is assumed. With h anywhere up to H and the point of the tooth anywhere
within h / 2 to both sides, a point is further than x H / 2 with the probability 1 - x + x log x, which is 5 %
for x = .70. That the time is another one than is assumed is an error of the lag that has nothing to do with
the point, so that squares of both add up.

An onboard filter is a digital one. With its cutoff where it is said to be it is less late the more slowly it
runs: x / tan x of a continuous one, x = pi cutoff / rate, which of the 2.8 ms of 80 Hz is .06 ms less at 1000
steps a second and .24 ms at 500. How often it runs no log tells, but that it is once a sample at least. The
model's filter is continuous: the lag comes out too short by up to so much, and gains too large by that share
of the lag where no delay makes up for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from eivor.flights.allowance import Allowance, Counts, clock_allowance
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.logs.delays import low_pass_delay_s
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.parameters import GAIN

#: Root of 1 - x + x log x = .05, see above.
POINT_WITHIN = 0.701
#: An onboard filter runs at its logged rate or so many times its cutoff, whichever is more.
STEPS_OF_FILTER = 4.0


def all_allowances(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Unjudged], vehicle: KnownVehicle
) -> dict[str, tuple[Allowance, ...]]:
    """Systematic parts of the gains of turning and of the lag."""
    found = _unlogged_commands(flights, quantities)
    early_s = max(filter_early_s(vehicle.gyro_cutoff_hz, flight.rates_hz[AXES[0].name]) for flight in flights)
    lag = quantities.get(EFFECTIVE_LAG)
    if not early_s or lag is None or not lag.value > early_s:
        return found
    why = "How often the gyroscope's filter runs is not known: "
    told = f"{why}the lag may be {1e3 * early_s:.2g} ms longer."
    parts = {name: Allowance(Counts.ADDED, 0.0, early_s, told) for name in (ACTUATOR_LAG.name, EFFECTIVE_LAG)}
    share = early_s / lag.value
    for parameter in GAIN:
        if parameter.name in quantities:
            part = share * abs(quantities[parameter.name].value)
            told = f"{why}the gain may be {100.0 * share:.2g} % smaller."
            parts[parameter.name] = Allowance(Counts.ADDED, part, 0.0, told)
    return found | {name: (*found.get(name, ()), part) for name, part in parts.items()}


def filter_early_s(cutoff_hz: float | None, logged_hz: float) -> float:
    """By what a digital filter that runs as slowly as it may is less late than a continuous one [s]."""
    if cutoff_hz is None:
        return 0.0
    x = math.pi * cutoff_hz / max(logged_hz, STEPS_OF_FILTER * cutoff_hz)
    return low_pass_delay_s(cutoff_hz) * (1.0 - x / math.tan(x))


def _unlogged_commands(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Unjudged]
) -> dict[str, tuple[Allowance, ...]]:
    """What commands between those that the log holds leave open."""
    by_stamps = tuple(
        replace(one, counts=Counts.INDEPENDENT)
        for one in clock_allowance(max(flight.command_slack_s for flight in flights))
    )
    found = {name: by_stamps for name in (ACTUATOR_LAG.name, EFFECTIVE_LAG) if by_stamps}
    half_s = max(_point_s(flight) for flight in flights)
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


def _point_s(flight: PreparedFlight) -> float:
    """How far from the middle of a tooth a log's commands may lie throughout [s]."""
    step_s = flight.unlogged_step_s
    return POINT_WITHIN * step_s if flight.command_slack_s else 0.5 * step_s
