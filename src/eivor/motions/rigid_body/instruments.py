"""Instruments of a rigid body's equations: what exogenous signals say of the equations' own columns.

Of turning they are the columns of the predicted flight, which has no disturbance in it: what an equation has
there is nearest to what it has in the flight itself, be it a gain, a product of rates, or damping. Lag and
delay are sought, so that columns that move with them are there for several lags, whose differences tell the
lag. What disturbs a force hardly comes back through the controller: there references with a few lags serve as
they are, and for what goes with products of velocities those of the predicted ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.instruments import DrivenSignals, InstrumentRule, LaggedReferences, NoInstruments
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Values
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.across import lift_moments
from eivor.motions.rigid_body.beside import drag_moments, spin_moment
from eivor.motions.rigid_body.body_velocity import body_velocity, swift_velocity
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.parameters import FORCE_X, FORCE_Z, YAW
from eivor.motions.rigid_body.predicted import HEIGHT, SLOW, TILTED, Predictors, predicted_flight
from eivor.shapes import Float

#: Lags for which columns are instruments; delays, of a state that was measured [s].
LAGS_S = (0.01, 0.03, 0.07, 0.15)
DELAYS_S = (-0.02, 0.0, 0.02)

#: The moving columns of an equation in some flight, at a lag and a delay.
Columns = Callable[[Values], Float[np.ndarray, "n k"]]


@dataclass(frozen=True)
class AxisInstruments:
    """Instruments of every equation of one flight.

    Parameters
    ----------
    flight : PreparedFlight
        Which.
    layout : RotorLayout
        Of its rotors.
    rule : InstrumentRule
        What serves.
    """

    flight: PreparedFlight
    layout: RotorLayout
    rule: InstrumentRule

    def of_axis(self, axis: int, columns_of: Callable[[PreparedFlight], Columns]) -> Float[np.ndarray, "n p"]:
        """Columns for one equation; none where the rule has none.

        Parameters
        ----------
        axis : int
            Number of the equation.
        columns_of : callable
            From a flight to the equation's moving columns.
        """
        signals = self.flight.signals
        if isinstance(self.rule, NoInstruments):
            return np.empty((signals.sample_count, 0))
        if not isinstance(self.rule, LaggedReferences):
            level = signals.family(self.flight.input.name).mean(axis=1)
            return self.rule.columns(DrivenSignals(signals, level))
        if axis < FORCE_X:
            return self._turning(axis, columns_of(self._predicted))
        says = Predictors(self.flight, self.rule)
        if axis == FORCE_Z:
            across = self._velocity[:, 0] ** 2 + self._velocity[:, 1] ** 2
            return np.column_stack([says.of_axis(FORCE_Z, HEIGHT), across, self._swift[:, 2]])
        along = axis - FORCE_X
        return np.column_stack([says.of_axis(TILTED[along], SLOW), self._swift[:, along]])

    @cached_property
    def _predicted(self) -> PreparedFlight:
        if not isinstance(self.rule, LaggedReferences):
            return self.flight
        return predicted_flight(self.flight, self.layout, self.rule)

    def _turning(self, axis: int, moving: Columns) -> Float[np.ndarray, "n p"]:
        """Columns for several lags, and the product of the other two rates."""
        measured = self.flight.input.measured
        nodes = [(0.0, delay) for delay in DELAYS_S] if measured else [(lag, 0.0) for lag in LAGS_S]
        columns = [moving({ACTUATOR_LAG.name: lag, DELAY.name: delay}) for lag, delay in nodes]
        first, second = (self._predicted.signals.channel(AXES[(axis + n) % 3].rate) for n in (1, 2))
        return np.column_stack([*columns, first * second, *self._spun(axis), *self._moments(axis)])

    def _spun(self, axis: int) -> list[Float[np.ndarray, " n"]]:
        """What rotors that spin turn in the predicted flight."""
        if axis == YAW:
            return []
        signals = self._predicted.signals
        rates = np.stack([signals.channel(one.rate) for one in AXES])
        return [spin_moment(axis, rates, signals.family(self.flight.input.name) @ self.layout.yaw)]

    def _moments(self, axis: int) -> list[Float[np.ndarray, " n"]]:
        """What drag and lift turn in the predicted flight, where velocity is known."""
        signals = self._predicted.signals
        if body_velocity(signals) is None:
            return []
        dragged = [*drag_moments(axis, self._velocity.T)]
        if axis == YAW:
            return dragged
        lifted = lift_moments(self.layout, self._velocity.T, signals.channel(AXES[YAW].rate))
        return [*dragged, lifted[axis]]

    @cached_property
    def _velocity(self) -> Float[np.ndarray, "n 3"]:
        """Predicted velocity on the body's axes; zero where it is not known."""
        found = body_velocity(self._predicted.signals)
        return np.zeros((self.flight.signals.sample_count, 3)) if found is None else found

    @cached_property
    def _swift(self) -> Float[np.ndarray, "n 3"]:
        """Predicted velocity times its size."""
        return swift_velocity(self._velocity)
