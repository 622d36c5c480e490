"""Known onboard low-passes, on the model's side of the equations.

What a gyroscope or an accelerometer logs has passed a filter on board. So that both sides of an equation
pass it, the columns that the rotors drive pass it too; those that are made of filtered rates have passed it
already, and the measured side is never touched. Readers take the delay of some filters off the stamps: only
what is left of the filter is applied then.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.equation import Parameter
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.parameters import ALONG, DRIVING, FORCE_X
from eivor.shapes import Float
from eivor.signals.actuator import shifted_by
from eivor.signals.low_pass import low_passed


@dataclass(frozen=True, slots=True)
class OnboardFilter:
    """A low-pass of second order that one axis' sensor has.

    Parameters
    ----------
    step_s : float
        Step of the grid [s].
    cutoff_hz : float
        Of the filter [Hz].
    taken_s : float
        Delay that has been taken off the sensor's stamps [s]; of it the filter's own counts.
    """

    step_s: float
    cutoff_hz: float
    taken_s: float

    def __call__(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return a column as the sensor would have logged it."""
        late = low_passed(column[:, None], step_s=self.step_s, cutoff_hz=self.cutoff_hz)
        own_s = math.sqrt(2.0) / (2.0 * math.pi * self.cutoff_hz)
        early_s = min(max(self.taken_s, 0.0), own_s)
        return (shifted_by(late, step_s=self.step_s, delay_s=-early_s) if early_s else late)[:, 0]


def onboard_filter(flight: PreparedFlight, vehicle: KnownVehicle, axis: int) -> OnboardFilter | None:
    """Filter of the sensor whose values an equation explains; None where none is known."""
    turning = axis < FORCE_X
    cutoff_hz = vehicle.gyro_cutoff_hz if turning else vehicle.accelerometer_cutoff_hz
    if cutoff_hz is None:
        return None
    name = AXES[axis].rate if turning else f"specific_force_body_{ALONG[axis - FORCE_X]}"
    return OnboardFilter(flight.signals.step_s, cutoff_hz, flight.recording.channel(name).delay_s)


def as_logged(
    columns: Mapping[Parameter, Float[np.ndarray, " n"]], axis: int, sensor: OnboardFilter | None
) -> dict[Parameter, Float[np.ndarray, " n"]]:
    """Columns of an equation, those behind its sensor's filter that are not made of filtered rates."""
    if sensor is None:
        return dict(columns)
    return {
        one: sensor(values) if axis >= FORCE_X or one in DRIVING else values
        for one, values in columns.items()
    }
