"""Disturbances without randomness, and sums of disturbances: the paper's is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.linear_disturbance import RandomCoefficientMovingAverage
from eivor.simulation.sources.parameter_checks import (
    beginning_of,
    equally_many,
    finite,
    given,
    non_negative,
    positive,
    require,
)


@dataclass(frozen=True, slots=True)
class Trend(Disturbance):
    """Polynomial of the time in the record, counted from -1 at its first sample to 1 at its last.

    Parameters
    ----------
    coefficients : tuple of float
        Of the powers 0, 1, ..., in the unit of the equation.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        given("coefficients", self.coefficients)
        finite("coefficient", *self.coefficients)

    def sample(self, count: int, _step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        return np.polynomial.polynomial.polyval(np.linspace(-1.0, 1.0, count), np.array(self.coefficients))

    @property
    def variance(self) -> None:
        """None: it is not random."""
        return


@dataclass(frozen=True, slots=True)
class Sinusoids(Disturbance):
    """sum_i amplitude_i sin(frequency_i t + phase_i).

    Parameters
    ----------
    amplitudes : tuple of float
        In the unit of the equation.
    frequencies : tuple of float
        Angular [rad/s].
    phases : tuple of float
        At the first sample [rad]; zero when left out.

    Raises
    ------
    ParameterError
        When the lists differ in length, or a number is not finite.
    """

    amplitudes: tuple[float, ...]
    frequencies: tuple[float, ...]
    phases: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        given("amplitudes", self.amplitudes)
        equally_many("amplitudes", self.amplitudes, "frequencies", self.frequencies)
        if self.phases:
            equally_many("amplitudes", self.amplitudes, "phases", self.phases)
        finite("amplitude", *self.amplitudes)
        non_negative("frequency", *self.frequencies)
        finite("phase", *self.phases)

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        t = step_s * np.arange(count)
        phases = self.phases or (0.0,) * len(self.amplitudes)
        series = np.zeros(count)
        for amplitude, frequency, phase in zip(self.amplitudes, self.frequencies, phases, strict=True):
            series += amplitude * np.sin(frequency * t + phase)
        return series

    @property
    def variance(self) -> None:
        """None: it is not random."""
        return


@dataclass(frozen=True, slots=True)
class BoundedAdversary(Disturbance):
    """Unknown but bounded: always at one bound or the other, which is all that is known of it.

    It switches with a period that shrinks geometrically over the record, so that no frequency band is
    spared, and it need not have mean zero.

    Parameters
    ----------
    bound : float
        Largest absolute value, in the unit of the equation.
    longest_s, shortest_s : float
        Period at the beginning and at the end of the record [s].
    high_share : float
        Share of each period that is spent at the upper bound, from 0 to 1.

    Raises
    ------
    ParameterError
        When a number is out of range.
    """

    bound: float
    longest_s: float
    shortest_s: float
    high_share: float = 0.5

    def __post_init__(self) -> None:
        non_negative("bound", self.bound)
        positive("longest_s", self.longest_s)
        positive("shortest_s", self.shortest_s)
        require(
            self.shortest_s <= self.longest_s,
            "a shortest_s up to longest_s",
            f"shortest_s={self.shortest_s}, longest_s={self.longest_s}",
        )
        require(0.0 <= self.high_share <= 1.0, "a high_share from 0 to 1", f"high_share={self.high_share}")

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        t, duration = step_s * np.arange(count), step_s * max(count, 1)
        rate = np.log(self.longest_s / self.shortest_s) / duration
        turns = t if rate == 0.0 else np.expm1(rate * t) / rate
        high = turns / self.longest_s % 1.0 < self.high_share
        return np.where(high, self.bound, -self.bound)

    @property
    def variance(self) -> None:
        """None: it is not random."""
        return


@dataclass(frozen=True, slots=True)
class GivenDisturbance(Disturbance):
    """A user's own series, from its beginning.

    Parameters
    ----------
    values : tuple of float
        At the rate of the record, in the unit of the equation; at least as many as it has samples.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        given("values", self.values)
        finite("value", *self.values)

    def sample(self, count: int, _step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same.

        Raises
        ------
        ParameterError
            When the series is shorter than the record.
        """
        return beginning_of(self.values, count)

    @property
    def variance(self) -> None:
        """None: it is not random."""
        return


@dataclass(frozen=True, slots=True)
class SumOfDisturbances(Disturbance):
    """Several independent disturbances at once.

    Parameters
    ----------
    parts : tuple of Disturbance
        Each draws from a stream of its own.
    """

    parts: tuple[Disturbance, ...]

    def __post_init__(self) -> None:
        given("parts", self.parts)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """Sum of one realisation of each."""
        series = np.zeros(count)
        for part, stream in zip(self.parts, rng.spawn(len(self.parts)), strict=True):
            series += part.sample(count, step_s, stream)
        return series

    @property
    def variance(self) -> float | None:
        """Sum of the parts' variances; None when one has none."""
        variances = [part.variance for part in self.parts]
        return None if None in variances else sum(v for v in variances if v is not None)


def paper_disturbance(std: float = 1.0) -> SumOfDisturbances:
    """Disturbance of the paper's (34): c_1 w[k-1] + c_2 w[k-2] + sin(0.01 t) + sin(10 t).

    The random coefficients are c_1 ~ N(0, 1) and c_2 ~ N(3, 1), drawn at each sample.

    Parameters
    ----------
    std : float
        Standard deviation of w, which the paper leaves open.
    """
    moving = RandomCoefficientMovingAverage(means=(0.0, 3.0), stds=(1.0, 1.0), std=std)
    return SumOfDisturbances((moving, Sinusoids((1.0, 1.0), (0.01, 10.0))))
