"""Disturbances that are linear in white noise, with constant, changing or random coefficients.

Sign convention of every recursion: x[k] = sum_i a_i x[k-i] + w[k] + sum_j b_j w[k-j], so that a positive
coefficient is a positive correlation. The shocks w are white and normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.coefficient_course import Course
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.parameter_checks import equally_many, finite, given, non_negative, require
from eivor.simulation.sources.recursion import autoregression, constant, largest_root

#: Times of the record at which changing coefficients are checked.
CHECKED = 257


@dataclass(frozen=True, slots=True)
class Arma(Disturbance):
    """Autoregressive moving average, stationary from its first sample.

    Parameters
    ----------
    std : float
        Standard deviation of the shocks w, in the unit of the equation.
    autoregression : tuple of float
        a_1, a_2, ...
    moving_average : tuple of float
        b_1, b_2, ...

    Raises
    ------
    ParameterError
        When a number is not finite, or the autoregression is not stationary.
    """

    std: float
    autoregression: tuple[float, ...] = ()
    moving_average: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        non_negative("std", self.std)
        finite("coefficient of autoregression", *self.autoregression)
        finite("coefficient of moving_average", *self.moving_average)
        root = largest_root(np.array(self.autoregression))
        require(
            root < 1.0,
            "a stationary autoregression, whose modes all die out",
            f"autoregression={self.autoregression}, whose slowest mode is multiplied by {root:.4g} each step",
            "Make the coefficients smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation; the state before the record is drawn from its stationary distribution."""
        transition, _, covariance = self._state_space()
        eigenvalues, vectors = np.linalg.eigh(covariance)
        before = vectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(eigenvalues.size))
        shocks = rng.standard_normal(count)
        driven = np.convolve(np.concatenate([[1.0], self.moving_average]), shocks)[:count]
        echo = (transition @ before)[:count]
        driven[: echo.size] += echo
        return self.std * autoregression(driven, constant(self.autoregression, count))

    @property
    def variance(self) -> float:
        """Variance of the stationary series."""
        return self.std**2 * float(self._state_space()[2][0, 0])

    def _state_space(
        self,
    ) -> tuple[Float[np.ndarray, "r r"], Float[np.ndarray, " r"], Float[np.ndarray, "r r"]]:
        """Transition, input and stationary covariance of Harvey's form, whose first state is x."""
        from scipy.linalg import solve_discrete_lyapunov

        r = max(len(self.autoregression), len(self.moving_average) + 1)
        transition = np.eye(r, k=1)
        transition[: len(self.autoregression), 0] = self.autoregression
        shock = np.zeros(r)
        shock[: len(self.moving_average) + 1] = (1.0, *self.moving_average)
        covariance = solve_discrete_lyapunov(transition, np.outer(shock, shock))
        return transition, shock, covariance


@dataclass(frozen=True, slots=True)
class TimeVaryingArma(Disturbance):
    """Autoregressive moving average whose coefficients depend on time; zero before the record.

    Parameters
    ----------
    std : float
        Standard deviation of the shocks w, in the unit of the equation.
    autoregression, moving_average : tuple of Course
        Of a_1, a_2, ... and b_1, b_2, ...: sinusoids where no kind is named.

    Raises
    ------
    ParameterError
        When the autoregression, held at what it is at some time of the record, would not be stationary.
    """

    std: float
    autoregression: tuple[Course, ...] = ()
    moving_average: tuple[Course, ...] = ()

    def __post_init__(self) -> None:
        non_negative("std", self.std)
        known = [one.longest for one in self.autoregression if one.longest is not None]
        courses = self._courses(self.autoregression, min(known, default=CHECKED))
        times = np.linspace(0, len(courses) - 1, min(len(courses), CHECKED)).round().astype(np.int64)
        root = max((largest_root(row) for row in courses[times]), default=0.0)
        require(
            root < 1.0,
            "an autoregression that is stationary at every time of the record",
            f"one whose slowest mode is multiplied by up to {root:.4g} each step",
            "Make the means or amplitudes smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation."""
        shocks = rng.standard_normal(count)
        driven = shocks.copy()
        for lag, course in enumerate(self.moving_average[: count - 1], start=1):
            driven[lag:] += course.values(count)[lag:] * shocks[:-lag]
        return self.std * autoregression(driven, self._courses(self.autoregression, count))

    @property
    def variance(self) -> None:
        """None: it changes with time."""
        return

    @staticmethod
    def _courses(courses: tuple[Course, ...], count: int) -> Float[np.ndarray, "count lags"]:
        return np.array([course.values(count) for course in courses]).reshape(len(courses), count).T


@dataclass(frozen=True, slots=True)
class RandomCoefficientMovingAverage(Disturbance):
    """x[k] = sum_j c_j(k) w[k-j], j = 1, 2, ..., with coefficients drawn anew at each sample.

    Parameters
    ----------
    means, stds : tuple of float
        Of the normal coefficients c_1, c_2, ... (the paper's: 0 and 3, 1 and 1).
    std : float
        Standard deviation of w, in the unit of the equation.

    Raises
    ------
    ParameterError
        When a number is out of range, or there are not as many stds as means.
    """

    means: tuple[float, ...] = (0.0, 3.0)
    stds: tuple[float, ...] = (1.0, 1.0)
    std: float = 1.0

    def __post_init__(self) -> None:
        given("means", self.means)
        equally_many("means", self.means, "stds", self.stds)
        finite("mean of a coefficient", *self.means)
        non_negative("std of a coefficient", *self.stds)
        non_negative("std", self.std)

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation; w exists before the record."""
        order = len(self.means)
        shocks = rng.standard_normal(count + order)
        series = np.zeros(count)
        for lag, (mean, std) in enumerate(zip(self.means, self.stds, strict=True), start=1):
            series += (mean + std * rng.standard_normal(count)) * shocks[order - lag : order - lag + count]
        return self.std * series

    @property
    def variance(self) -> float:
        """std^2 sum_j (mean_j^2 + std_j^2)."""
        squares = (mean**2 + std**2 for mean, std in zip(self.means, self.stds, strict=True))
        return self.std**2 * sum(squares)
