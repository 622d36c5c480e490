"""Turning of one or several flights: a separable problem with one equation for each axis.

Lag and delay of the actuators are shared by all axes, since the same rotors turn the vehicle about each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.equation import Parameter
from eivor.models.instruments import DrivenSignals, InstrumentRule, LaggedReferences
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns, lag_and_delay
from eivor.models.separable import Values
from eivor.motions.rates.axes import AXES, Axis
from eivor.shapes import Float
from eivor.signals.actuator import actuator_state
from eivor.signals.derivative import time_derivative
from eivor.signals.signals import Signals

#: Lags of each reference: how many, and their time constant [s]. Rates follow within a tenth of a second.
REFERENCE_LAGS = (4, 0.06)
#: Lags and delays to search [s]. A lag of 1/D with a damping of 1/tau turns the vehicle as a lag of tau with
#: a damping of D does, but for the gain. No rotor is as slow as damping is, which takes seconds: longer lags
#: are not searched.
LAGS_S = np.geomspace(0.004, 0.15, 30)
DELAYS_S = (0.0, 0.005, 0.010, 0.015, 0.020, 0.030)


@dataclass(frozen=True)
class LaggedTorque:
    """Columns of what the actuators make of a torque setpoint.

    Parameters
    ----------
    signals : Signals
        One flight.
    axis : Axis
        Whose setpoint.
    """

    signals: Signals
    axis: Axis

    def __call__(self, at: Values) -> Float[np.ndarray, "n m"]:
        """State at a lag and a delay and, where it reacts, its rate of change."""
        step_s = self.signals.step_s
        command = self.signals.channel(self.axis.torque)[:, None]
        state = actuator_state(command, step_s=step_s, lag_s=at[ACTUATOR_LAG.name], delay_s=at[DELAY.name])
        if not self.axis.reacts:
            return state
        return np.column_stack([state, time_derivative(state[:, 0], step_s)])


def rates_problem(flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> LaggedRuns:
    """Regressions of the flights for each lag and delay.

    Parameters
    ----------
    flights : tuple of PreparedFlight
        All with runs; axes are those that all of them have.
    rule : InstrumentRule
        What serves as instruments. References of an axis serve that axis, or all where it has none.
    """
    axes = tuple(axis for axis in AXES if all(axis.torque in flight.signals.channels for flight in flights))
    fixed = tuple(axis.damping for axis in axes)
    moving = (
        *(axis.effectiveness for axis in axes),
        *(axis.reaction for axis in axes if axis.reacts),
    )
    columns = tuple(
        _columns(number, flight, axis, rule, fixed, moving)
        for number, flight in enumerate(flights)
        for axis in axes
    )
    step_s = max((one.step_s for one in columns), default=0.0)
    return LaggedRuns(columns, (*fixed, *moving), lag_and_delay(LAGS_S, DELAYS_S, step_s=step_s))


def _columns(
    number: int,
    flight: PreparedFlight,
    axis: Axis,
    rule: InstrumentRule,
    fixed: tuple[Parameter, ...],
    moving: tuple[Parameter, ...],
) -> AxisColumns:
    signals = flight.signals
    rate = signals.channel(axis.rate)
    damped = np.zeros((rate.size, len(fixed)))
    damped[:, fixed.index(axis.damping)] = -rate
    driven = DrivenSignals(signals, signals.channel(axis.torque))
    own = (axis.effectiveness, axis.reaction) if axis.reacts else (axis.effectiveness,)
    return AxisColumns(
        signals.step_s,
        flight.runs,
        time_derivative(rate, signals.step_s)[:, None],
        damped,
        LaggedTorque(signals, axis),
        of_axis(rule, axis).columns(driven),
        number,
        axis.number,
        flight.band_hz,
        flight.usable,
        tuple(moving.index(one) for one in own),
    )


def of_axis(rule: InstrumentRule, axis: Axis) -> InstrumentRule:
    """Rule of an axis: its own references, with lags that are quick enough for its motion."""
    if not isinstance(rule, LaggedReferences):
        return rule
    others = {source.channel for one in AXES if one != axis for source in one.references}
    own = tuple(name for name in rule.channels if name not in others)
    return replace(rule, channels=own or rule.channels, lags=REFERENCE_LAGS)
