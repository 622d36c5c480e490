"""Experiments of the paper and the documentation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.lab.records import Scenario, check_noises, declared_noise, simulate
from eivor.models.regression import Column, Equation, Parameter
from eivor.models.signal_regression import SignalRegression
from eivor.motions.vertical.model import VerticalMotion
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals
from eivor.simulation.excitation import Disturbance, Excitation, autoregression, constant, largest_root
from eivor.tools import Float

#: First record of several trials, whose rate, length and noises all have, and all channels side by side.
Records: TypeAlias = tuple[Signals, Mapping[str, Float[np.ndarray, "trials n"]]]


def stream(seed: int, *key: int) -> np.random.Generator:
    """Generator of a trial, or of one source of a trial: that of the number in the trial's own spawn."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


#: First value and factor of both sequences of constants of NumPy's `SeedSequence`, and factors of its mixing.
POOL_HASH, STATE_HASH, MIX = (0x43B0D7E5, 0x931E8875), (0x8B51F9DD, 0x58F38DED), (0xCA01F9DD, 0x4973F715)

Words: TypeAlias = "np.ndarray[Any, np.dtype[np.uint32]]"


class SeededState(np.random.bit_generator.ISeedSequence):
    """State that a seed sequence would generate, known before."""

    def __init__(self, words: Words) -> None:
        self.words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        return self.words.view(dtype)[:n_words]


def streams(seed: int, numbers: Sequence[int], parts: Sequence[int]) -> Iterator[np.random.Generator]:
    """Generators `stream(seed, number, part)` of each number, part by part, seeded all at once."""
    words = [seed >> shift & 0xFFFFFFFF for shift in range(0, max(seed.bit_length(), 97), 32)]
    entropy = np.empty((len(words) + 2, len(parts) * len(numbers)), dtype=np.uint32)
    entropy[:-2] = np.array(words)[:, None]
    entropy[-2] = np.tile(numbers, len(parts))
    entropy[-1] = np.repeat(parts, len(numbers))
    (first, second), hashed = np.array(MIX, dtype=np.uint32), _hash(*POOL_HASH)
    pool = [hashed(word) for word in entropy[:4]]
    pairs: list[tuple[Any, int, int]] = [(pool, i, j) for i in range(4) for j in range(4) if i != j]
    pairs += [(entropy, i, j) for i in range(4, len(entropy)) for j in range(4)]
    for source, i, j in pairs:
        mixed = first * pool[j] - second * hashed(source[i])
        pool[j] = mixed ^ mixed >> np.uint32(16)
    hashed = _hash(*STATE_HASH)
    for state in np.stack([hashed(pool[i % 4]) for i in range(8)], axis=1):
        seeded: Any = SeededState(state)
        yield np.random.Generator(np.random.PCG64(seeded))


def _hash(value: int, factor: int) -> Callable[[Words], Words]:
    """A hash whose constants change from call to call."""

    def hashed(word: Words) -> Words:
        nonlocal value
        previous, value = value, value * factor & 0xFFFFFFFF
        word = (word ^ np.uint32(previous)) * np.uint32(value)
        return word ^ word >> np.uint32(16)

    return hashed


class Experiment(ABC):
    """What a trial repeats: a record with new noises, and an equation to estimate from it."""

    samples: int  # Length of the record

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

    def records(self, seed: int, numbers: Sequence[int]) -> Records | None:
        """Records of trials, those of `record`; None where they are not alike, with white noises."""
        signals = [self.record(stream(seed, number)) for number in numbers]
        first, white = signals[0], all(isinstance(noise, WhiteNoise) for noise in signals[0].noise.values())
        if not white or first.valid is not None or any(item.noise != first.noise for item in signals):
            return None
        return first, {name: np.stack([item.channels[name] for item in signals]) for name in first.channels}


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

    @property
    def samples(self) -> int:  # type: ignore[override]
        return self.scenario.samples

    def record(self, rng: np.random.Generator) -> Signals:
        return simulate(self.scenario, rng).signals

    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        return VerticalMotion(intercept=False).regression(signals, instruments)


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
        checks.finite("coefficient", *self.output_coefficients, *self.input_coefficients)
        checks.require(self.delay >= 0, "a delay of zero or more samples", f"{self.delay}")
        checks.positive("rate_hz", self.rate_hz)
        outputs, inputs = len(self.output_coefficients), len(self.input_coefficients)
        unknowns = outputs + inputs
        needed = unknowns + max(outputs, self.delay + inputs - 1)
        expected = f"samples of {needed} or more for {unknowns} unknowns"
        checks.require(self.samples >= needed, expected, f"samples={self.samples}")
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

    def record(self, rng: np.random.Generator) -> Signals:
        """Simulate; each source has a stream of its own, whether it is used or not."""
        sources = rng.spawn(len(SOURCES))
        true = {name: series[0] for name, series in self._true([sources]).items()}
        noise = declared_noise(self.noise, self.noise_to_signal, true)
        errors = zip(self.channels, sources[2:], strict=True)
        measured = {name: true[name] + noise[name].sample(self.samples, rng) for name, rng in errors}
        return Signals(self.rate_hz, measured, noise=noise)

    def records(self, seed: int, numbers: Sequence[int]) -> Records | None:
        noise = declared_noise(self.noise, {}, dict.fromkeys(self.channels, np.empty(0)))
        white = [item for item in noise.values() if isinstance(item, WhiteNoise)]
        if self.noise_to_signal or len(white) < len(noise):
            return None
        is_builtin = type(self.excitation).__module__ == Excitation.__module__ and self.disturbance is None
        sources = [] if is_builtin else [[stream(seed, number, i) for i in (0, 1)] for number in numbers]
        noisy = [source for source, name in enumerate(SOURCES) if name in noise and noise[name].std]
        generators = streams(seed, numbers, noisy if sources else (0, *noisy))
        channels = self._true(sources or ([next(generators)] for _ in numbers))
        for name in (SOURCES[source] for source in noisy):
            for series in channels[name]:
                np.add(series, noise[name].sample(self.samples, next(generators)), out=series)
        first = {name: series[0] for name, series in channels.items()}
        return Signals(self.rate_hz, first, noise=noise), channels

    def _true(
        self, sources: Iterable[Sequence[np.random.Generator]]
    ) -> dict[str, Float[np.ndarray, "trials n"]]:
        """Channels without noise of records, each with its streams."""
        step_s, inputs, pushes = 1.0 / self.rate_hz, [], []
        for generators in sources:
            inputs.append(self.excitation.sample(self.samples, step_s, generators[0]))
            if self.disturbance is not None:
                pushes.append(self.disturbance.sample(self.samples, step_s, generators[1]))
        true_input = np.stack(inputs)
        driven = np.stack(pushes) if pushes else np.zeros(true_input.shape)
        for number, coefficient in enumerate(self.input_coefficients):
            lag = self.delay + number
            driven[:, lag:] += coefficient * true_input[:, : self.samples - lag]
        output = autoregression(driven.T, constant(self.output_coefficients, self.samples)).T
        return {OUTPUT: np.ascontiguousarray(output), INPUT: true_input}

    def problem(self, signals: Signals, instruments: tuple[Column, ...]) -> SignalRegression:
        return SignalRegression(signals, Equation(Column(OUTPUT), self.terms), instruments)
