"""Instruments of a rigid body's equations: references of an axis, and products of what references say.

A reference moves the rates and the velocity of its own axis. Couplings are products of two rates, and
translational lift is a sum of squares: their instruments are the same products of what references say of
them, by least squares on a few lags of each, which have next to nothing of a disturbance in them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.instruments import DrivenSignals, InstrumentRule, LaggedReferences, NoInstruments
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.body_velocity import body_velocity, swift_velocity
from eivor.motions.rigid_body.parameters import FORCE_X, FORCE_Z, PITCH, ROLL, YAW
from eivor.shapes import Float

#: Successive lags of references, how many and how long [s]: for turning, for forces across, and for thrust.
QUICK, SLOW, HEIGHT = (4, 0.06), (4, 1.0), (4, 0.15)
#: And of the height where a centre of mass beside the middle turns the vehicle.
TILTING = (1, 0.15)


@dataclass(frozen=True)
class AxisInstruments:
    """Instruments of every equation of one flight.

    Parameters
    ----------
    flight : PreparedFlight
        Which.
    rule : InstrumentRule
        What serves.
    """

    flight: PreparedFlight
    rule: InstrumentRule

    def of_axis(self, axis: int) -> Float[np.ndarray, "n p"]:
        """Columns for one equation; none where the rule has none."""
        if isinstance(self.rule, NoInstruments):
            return np.empty((self.flight.signals.sample_count, 0))
        if not isinstance(self.rule, LaggedReferences):
            return self.rule.columns(self._driven)
        if axis in (ROLL, PITCH, YAW):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            product = self._said_of_rate(first) * self._said_of_rate(second)
            columns = [self._lagged(axis, QUICK), product[:, None]]
            return np.column_stack([*columns, self._lagged(FORCE_Z, TILTING)] if axis != YAW else columns)
        if axis == FORCE_Z:
            across = sum((self._said_of_velocity(along) ** 2 for along in (0, 1)), np.zeros(self._count))
            return np.column_stack([self._lagged(FORCE_Z, HEIGHT), across, self._swift[:, 2]])
        along = axis - FORCE_X
        return np.column_stack([self._lagged(_TILTED[along], SLOW), self._swift[:, along]])

    @property
    def _count(self) -> int:
        return self.flight.signals.sample_count

    @property
    def _driven(self) -> DrivenSignals:
        signals = self.flight.signals
        return DrivenSignals(signals, signals.family(self.flight.input.name).mean(axis=1))

    def _lagged(self, axis: int, lags: tuple[int, float]) -> Float[np.ndarray, "n p"]:
        """References of an axis with their lags; those of no axis of turning are of height."""
        turning = {source.channel: one.number for one in AXES for source in one.references}
        if not isinstance(self.rule, LaggedReferences):
            return np.empty((self._count, 0))
        names = tuple(name for name in self.rule.channels if turning.get(name, FORCE_Z) == axis)
        return replace(self.rule, channels=names, lags=lags).columns(self._driven)

    def _said_of_rate(self, axis: int) -> Float[np.ndarray, " n"]:
        """What references say of a rate."""
        return self._said(self._lagged(axis, QUICK), self.flight.signals.channel(AXES[axis].rate))

    def _said_of_velocity(self, along: int) -> Float[np.ndarray, " n"]:
        """What references say of the velocity along an axis; nothing where it is not known."""
        if self._velocity is None:
            return np.zeros(self._count)
        references = self._lagged(FORCE_Z, HEIGHT) if along == 2 else self._lagged(_TILTED[along], SLOW)
        return self._said(references, self._velocity[:, along])

    @cached_property
    def _swift(self) -> Float[np.ndarray, "n 3"]:
        """What references say of the velocity times its size."""
        return swift_velocity(np.column_stack([self._said_of_velocity(along) for along in range(3)]))

    @cached_property
    def _velocity(self) -> Float[np.ndarray, "n 3"] | None:
        return body_velocity(self.flight.signals)

    def _said(
        self, references: Float[np.ndarray, "n p"], values: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        used = self.flight.used
        if not references.shape[1] or not used.any():
            return np.zeros(self._count)
        centred = references - references[used].mean(axis=0)
        told, *_ = np.linalg.lstsq(centred[used], values[used] - values[used].mean(), rcond=1e-10)
        return centred @ told


#: Axis of turning that tilts the thrust forward, and left.
_TILTED = (PITCH, ROLL)
