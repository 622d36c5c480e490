"""Courses of coefficients over a record: what C(t, q) and D(t, q) of the paper's (19) are at each sample."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.parameter_checks import beginning_of, finite, given


class Course(ABC):
    """A coefficient that changes over a record."""

    @property
    def longest(self) -> int | None:
        """Samples that it is known for; None for a record of any length."""
        return None

    @abstractmethod
    def values(self, count: int) -> Float[np.ndarray, " count"]:
        """Coefficient at each sample of a record of that length."""


@dataclass(frozen=True, slots=True)
class CoefficientCourse(Course):
    """Course of a coefficient over a record: mean + amplitude sin(2 pi cycles k / N + phase).

    Parameters
    ----------
    mean, amplitude : float
        Pure numbers.
    cycles : float
        Periods in the record of N samples.
    phase : float
        At the first sample [rad].
    """

    mean: float = 0.0
    amplitude: float = 0.0
    cycles: float = 1.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        finite("mean", self.mean)
        finite("amplitude", self.amplitude)
        finite("cycles", self.cycles)
        finite("phase", self.phase)

    def values(self, count: int) -> Float[np.ndarray, " count"]:
        """Coefficient at each sample."""
        turns = self.cycles * np.arange(count) / count
        return self.mean + self.amplitude * np.sin(2.0 * np.pi * turns + self.phase)


@dataclass(frozen=True, slots=True)
class GivenCourse(Course):
    """A coefficient's own series, from the record's beginning.

    Parameters
    ----------
    series : tuple of float
        At least as many as the record has samples.
    """

    series: tuple[float, ...]

    def __post_init__(self) -> None:
        given("series", self.series)
        finite("value", *self.series)

    @property
    def longest(self) -> int:
        """Length of the series."""
        return len(self.series)

    def values(self, count: int) -> Float[np.ndarray, " count"]:
        """Beginning of the series.

        Raises
        ------
        ParameterError
            When it is shorter than the record.
        """
        return beginning_of(self.series, count)


@dataclass(frozen=True, slots=True)
class SumOfCourses(Course):
    """Several courses, added: more than one sinusoid, say.

    Parameters
    ----------
    parts : tuple of Course
        Each with its kind.
    """

    parts: tuple[Course, ...]

    def __post_init__(self) -> None:
        given("parts", self.parts)

    @property
    def longest(self) -> int | None:
        """Length of the shortest part that has one."""
        return min((part.longest for part in self.parts if part.longest is not None), default=None)

    def values(self, count: int) -> Float[np.ndarray, " count"]:
        """Sum of the parts."""
        return np.sum([part.values(count) for part in self.parts], axis=0)
