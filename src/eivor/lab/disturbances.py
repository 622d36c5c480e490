"""Simulated disturbances: gusts, volatility, linear and nonlinear processes."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy

from eivor.checks import finite, given, in_ranges, non_negative, positive, require
from eivor.simulation import excitation
from eivor.simulation.environment import gusts
from eivor.tools import Float


@dataclass(frozen=True, slots=True)
class CoefficientCourse:
    """Course of a coefficient over a record: mean + amplitude sin(2 pi cycles k / N + phase)."""

    mean: excitation.Finite = 0.0  # Pure numbers
    amplitude: excitation.Finite = 0.0
    cycles: excitation.Finite = 1.0  # Periods in the record of N samples
    phase: excitation.Finite = 0.0  # At the first sample [rad]

    def __post_init__(self) -> None:
        in_ranges(self)

    def values(self, count: int) -> Float[np.ndarray, " count"]:
        """Coefficient at each sample of a record of that length."""
        turns = self.cycles * np.arange(count) / count
        return self.mean + self.amplitude * np.sin(2.0 * np.pi * turns + self.phase)


#: Length of a record over which changing coefficients are checked.
CHECKED = 257


@dataclass(frozen=True, slots=True)
class Arma(excitation.Disturbance):
    """Autoregressive moving average, stationary from its first sample."""

    std: excitation.Size  # Standard deviation of the shocks w, in the unit of the equation
    # a_1, a_2, ... and b_1, b_2, ...
    autoregression: Annotated[tuple[float, ...], (finite, "coefficient of autoregression")] = ()
    moving_average: Annotated[tuple[float, ...], (finite, "coefficient of moving_average")] = ()

    def _check(self) -> None:
        root = excitation.largest_root(np.array(self.autoregression))
        require(
            root < 1.0,
            "a stationary autoregression, whose modes all die out",
            f"autoregression={self.autoregression}, whose slowest mode is multiplied by {root:.4g} each step",
            "Make the coefficients smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation; the state before the record is drawn from its stationary distribution."""
        # Transition, input and stationary covariance of Harvey's form, whose first state is x.
        r = max(len(self.autoregression), len(self.moving_average) + 1)
        transition = np.eye(r, k=1)
        transition[: len(self.autoregression), 0] = self.autoregression
        shock = np.zeros(r)
        shock[: len(self.moving_average) + 1] = (1.0, *self.moving_average)
        covariance = scipy.linalg.solve_discrete_lyapunov(transition, np.outer(shock, shock))
        eigenvalues, vectors = np.linalg.eigh(covariance)
        before = vectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(eigenvalues.size))
        shocks = rng.standard_normal(count)
        driven = np.convolve(np.concatenate([[1.0], self.moving_average]), shocks)[:count]
        echo = (transition @ before)[:count]
        driven[: echo.size] += echo
        return self.std * excitation.autoregression(driven, excitation.constant(self.autoregression, count))


@dataclass(frozen=True, slots=True)
class TimeVaryingArma(excitation.Disturbance):
    """Autoregressive moving average whose coefficients depend on time; zero before the record."""

    std: excitation.Size  # Standard deviation of the shocks w, in the unit of the equation
    # Of a_1, a_2, ... and b_1, b_2, ...
    autoregression: tuple[CoefficientCourse, ...] = ()
    moving_average: tuple[CoefficientCourse, ...] = ()

    def _check(self) -> None:
        courses = self._coefficients(self.autoregression, CHECKED)
        root = max((excitation.largest_root(row) for row in courses), default=0.0)
        expected = "an autoregression that is stationary at every time of the record"
        received = f"one whose slowest mode is multiplied by up to {root:.4g} each step"
        require(root < 1.0, expected, received, "Make the means or amplitudes smaller.")

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        shocks = rng.standard_normal(count)
        driven = shocks.copy()
        for lag, course in enumerate(self.moving_average[: count - 1], start=1):
            driven[lag:] += course.values(count)[lag:] * shocks[:-lag]
        return self.std * excitation.autoregression(driven, self._coefficients(self.autoregression, count))

    @staticmethod
    def _coefficients(courses: tuple[CoefficientCourse, ...], count: int) -> Float[np.ndarray, "count lags"]:
        return np.array([course.values(count) for course in courses]).reshape(len(courses), count).T


@dataclass(frozen=True, slots=True)
class RandomCoefficientMovingAverage(excitation.Disturbance):
    """x[k] = sum_j c_j(k) w[k-j], j = 1, 2, ..., with coefficients drawn anew at each sample."""

    # Of the normal coefficients c_1, c_2, ... (the paper's: 0 and 3, 1 and 1)
    means: Annotated[tuple[float, ...], given, (finite, "mean of a coefficient")] = (0.0, 3.0)
    stds: Annotated[tuple[float, ...], (non_negative, "std of a coefficient")] = (1.0, 1.0)
    std: excitation.Size = 1.0  # Standard deviation of w, in the unit of the equation

    def _check(self) -> None:
        excitation.equally_many("means", self.means, "stds", self.stds)

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        order = len(self.means)
        shocks = rng.standard_normal(count + order)
        series = np.zeros(count)
        for lag, (mean, std) in enumerate(zip(self.means, self.stds, strict=True), start=1):
            series += (mean + std * rng.standard_normal(count)) * shocks[order - lag : order - lag + count]
        return self.std * series


@dataclass(frozen=True, slots=True)
class Trend(excitation.Disturbance):
    """Polynomial of the time in the record, counted from -1 at its first sample to 1 at its last."""

    # Of the powers 0, 1, ..., in the unit of the equation
    coefficients: Annotated[tuple[float, ...], given, (finite, "coefficient")]

    def sample(self, count: int, _step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        return np.polynomial.polynomial.polyval(np.linspace(-1.0, 1.0, count), np.array(self.coefficients))


@dataclass(frozen=True, slots=True)
class Sinusoids(excitation.Disturbance):
    """sum_i amplitude_i sin(frequency_i t + phase_i)."""

    amplitudes: Annotated[tuple[float, ...], given, (finite, "amplitude")]  # In the unit of the equation
    frequencies: Annotated[tuple[float, ...], (non_negative, "frequency")]  # Angular [rad/s]
    # At the first sample [rad]; zero when left out
    phases: Annotated[tuple[float, ...], (finite, "phase")] = ()

    def _check(self) -> None:
        excitation.equally_many("amplitudes", self.amplitudes, "frequencies", self.frequencies)
        if self.phases:
            excitation.equally_many("amplitudes", self.amplitudes, "phases", self.phases)

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        t = step_s * np.arange(count)
        phases = self.phases or (0.0,) * len(self.amplitudes)
        waves = zip(self.amplitudes, self.frequencies, phases, strict=True)
        return sum((a * np.sin(frequency * t + phase) for a, frequency, phase in waves), np.zeros(count))


@dataclass(frozen=True, slots=True)
class BoundedAdversary(excitation.Disturbance):
    """Unknown but bounded: always at one bound or the other, which is all that is known of it.

    It switches with a period that shrinks geometrically over the record, so that no frequency band is spared,
    and it need not have mean zero.
    """

    bound: excitation.Size  # Largest absolute value, in the unit of the equation
    longest_s: excitation.Positive  # Period at the beginning and at the end of the record [s]
    shortest_s: excitation.Positive
    high_share: float = 0.5  # Share of each period that is spent at the upper bound, from 0 to 1

    def _check(self) -> None:
        received = f"shortest_s={self.shortest_s}, longest_s={self.longest_s}"
        require(self.shortest_s <= self.longest_s, "a shortest_s up to longest_s", received)
        require(0.0 <= self.high_share <= 1.0, "a high_share from 0 to 1", f"high_share={self.high_share}")

    def sample(self, count: int, step_s: float, _rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        t, duration = step_s * np.arange(count), step_s * max(count, 1)
        rate = np.log(self.longest_s / self.shortest_s) / duration
        turns = t if rate == 0.0 else np.expm1(rate * t) / rate
        return np.where(turns / self.longest_s % 1.0 < self.high_share, self.bound, -self.bound)


@dataclass(frozen=True, slots=True)
class GivenDisturbance(excitation.GivenSeries, excitation.Disturbance):
    """A user's own series, from its beginning."""

    # At the rate of the record, in the unit of the equation; at least as many as it has samples
    values: Annotated[tuple[float, ...], given, (finite, "value")]


@dataclass(frozen=True, slots=True)
class SumOfDisturbances(excitation.Disturbance):
    """Several independent disturbances at once."""

    parts: Annotated[tuple[excitation.Disturbance, ...], given]  # Each draws from a stream of its own

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        drawn = zip(self.parts, rng.spawn(len(self.parts)), strict=True)
        return sum((part.sample(count, step_s, stream) for part, stream in drawn), np.zeros(count))


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


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeck(excitation.Disturbance):
    """Normal series whose correlation falls exponentially; the longitudinal turbulence of MIL-F-8785C."""

    std: excitation.Size  # Standard deviation, in the unit of what it disturbs
    correlation_s: excitation.Positive  # Time in which the correlation falls to 1/e [s]

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        known = {"step_s": step_s, "rms": self.std, "correlation_s": self.correlation_s}
        return gusts(count=count, axes=1, rng=rng, **known)[:, 0]


@dataclass(frozen=True, slots=True)
class ThresholdMovingAverage(excitation.Disturbance):
    """Self-exciting threshold moving average: x[k] = w[k] + sum_j b_j w[k-j], b by where x[k-delay] lies.

    Stationary for all coefficients. One step at a time: about 1 ms for 4000 samples.
    """

    # Ascending, in the unit of the equation; a value on a threshold belongs to the regime below
    thresholds: Annotated[tuple[float, ...], given, (finite, "threshold")]
    # b_1, b_2, ... of each regime, from the lowest to the highest: one more than thresholds
    coefficients: tuple[tuple[float, ...], ...]
    delay: int = 1  # Samples back to the value that chooses the regime, one or more
    std: excitation.Size = 1.0  # Standard deviation of the shocks w, in the unit of the equation

    def _check(self) -> None:
        ascending = all(a < b for a, b in zip(self.thresholds, self.thresholds[1:], strict=False))
        require(ascending, "ascending thresholds", f"thresholds={self.thresholds}")
        expected = f"coefficients of {len(self.thresholds) + 1} regimes, one more than thresholds"
        received = f"those of {len(self.coefficients)}"
        require(len(self.coefficients) == len(self.thresholds) + 1, expected, received)
        for regime in self.coefficients:
            excitation.equally_many(
                "coefficients of the first regime", self.coefficients[0], "of another one", regime
            )
            finite("coefficient", *regime)
        excitation.at_least("delay", self.delay, 1)

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation, after as many unused samples as regime and shocks reach back, tenfold."""
        order = len(self.coefficients[0])
        unused = 10 * max(order, self.delay)
        shocks = self.std * rng.standard_normal(order + unused + count)
        # All regimes' values at once; then only the choice among them has to be made in sequence.
        present = shocks[order:]
        past = np.array([shocks[order - lag : shocks.size - lag] for lag in range(1, order + 1)])
        past = past.reshape(order, present.size)
        choices = [(present + np.array(regime) @ past).tolist() for regime in self.coefficients]
        series = [0.0] * self.delay
        for k in range(present.size):
            series.append(choices[bisect_left(self.thresholds, series[k])][k])
        return np.array(series[self.delay + unused :])


@dataclass(frozen=True, slots=True)
class BilinearTerm:
    """b x[k - series_lag] w[k - shock_lag]."""

    coefficient: excitation.Finite
    series_lag: int = 2
    shock_lag: int = 1

    def __post_init__(self) -> None:
        in_ranges(self)
        excitation.at_least("shock_lag", self.shock_lag, 1)
        expected = "a series_lag above shock_lag, so that the two factors are independent"
        received = f"series_lag={self.series_lag}, shock_lag={self.shock_lag}"
        require(self.series_lag > self.shock_lag, expected, received)


@dataclass(frozen=True, slots=True)
class Bilinear(excitation.Disturbance):
    """Strongly subdiagonal bilinear of several terms: x[k] = w[k] + sum_m b_m x[k - i_m] w[k - j_m].

    Uncorrelated, but not independent: its extremes come from its own past.
    """

    terms: Annotated[tuple[BilinearTerm, ...], given]  # One or more
    std: excitation.Size = 1.0  # Standard deviation of the shocks w, in the unit of the equation

    def _check(self) -> None:
        expected = "std times the sum of the coefficients' sizes below one, so that the series is stationary"
        require(self._growth < 1.0, expected, f"{self._growth**0.5:.4g}", "Make some of them smaller.")

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        # Given w it is a linear recursion in x, which settles to its stationary variance.
        longest = max(term.series_lag for term in self.terms)
        # until what was before has fallen to a millionth
        unused = longest * int(min(np.ceil(np.log(1e-6) / np.log(max(self._growth, 1e-6))), 100_000))
        shocks = self.std * rng.standard_normal(unused + count)
        coefficients = np.zeros((shocks.size, longest))
        for term in self.terms:
            earlier = term.coefficient * shocks[: shocks.size - term.shock_lag]
            coefficients[term.shock_lag :, term.series_lag - 1] += earlier
        return excitation.autoregression(shocks, coefficients)[unused:]

    @property
    def _growth(self) -> float:
        """Largest factor of the variance from one term to the next."""
        return (self.std * sum(abs(term.coefficient) for term in self.terms)) ** 2


@dataclass(frozen=True, slots=True)
class Garch(excitation.Disturbance):
    """x[k] = sqrt(h[k]) w[k], h[k] = floor + sum_i a_i x[k-i]^2 + sum_j b_j h[k-j]; ARCH without b."""

    # Constant part of the variance, above zero, in the square of the equation's unit
    floor: excitation.Positive
    # a_1, a_2, ..., zero or more
    shocks: Annotated[tuple[float, ...], (non_negative, "coefficient of shocks")]
    # b_1, b_2, ..., zero or more
    persistence: Annotated[tuple[float, ...], (non_negative, "coefficient of persistence")] = ()
    # Squares beyond it count as it, which keeps a heavy-tailed series finite
    largest_square: float | None = None

    def _check(self) -> None:
        if self.largest_square is not None:
            positive("largest_square", self.largest_square)
        total = sum(self.shocks) + sum(self.persistence)
        expected = "coefficients that add up to less than one, so that the variance is finite"
        require(total < 1.0, expected, f"{total:.4g}", "Make one of them smaller.")

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        limit = np.inf if self.largest_square is None else self.largest_square
        mean = self.floor / (1.0 - (sum(self.shocks) + sum(self.persistence)))
        squares = [min(mean, limit)] * len(self.shocks)
        variances = [mean] * len(self.persistence)
        series = []
        for w in rng.standard_normal(count).tolist():
            h = self.floor
            h += sum(a * square for a, square in zip(self.shocks, reversed(squares), strict=False))
            h += sum(b * past for b, past in zip(self.persistence, reversed(variances), strict=False))
            series.append(h**0.5 * w)
            squares = [*squares[1:], min(series[-1] ** 2, limit)] if squares else squares
            variances = [*variances[1:], h] if variances else variances
        return np.array(series)


@dataclass(frozen=True, slots=True)
class VarianceSwitch(excitation.Disturbance):
    """Another disturbance whose variance is multiplied from some time of the record on."""

    series: excitation.Disturbance  # What it is before
    factor: excitation.Size = 10.0  # Of the variance, afterwards
    at: excitation.Finite = 0.5  # When, as a share of the record, from 0 to 1

    def _check(self) -> None:
        require(0.0 <= self.at <= 1.0, "a share of the record from 0 to 1", f"at={self.at}")

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        series = self.series.sample(count, step_s, rng).copy()
        series[int(np.ceil(self.at * count)) :] *= np.sqrt(self.factor)
        return series
