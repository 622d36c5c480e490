"""The actuators' lag by another motion of the same flight, which the same actuators make.

Turning about the body axes is quick, and tells in most excited flights the lag that slow climbs hardly show.
Sensors differ: gyroscope, accelerometer and the estimator of velocity have filters and delays of their own,
which no log tells to a few milliseconds. That much goes into the standard error.

The other motion is estimated only where it can tell the lag: its channels are logged fast enough, and a
reference that does not answer the vehicle moves it.
"""

from __future__ import annotations

from typing import Any

from eivor.errors import InputError
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.frames import upward
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Quantity, Unjudged
from eivor.flights.recipe import estimated
from eivor.flights.told_lag import ToldLag
from eivor.inference.verdict import Status
from eivor.signals.recording import Recording

#: Standard deviation of the difference between the delays of the sensors of two motions [s].
SENSORS_APART_S = 0.005
#: Slower states and commands of the other motion tell no lag that is worth an estimate [Hz].
LEAST_STATE_HZ, LEAST_COMMAND_HZ = 90.0, 45.0
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
        rates_hz = dict(motion.select(upward(log), options).rates_hz)
        if rates_hz.pop(COMMAND) < LEAST_COMMAND_HZ or min(rates_hz.values()) < LEAST_STATE_HZ:
            return None
        flight = prepare(log, motion, options)
    except InputError:
        return None
    if not flight.runs or not any(one.usable and one.exogenous for one in flight.references):
        return None
    return lag_told_by(motion, estimated(motion, (flight,), options).quantities[EFFECTIVE_LAG])
