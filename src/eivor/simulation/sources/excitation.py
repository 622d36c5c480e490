"""Excitations: inputs, and references, that make a machine tell its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.parameter_checks import (
    beginning_of,
    finite,
    given,
    non_negative,
    positive,
    require,
)


class Excitation(ABC):
    """A series on a uniform grid."""

    @abstractmethod
    def sample(self, count: int, step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation on a grid of that step [s]."""


@dataclass(frozen=True, slots=True)
class PaperInput(Excitation):
    """The paper's (35): u(t_k) = 0.7 w(t_{k-1}) + 0.49 w(t_{k-2}) + sin(0.1 t_k^1.1), t in seconds.

    Parameters
    ----------
    variance : float
        Variance of the white sequence w.
    """

    variance: float = 0.02

    def __post_init__(self) -> None:
        non_negative("variance", self.variance)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation; w exists before the record."""
        w = np.sqrt(self.variance) * rng.standard_normal(count + 2)
        t = step_s * np.arange(count)
        return 0.7 * w[1:-1] + 0.49 * w[:-2] + np.sin(0.1 * t**1.1)


@dataclass(frozen=True, slots=True)
class WhiteExcitation(Excitation):
    """Independent normal values.

    Parameters
    ----------
    std : float
        Standard deviation.
    """

    std: float = 1.0

    def __post_init__(self) -> None:
        non_negative("std", self.std)

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation."""
        return self.std * rng.standard_normal(count)


@dataclass(frozen=True, slots=True)
class Steps(Excitation):
    """Levels that are held one after the other, over and over.

    Parameters
    ----------
    levels : tuple of float
        In the order in which they come.
    dwell_s : float
        Time on each [s].
    """

    levels: tuple[float, ...]
    dwell_s: float

    def __post_init__(self) -> None:
        given("levels", self.levels)
        finite("level", *self.levels)
        positive("dwell_s", self.dwell_s)

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        # A step that falls on a sample, but for rounding, is taken there.
        number = np.floor(np.arange(count) * (step_s / self.dwell_s) + 1e-9).astype(np.int64)
        return np.array(self.levels)[number % len(self.levels)]


@dataclass(frozen=True, slots=True)
class RandomSteps(Excitation):
    """Levels drawn one after the other: an amplitude up, down, or nothing.

    Parameters
    ----------
    amplitude : float
        Of the levels that are not zero; those are two in three.
    shortest_s, longest_s : float
        Between these, each level's time is drawn [s].
    """

    amplitude: float
    shortest_s: float = 0.5
    longest_s: float = 1.5

    def __post_init__(self) -> None:
        non_negative("amplitude", self.amplitude)
        positive("shortest_s", self.shortest_s)
        finite("longest_s", self.longest_s)
        require(
            self.shortest_s <= self.longest_s,
            "a shortest_s up to longest_s",
            f"shortest_s={self.shortest_s}, longest_s={self.longest_s}",
        )

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation, which begins with zero."""
        most = int(count * step_s / self.shortest_s) + 1
        ends = np.cumsum(rng.uniform(self.shortest_s, self.longest_s, most))
        levels = self.amplitude * rng.integers(-1, 2, most + 1).astype(np.float64)
        levels[0] = 0.0
        return levels[np.searchsorted(ends, step_s * np.arange(count), side="right")]


@dataclass(frozen=True, slots=True)
class GivenSeries(Excitation):
    """A user's own series, from its beginning.

    Parameters
    ----------
    values : tuple of float
        At the rate of the record, at least as many as it has samples.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        given("values", self.values)
        finite("value", *self.values)

    def sample(self, count: int, _step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """Draw nothing: it is always the same."""
        return beginning_of(self.values, count)


@dataclass(frozen=True, slots=True)
class ScaledExcitation(Excitation):
    """Another excitation, scaled to a standard deviation that each realisation has exactly.

    Parameters
    ----------
    series : Excitation
        Its shape.
    std : float
        Standard deviation over the record.
    """

    series: Excitation
    std: float

    def __post_init__(self) -> None:
        non_negative("std", self.std)

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        series = self.series.sample(count, step_s, rng)
        spread = float(series.std())
        require(spread > 0.0, "a series that varies, since it is to be scaled", "a constant one")
        return self.std / spread * series
