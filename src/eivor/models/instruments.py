"""Instruments: columns that move the machine and do not answer its disturbances.

A rule makes the columns of one flight from its signals, on the whole grid, before runs are cut: filters
must not start anew inside a flight.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.signals.actuator import delayed_by, first_order_lag
from eivor.signals.signals import Signals

#: Successive first-order lags of each reference: how many, and their time constant [s].
REFERENCE_LAGS = {
    "reference_position_z": (4, 0.4),
    "reference_velocity_z": (1, 0.2),
    "reference_acceleration_z": (1, 0.2),
    "feedback_reference_velocity_z": (1, 0.2),
    "pilot_throttle": (4, 0.4),
}
DEFAULT_LAGS = (1, 0.2)
LONE_LAGS = (4, 0.4)


@dataclass(frozen=True, slots=True)
class DrivenSignals:
    """What instruments are made of.

    Parameters
    ----------
    signals : Signals
        One flight.
    command : ndarray, shape (n,)
        What drives it, neither lagged nor delayed: for a multirotor the mean of the mapped commands times
        the cosine of tilt.
    """

    signals: Signals
    command: Float[np.ndarray, " n"]


class InstrumentRule(ABC):
    """Which columns serve as instruments."""

    @property
    @abstractmethod
    def label(self) -> str:
        """How reports call the choice."""

    @abstractmethod
    def columns(self, driven: DrivenSignals) -> Float[np.ndarray, "n p"]:
        """Columns on the whole grid of one flight."""


@dataclass(frozen=True, slots=True)
class LaggedReferences(InstrumentRule):
    """Each reference and successive first-order lags of it.

    Four of 0.4 s for a position or a stick, one of 0.2 s for a velocity or an acceleration; four of 0.4 s
    for whatever stands alone, since gain, friction and lag need three columns and a fourth to check them.

    Parameters
    ----------
    channels : tuple of str
        References to use, all present in the signals.
    lags : tuple of (int, float), optional
        How many lags each has, and their time constant [s]. Default: those above.
    """

    channels: tuple[str, ...]
    lags: tuple[int, float] | None = None

    @property
    def label(self) -> str:
        """Names of the references."""
        return ", ".join(self.channels)

    def columns(self, driven: DrivenSignals) -> Float[np.ndarray, "n p"]:
        """References and their lags, see `InstrumentRule.columns`."""
        found = []
        for name in self.channels:
            column = driven.signals.channel(name)
            found.append(column)
            count, lag_s = self._lags_of(name)
            for _ in range(count):
                column = first_order_lag(column, step_s=driven.signals.step_s, lag_s=lag_s)
                found.append(column)
        return np.column_stack(found) if found else np.empty((driven.signals.sample_count, 0))

    def _lags_of(self, name: str) -> tuple[int, float]:
        if self.lags is not None:
            return self.lags
        return REFERENCE_LAGS.get(name, DEFAULT_LAGS) if len(self.channels) > 1 else LONE_LAGS


@dataclass(frozen=True, slots=True)
class LaggedInputs(InstrumentRule):
    """Past mapped commands, the paper's (21): u(k - first) ... u(k - last).

    Exogenous only in open loop: in closed loop the input answers past disturbances.

    Parameters
    ----------
    first, last : int
        Lags in samples, both included.
    """

    first: int = 1
    last: int = 15

    @property
    def label(self) -> str:
        """Lags in words."""
        return f"input lagged by {self.first} to {self.last} samples"

    def columns(self, driven: DrivenSignals) -> Float[np.ndarray, "n p"]:
        """Lagged commands, see `InstrumentRule.columns`; before the record they are at rest."""
        start = driven.command[0]
        moved = (driven.command - start)[:, None]
        lagged = [delayed_by(moved, lag) for lag in range(self.first, self.last + 1)]
        return np.concatenate(lagged, axis=1) + start


@dataclass(frozen=True, slots=True)
class NoInstruments(InstrumentRule):
    """For direct methods."""

    @property
    def label(self) -> str:
        """None."""
        return "none"

    def columns(self, driven: DrivenSignals) -> Float[np.ndarray, "n p"]:
        """No columns."""
        return np.empty((driven.signals.sample_count, 0))
