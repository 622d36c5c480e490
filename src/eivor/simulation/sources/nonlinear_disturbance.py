"""Disturbances that are not linear in white noise, though they may look white to a correlation.

Both are moving averages whose coefficients depend on the series' own past, special cases of the paper's
(19) (T. Marek, "On invertibility of a random coefficient moving average model", Kybernetika 41, 2005).
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.parameter_checks import (
    at_least,
    equally_many,
    finite,
    given,
    non_negative,
    require,
)
from eivor.simulation.sources.recursion import autoregression, settling


@dataclass(frozen=True, slots=True)
class ThresholdMovingAverage(Disturbance):
    """Self-exciting threshold moving average: x[k] = w[k] + sum_j b_j w[k-j], b by where x[k-delay] lies.

    Parameters
    ----------
    thresholds : tuple of float
        Ascending, in the unit of the equation; a value on a threshold belongs to the regime below.
    coefficients : tuple of tuple of float
        b_1, b_2, ... of each regime, from the lowest to the highest: one more than thresholds.
    delay : int
        Samples back to the value that chooses the regime, one or more.
    std : float
        Standard deviation of the shocks w, in the unit of the equation.

    Raises
    ------
    ParameterError
        When thresholds do not ascend, regimes are not one more than they, or a number is out of range.

    Notes
    -----
    Stationary for all coefficients. One step at a time: about 1 ms for 4000 samples.
    """

    thresholds: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    delay: int = 1
    std: float = 1.0

    def __post_init__(self) -> None:
        given("thresholds", self.thresholds)
        finite("threshold", *self.thresholds)
        ascending = all(a < b for a, b in zip(self.thresholds, self.thresholds[1:], strict=False))
        require(ascending, "ascending thresholds", f"thresholds={self.thresholds}")
        require(
            len(self.coefficients) == len(self.thresholds) + 1,
            f"coefficients of {len(self.thresholds) + 1} regimes, one more than thresholds",
            f"those of {len(self.coefficients)}",
        )
        for regime in self.coefficients:
            equally_many("coefficients of the first regime", self.coefficients[0], "of another one", regime)
            finite("coefficient", *regime)
        at_least("delay", self.delay, 1)
        non_negative("std", self.std)

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

    @property
    def variance(self) -> None:
        """None: it has no closed form."""
        return


@dataclass(frozen=True, slots=True)
class BilinearTerm:
    """b x[k - series_lag] w[k - shock_lag].

    Parameters
    ----------
    coefficient : float
        b, in units of one over that of the equation.
    series_lag, shock_lag : int
        One or more; x must be strictly older than the shock that it multiplies.

    Raises
    ------
    ParameterError
        When a number is out of range, or x is not the older one.
    """

    coefficient: float
    series_lag: int = 2
    shock_lag: int = 1

    def __post_init__(self) -> None:
        finite("coefficient", self.coefficient)
        at_least("shock_lag", self.shock_lag, 1)
        require(
            self.series_lag > self.shock_lag,
            "a series_lag above shock_lag, so that the two factors are independent",
            f"series_lag={self.series_lag}, shock_lag={self.shock_lag}",
        )


@dataclass(frozen=True, slots=True)
class Bilinear(Disturbance):
    """Strongly subdiagonal bilinear: x[k] = w[k] + b x[k - series_lag] w[k - shock_lag].

    Uncorrelated, but not independent: its extremes come from its own past.

    Parameters
    ----------
    coefficient : float
        b, in units of one over that of the equation.
    series_lag, shock_lag : int
        One or more; x must be strictly older than the shock that it multiplies.
    std : float
        Standard deviation of the shocks w, in the unit of the equation.

    Raises
    ------
    ParameterError
        When x is not the older one, or the variance is not finite, (b std)^2 >= 1.
    """

    coefficient: float
    series_lag: int = 2
    shock_lag: int = 1
    std: float = 1.0

    def __post_init__(self) -> None:
        BilinearTerm(self.coefficient, self.series_lag, self.shock_lag)  # refuses what no term may be
        non_negative("std", self.std)
        require(
            self._growth < 1.0,
            "(coefficient * std)^2 below one, so that the series is stationary",
            f"{self._growth:.4g}",
            "Make one of them smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation, settled to its stationary variance: given w it is a linear recursion in x."""
        unused = self.series_lag * settling(self._growth)
        shocks = self.std * rng.standard_normal(unused + count)
        coefficients = np.zeros((shocks.size, self.series_lag))
        coefficients[self.shock_lag :, -1] = self.coefficient * shocks[: shocks.size - self.shock_lag]
        return autoregression(shocks, coefficients)[unused:]

    @property
    def variance(self) -> float:
        """std^2 / (1 - (b std)^2)."""
        return self.std**2 / (1.0 - self._growth)

    @property
    def _growth(self) -> float:
        return (self.coefficient * self.std) ** 2


@dataclass(frozen=True, slots=True)
class BilinearSum(Disturbance):
    """Strongly subdiagonal bilinear of several terms: x[k] = w[k] + sum_m b_m x[k - i_m] w[k - j_m].

    Parameters
    ----------
    terms : tuple of BilinearTerm
        One or more.
    std : float
        Standard deviation of the shocks w, in the unit of the equation.

    Raises
    ------
    ParameterError
        When the variance may not be finite: std times the sum of all |b_m| must be below one.
    """

    terms: tuple[BilinearTerm, ...]
    std: float = 1.0

    def __post_init__(self) -> None:
        given("terms", self.terms)
        non_negative("std", self.std)
        require(
            self._growth < 1.0,
            "std times the sum of the coefficients' sizes below one, so that the series is stationary",
            f"{self._growth:.4g}",
            "Make some of them smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation, settled: given w it is a linear recursion in x."""
        longest = max(term.series_lag for term in self.terms)
        unused = longest * settling(self._growth)
        shocks = self.std * rng.standard_normal(unused + count)
        coefficients = np.zeros((shocks.size, longest))
        for term in self.terms:
            earlier = term.coefficient * shocks[: shocks.size - term.shock_lag]
            coefficients[term.shock_lag :, term.series_lag - 1] += earlier
        return autoregression(shocks, coefficients)[unused:]

    @property
    def variance(self) -> None:
        """None: it has a closed form for one term only, see `Bilinear`."""
        return

    @property
    def _growth(self) -> float:
        return self.std * sum(abs(term.coefficient) for term in self.terms)
