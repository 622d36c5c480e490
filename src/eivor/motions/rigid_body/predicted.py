"""The flight that exogenous signals alone would have flown, as far as they tell it.

Commands of the rotors, rates and velocity of a flight hold its disturbances, and the controller's answers to
them. Their predictions, from references and injected torques, hold none: each block of the flight is
predicted by what the others say (`eivor.models.cross_fitted`). A reference moves its own axis, so that rotors
are predicted by parts: what lifts, and what turns about each axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.models.cross_fitted import cross_fitted
from eivor.models.instruments import DrivenSignals, LaggedReferences
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.body_velocity import body_velocity
from eivor.motions.rigid_body.layout import RotorLayout
from eivor.motions.rigid_body.parameters import FORCE_Z, PITCH, ROLL, YAW
from eivor.shapes import Float

#: Successive lags of references, how many and how long [s]: for turning, for velocity across, for height.
QUICK, SLOW, HEIGHT = (14, 0.04), (4, 1.0), (4, 0.15)
#: Axis of turning that tilts the thrust forward, and left.
TILTED = (PITCH, ROLL)


@dataclass(frozen=True)
class Predictors:
    """Exogenous signals of one flight, with their lags.

    Parameters
    ----------
    flight : PreparedFlight
        Which.
    rule : LaggedReferences
        What serves.
    """

    flight: PreparedFlight
    rule: LaggedReferences

    def of_axis(self, axis: int, lags: tuple[int, float]) -> Float[np.ndarray, "n p"]:
        """References of an axis with their lags; those of no axis of turning are of height."""
        turning = {source.channel: one.number for one in AXES for source in one.references}
        names = tuple(name for name in self.rule.channels if turning.get(name, FORCE_Z) == axis)
        signals = self.flight.signals
        driven = DrivenSignals(signals, np.zeros(signals.sample_count))
        return replace(self.rule, channels=names, lags=lags).columns(driven)

    def predicted(
        self, values: Float[np.ndarray, " n"], axis: int, lags: tuple[int, float]
    ) -> Float[np.ndarray, " n"]:
        """Prediction by the references of one axis, within what the values were."""
        used = self.flight.used
        found = cross_fitted(self.of_axis(axis, lags), values[:, None], used)[:, 0]
        return np.clip(found, values[used].min(), values[used].max()) if used.any() else found


def predicted_flight(flight: PreparedFlight, layout: RotorLayout, rule: LaggedReferences) -> PreparedFlight:
    """The same flight with predictions in place of its commands, rates and velocity.

    It is level throughout, so that its velocity in the world is the one that is predicted on the body's axes.

    Parameters
    ----------
    flight : PreparedFlight
        Which.
    layout : RotorLayout
        Of its rotors.
    rule : LaggedReferences
        What predicts.
    """
    signals, says = flight.signals, Predictors(flight, rule)
    channels = dict(signals.channels)
    for axis in (ROLL, PITCH, YAW):
        name = AXES[axis].rate
        channels[name] = says.predicted(signals.channel(name), axis, QUICK)
    channels |= _rotors(flight, layout, says)
    velocity = body_velocity(signals)
    if velocity is not None:
        for along, (axis, lags) in enumerate(((TILTED[0], SLOW), (TILTED[1], SLOW), (FORCE_Z, HEIGHT))):
            channels[f"velocity_{'xyz'[along]}"] = says.predicted(velocity[:, along], axis, lags)
        for part in "wxyz":
            channels[f"attitude_{part}"] = np.full(signals.sample_count, float(part == "w"))
    return replace(flight, signals=replace(signals, channels=channels))


def _rotors(
    flight: PreparedFlight, layout: RotorLayout, says: Predictors
) -> dict[str, Float[np.ndarray, " n"]]:
    """Commands of the rotors, put together of what lifts and what turns."""
    logged = flight.signals.family(flight.input.name)
    parts = np.column_stack([layout.roll, layout.pitch, layout.yaw, np.ones(layout.count)])
    shares = np.linalg.lstsq(parts, logged.T, rcond=None)[0].T
    chosen = ((ROLL, QUICK), (PITCH, QUICK), (YAW, QUICK), (FORCE_Z, HEIGHT))
    told = [says.predicted(share, axis, lags) for share, (axis, lags) in zip(shares.T, chosen, strict=True)]
    rotors = np.clip(np.column_stack(told) @ parts.T, logged[flight.used].min(), logged[flight.used].max())
    return {f"{flight.input.name}_{number + 1}": column for number, column in enumerate(rotors.T)}
