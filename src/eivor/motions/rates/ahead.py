"""Rates some tenths of a second ahead, of the torque setpoints alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.flights.ahead import UNCHANGED, Ahead, AheadError, Starts, all_ahead, starts_of, trim
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.predicted import SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Values
from eivor.motions.rates.axes import AXES, Axis
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state
from eivor.signals.derivative import time_derivative

#: What it is that everything stays as it is.
STAYS = "stays as it is"


def rates_ahead(
    flights: tuple[PreparedFlight, ...], models: Mapping[str, SimpleModel], refused: frozenset[str]
) -> Ahead:
    """Rates after each horizon, by each model and by the rates at the start.

    Parameters
    ----------
    flights : tuple of PreparedFlight
        With runs.
    models : mapping of str to SimpleModel
        The fit first.
    refused : frozenset of str
        Quantities of the fit that are not told: axes whose effectiveness is among them are left out.
    """
    fit = next(iter(models.values())).values
    logged = [axis for axis in AXES if all(axis.torque in flight.signals.channels for flight in flights)]
    told = [axis for axis in logged if axis.effectiveness.name in fit.keys() - refused]
    if EFFECTIVE_LAG in refused:
        told = []
    left_out = tuple(_why(axis, logged, refused) for axis in AXES if axis not in told)
    starts = [starts_of(flight) for flight in flights]
    found = [
        tuple(error for axis in told for error in _of_axis(axis, flight, where, models))
        for flight, where in zip(flights, starts, strict=True)
    ]
    times = [flight.grid.time_s[where.samples] for flight, where in zip(flights, starts, strict=True)]
    return all_ahead(found, times, left_out)


def _why(axis: Axis, logged: list[Axis], refused: frozenset[str]) -> str:
    if axis not in logged:
        why = "its setpoint or rate is not logged"
    elif EFFECTIVE_LAG in refused:
        why = "the lag is refused"
    else:
        why = "its effectiveness is refused" if axis.effectiveness.name in refused else "the fit knows none"
    return f"The {axis.name} rate is not predicted: {why}."


def _of_axis(
    axis: Axis, flight: PreparedFlight, starts: Starts, models: Mapping[str, SimpleModel]
) -> list[AheadError]:
    rate = flight.signals.channel(axis.rate)
    measured, begun = rate[starts.ends], rate[starts.samples]
    by_model = {
        name: (model.words, _predicted(axis, flight, starts, model.values)) for name, model in models.items()
    }
    by_model[UNCHANGED] = (STAYS, np.broadcast_to(begun, measured.shape))
    return [
        AheadError(
            name,
            words,
            f"{axis.name} rate",
            "rad/s",
            np.abs(predicted - measured).T,
            np.column_stack([measured[-1], predicted[-1]]),
        )
        for name, (words, predicted) in by_model.items()
    ]


def _predicted(
    axis: Axis, flight: PreparedFlight, starts: Starts, values: Values
) -> Float[np.ndarray, "horizons starts"]:
    """Answer of one rate to its setpoint, from every start."""
    signals = flight.signals
    command, rate = signals.channel(axis.torque)[:, None], signals.channel(axis.rate)
    lag_s, delay_s = values[ACTUATOR_LAG.name], values[DELAY.name]
    state = actuator_state(command, step_s=signals.step_s, lag_s=lag_s, delay_s=delay_s)[:, 0]
    driven = values[axis.effectiveness.name] * state
    if axis.reacts:
        driven += values[axis.reaction.name] * time_derivative(state, signals.step_s)
    damping = values[axis.damping.name]
    driven += trim(flight, time_derivative(rate, signals.step_s) + damping * rate - driven)
    begun = rate[starts.samples][None, :]
    force = starts.over_step(driven)
    return starts.carried(begun, lambda rates, now: force[now] - damping * rates)[:, 0]
