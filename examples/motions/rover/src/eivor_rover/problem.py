"""Columns of the rover's equation: v' = a u - c v - d sign(v)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns, LaggedRuns, lag_and_delay
from eivor.models.regression import Parameter
from eivor.models.separable import DrivenSignals, InstrumentRule, Values
from eivor.signals.filters import actuator_state
from eivor.signals.signals import Signals
from eivor_rover.channels import ACCELERATION, SPEED

PARAMETERS = (
    Parameter("rolling_drag", "1/s"),
    Parameter("dry_friction", "m/s^2"),
    Parameter("drive_gain", "m/s^2"),
)


@dataclass(frozen=True)
class LaggedDrive:
    """Mean of the motors' states, for a lag and a delay.

    Parameters
    ----------
    signals : Signals
        The drive.
    family : str
        Channels of the command.
    """

    signals: Signals
    family: str

    def __call__(self, nuisance_values: Values) -> np.ndarray:
        """U, shape (n, 1)."""
        state = actuator_state(
            self.signals.family(self.family),
            step_s=self.signals.step_s,
            lag_s=nuisance_values[ACTUATOR_LAG.name],
            delay_s=nuisance_values[DELAY.name],
        )
        return state.mean(axis=1, keepdims=True)


def rover_runs(flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> LaggedRuns:
    """Return the regressions of drives for each lag and delay."""
    columns = tuple(_columns(number, flight, rule) for number, flight in enumerate(flights))
    return LaggedRuns(columns, PARAMETERS, lag_and_delay())


def _columns(number: int, flight: PreparedFlight, rule: InstrumentRule) -> AxisColumns:
    signals = flight.signals
    speed = signals.channel(SPEED)
    responses = [np.gradient(speed, signals.step_s)]
    if ACCELERATION in signals.channels:
        responses.insert(0, signals.channel(ACCELERATION))
    drive = LaggedDrive(signals, flight.input.name)
    command = signals.family(flight.input.name).mean(axis=1)
    instruments = rule.columns(DrivenSignals(signals, command))
    return AxisColumns(
        signals.step_s,
        flight.runs,
        np.column_stack(responses),
        np.column_stack([-speed, -np.sign(speed)]),
        drive,
        # what moves the speed to and fro moves its sign too, but by a curve: the signs tell the two apart
        np.column_stack([instruments, np.sign(instruments)]),
        number,
        band_hz=flight.band_hz,
        valid=flight.usable,
    )
