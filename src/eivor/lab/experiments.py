"""Experiments of the paper and the documentation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor.errors import ParameterError
from eivor.lab.records import Scenario, check_noises, check_number, declared_noise, simulate
from eivor.models.regression import Column, Equation, Parameter
from eivor.models.signal_regression import SignalRegression
from eivor.motions.vertical.model import VerticalMotion
from eivor.signals.noise import MeasurementNoise
from eivor.signals.signals import Signals
from eivor.simulation.excitation import Disturbance, Excitation, autoregression, constant, largest_root


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
    """Vertical motion z'' = -K z' + K_u u, the paper's simulation."""

    scenario: Scenario  # What is simulated

    @property
    def truth(self) -> Mapping[str, float]:
        return {"viscous_friction": self.scenario.viscous_friction, "input_gain": self.scenario.input_gain}

    @property
    def channels(self) -> tuple[str, ...]:
        return (*self.scenario.measured, *self.scenario.references)

    def record(self, rng: np.random.Generator) -> Signals:
        return simulate(self.scenario, rng).signals

    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        """Rows (-z', u) and z'': simulated records are deviations from hover, without an intercept."""
        return VerticalMotion(intercept=False).regression(signals, instruments)


#: Channels of a record.
OUTPUT, INPUT = "output", "input"
#: Sources of randomness, in the order in which they take their streams from the record's generator.
SOURCES = ("excitation", "disturbance", OUTPUT, INPUT)
#: Largest modulus of a root: beyond it the output grows over the record.
LARGEST_ROOT = 1.0


@dataclass(frozen=True, slots=True)
class DifferenceEquation(Experiment):
    """A linear difference equation, simulated and posed as a regression."""

    output_coefficients: tuple[float, ...]
    input_coefficients: tuple[float, ...]
    excitation: Excitation
    delay: int = 1  # d, lag of the first input coefficient in samples
    samples: int = 1000  # Length of the record
    rate_hz: float = 1.0  # Samples per second [Hz]
    noise: Mapping[str, MeasurementNoise] = field(default_factory=dict)
    noise_to_signal: Mapping[str, float] = field(default_factory=dict)
    disturbance: Disturbance | None = None  # e(k), in the unit of the output

    def __post_init__(self) -> None:
        if not self.input_coefficients:
            expected = "at least one input coefficient"
            raise ParameterError(expected, "none", "Without an input nothing is excited.")
        for value in (*self.output_coefficients, *self.input_coefficients):
            check_number(True, "finite coefficients", value)
        check_number(self.delay >= 0, "a delay of zero or more samples", self.delay)
        check_number(self.rate_hz > 0.0, "rate_hz above zero", self.rate_hz)
        unknowns = len(self.output_coefficients) + len(self.input_coefficients)
        needed = unknowns + self.largest_lag
        check_number(
            self.samples >= needed, f"samples of {needed} or more for {unknowns} unknowns", self.samples
        )
        check_noises(self.noise, self.noise_to_signal, self.channels)
        root = largest_root(np.array(self.output_coefficients))
        if root >= LARGEST_ROOT:
            raise ParameterError(
                "output coefficients of a stable equation",
                f"{list(self.output_coefficients)}, with a root of modulus {root:.4g}",
                "Make them smaller: every root of z^n - a_1 z^(n-1) - ... must lie inside the unit circle.",
            )

    @property
    def channels(self) -> tuple[str, ...]:
        return OUTPUT, INPUT

    @property
    def terms(self) -> tuple[tuple[Parameter, Column], ...]:
        """Parameters, named after the channel and lag they belong to, with their columns."""
        lagged = [(OUTPUT, lag) for lag in range(1, len(self.output_coefficients) + 1)]
        lagged += [(INPUT, self.delay + number) for number in range(len(self.input_coefficients))]
        return tuple((Parameter(f"{name}_lag_{lag}"), Column(name, lag)) for name, lag in lagged)

    @property
    def truth(self) -> Mapping[str, float]:
        values = (*self.output_coefficients, *self.input_coefficients)
        return {parameter.name: value for (parameter, _), value in zip(self.terms, values, strict=True)}

    @property
    def largest_lag(self) -> int:
        """Samples that the equation reaches back."""
        return max(len(self.output_coefficients), self.delay + len(self.input_coefficients) - 1)

    def record(self, rng: np.random.Generator) -> Signals:
        """Simulate; each source has a stream of its own, whether it is used or not."""
        streams = dict(zip(SOURCES, rng.spawn(len(SOURCES)), strict=True))
        step_s = 1.0 / self.rate_hz
        true_input = self.excitation.sample(self.samples, step_s, streams["excitation"])
        driven = np.zeros(self.samples)
        if self.disturbance is not None:
            driven += self.disturbance.sample(self.samples, step_s, streams["disturbance"])
        for number, coefficient in enumerate(self.input_coefficients):
            lag = self.delay + number
            driven[lag:] += coefficient * true_input[: self.samples - lag]
        output = autoregression(driven, constant(self.output_coefficients, self.samples))
        true = {OUTPUT: output, INPUT: true_input}
        noise = declared_noise(self.noise, self.noise_to_signal, true)
        measured = {
            name: series + noise[name].sample(self.samples, streams[name]) for name, series in true.items()
        }
        return Signals(self.rate_hz, measured, noise=noise)

    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        return SignalRegression(signals, Equation(Column(OUTPUT), self.terms), instruments)
