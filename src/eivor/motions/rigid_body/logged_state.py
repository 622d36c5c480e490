"""The state of a body as its flight logged it, as far as it did."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.dynamics import BODY
from eivor.shapes import Float

_ATTITUDE = tuple(f"attitude_{part}" for part in "wxyz")
_VELOCITY = tuple(f"velocity_{axis}" for axis in "xyz")
_POSITION = tuple(f"position_{axis}" for axis in "xyz")


@dataclass(frozen=True)
class LoggedState:
    """Position, velocity, attitude and rates on a flight's grid.

    Parameters
    ----------
    flight : PreparedFlight
        Of which log.
    """

    flight: PreparedFlight

    @property
    def turns(self) -> bool:
        """Whether the attitude is logged."""
        return self._has(_ATTITUDE)

    @property
    def moves(self) -> bool:
        """Whether velocity and attitude are."""
        return self.turns and self._has(_VELOCITY)

    @property
    def placed(self) -> tuple[int, ...]:
        """Axes along which the position is logged, from 0."""
        return tuple(axis for axis, name in enumerate(_POSITION) if self._has((name,)))

    @cached_property
    def body(self) -> Float[np.ndarray, "13 n"]:
        """The state at every sample.

        What is not logged at all is at rest, and level; what was not logged at a sample is NaN, but for the
        rates and for what the equations rest on: samples without these are not usable.
        """
        body = np.zeros((BODY, self.flight.signals.sample_count))
        body[6] = 1.0
        for axis in self.placed:
            body[axis] = self._channel(_POSITION[axis])
        if self.moves:
            body[3:6] = [self._channel(name) for name in _VELOCITY]
        if self.turns:
            body[6:10] = [self._channel(name) for name in _ATTITUDE]
            length = np.sqrt((body[6:10] ** 2).sum(axis=0))
            body[6:10] /= np.where(length > 0.0, length, 1.0)
        body[10:13] = [self.flight.signals.channel(axis.rate) for axis in AXES]
        return body

    def _has(self, names: tuple[str, ...]) -> bool:
        known = self.flight.recording.channels
        return all(name in known and np.isfinite(known[name].values).any() for name in names)

    def _channel(self, name: str) -> Float[np.ndarray, " n"]:
        """Values on the grid; those that the motion did not select are NaN where they stand on nothing."""
        signals = self.flight.signals
        if name in signals.channels:
            return signals.channel(name)
        values, good = on_grid(self.flight.recording.channel(name), self.flight.grid)
        return np.where(good, values, np.nan)
