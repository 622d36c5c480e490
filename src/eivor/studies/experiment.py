"""Experiments: machines whose parameters are known, recorded with noise, and the problem they pose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.models.column import Column
from eivor.models.signal_regression import SignalRegression
from eivor.motions.vertical.model import VerticalMotion
from eivor.signals.signals import Signals
from eivor.simulation.records.scenario import Scenario
from eivor.simulation.records.simulate import simulate


class Experiment(ABC):
    """What a trial repeats: a record with new noises, and an equation to estimate from it."""

    @property
    @abstractmethod
    def truth(self) -> Mapping[str, float]:
        """True value of each parameter, in the order of the equation."""

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Channels of every record, all with a declared noise."""

    @abstractmethod
    def record(self, rng: np.random.Generator) -> Signals:
        """One record, with the noises that were really added declared."""

    @abstractmethod
    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        """Rows of the equation in a record."""


@dataclass(frozen=True, slots=True)
class VerticalExperiment(Experiment):
    """Vertical motion z'' = -K z' + K_u u, the paper's simulation.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    """

    scenario: Scenario

    @property
    def truth(self) -> Mapping[str, float]:
        """K and K_u."""
        return {
            "viscous_friction": self.scenario.viscous_friction,
            "input_gain": self.scenario.input_gain,
        }

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured channels, and under control the reference."""
        return (*self.scenario.measured, *self.scenario.references)

    @property
    def exogenous_channel(self) -> str:
        """What the vehicle does not answer: the input in open loop, the reference under control."""
        return self.scenario.control.reference

    def record(self, rng: np.random.Generator) -> Signals:
        """Simulate, see `eivor.simulation.records.simulate`."""
        return simulate(self.scenario, rng).signals

    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        """Rows (-z', u) and z'': simulated records are deviations from hover, without an intercept."""
        return VerticalMotion(intercept=False).regression(signals, instruments)
