"""The actuators' lag by another motion of the same flight, which the same actuators make.

Turning about the body axes is quick, and tells in most excited flights the lag that slow climbs hardly show.
Sensors differ: gyroscope, accelerometer and the estimator of velocity have filters and delays of their own,
which no log tells to a few milliseconds. That much goes into the standard error.

The other motion is estimated only where it can tell the lag: its channels are logged fast enough, and a
reference that does not answer the vehicle moves it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from eivor.errors import EstimationError, InputError
from eivor.estimation.fit import identify
from eivor.estimation.methods import by_name
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.frames import upward
from eivor.flights.instruments import instruments
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import part_to_read, prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity, Unjudged
from eivor.flights.recipe import estimated
from eivor.flights.told_lag import ToldLag
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Status
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.models.separable import Nuisance
from eivor.signals.recording import Recording

#: Standard deviation of the difference between the delays of the sensors of two motions [s].
SENSORS_APART_S = 0.005
#: Slower states and commands of the other motion tell no lag that is worth an estimate [Hz].
LEAST_STATE_HZ, LEAST_COMMAND_HZ = 90.0, 45.0
#: Instruments weaker than this share of strong ones are not looked at closely. Their F at coarse lags and
#: one delay was at least nine tenths of that at the best in flights where that was strong (26 simulated ones
#: of three vehicles), and half of it in others.
LEAST_SHARE = 0.5
#: Role of the commands among the rates of a selection.
COMMAND = "command"


def lags_beside(
    motions: tuple[Motion[Any], ...], log: Recording, window: tuple[float, float] | None
) -> tuple[ToldLag, ...]:
    """Lags that other motions tell, each where its own verdict on the lag is identified.

    Parameters
    ----------
    motions : tuple of Motion
        The others.
    log : Recording
        Of one flight.
    window : tuple of float, optional
        The part of it that counts [s].
    """
    options = FlightOptions(window=window)
    found = (_lag_by(motion, log, options) for motion in motions)
    return tuple(told for told in found if told is not None)


def lag_told_by(motion: Motion[Any], lag: Quantity) -> ToldLag | None:
    """What a motion's result says of the lag; None where that is not to be trusted."""
    if lag.verdict is not Status.IDENTIFIED:
        return None
    return ToldLag(
        motion.name,
        f"{motion.words.title.lower()} (--model {motion.name})",
        Unjudged(lag.value, lag.unit, lag.std_error, lag.interval),
        SENSORS_APART_S,
        "the delays that sensors differ by",
    )


def _lag_by(motion: Motion[Any], log: Recording, options: FlightOptions) -> ToldLag | None:
    """Lag by one motion; None where it cannot be told, or not be trusted."""
    try:
        log = part_to_read(upward(log), options.window)
        rates_hz = dict(motion.select(log, options).rates_hz)
        if rates_hz.pop(COMMAND) < LEAST_COMMAND_HZ or min(rates_hz.values()) < LEAST_STATE_HZ:
            return None
        flight = prepare(log, motion, options)
    except InputError:
        return None
    if not flight.runs or not any(one.usable and one.exogenous for one in flight.references):
        return None
    if not _may_be_told(motion, flight, options):
        return None
    result = estimated(motion, (flight,), options, with_sets=False)
    return lag_told_by(motion, result.quantities[EFFECTIVE_LAG])


def _may_be_told(motion: Motion[Any], flight: PreparedFlight, options: FlightOptions) -> bool:
    """Whether instruments tell anything of the lag, by a coarse search: most flights end here."""
    method = by_name(options.method)
    chosen = instruments((flight,), options, method)
    if chosen.absent:
        return False
    try:
        problem = motion.problem((flight.shortened,), chosen.rule)
        coarse = problem.with_nuisances(tuple(map(_coarse, problem.nuisances)))
        found = identify(coarse, motion.weighted(method))
    except EstimationError:
        return False
    first_stage = dict(zip(found.names, found.best.inference.first_stage, strict=True))
    return first_stage.get(ACTUATOR_LAG.name, 0.0) >= LEAST_SHARE * STRONG_FIRST_STAGE


def _coarse(one: Nuisance) -> Nuisance:
    """A nuisance with some of its grid, and nothing between: of a delay, which a lag makes up for, one."""
    if not one.searched:
        return one
    middle = (len(one.grid) - 1) // 2
    grid = one.grid[middle : middle + 1] if one.discrete else one.grid[::4]
    return replace(one, grid=grid, halvings=0, furthest=None, tolerance=float(grid[-1] - grid[0]) or 1.0)
