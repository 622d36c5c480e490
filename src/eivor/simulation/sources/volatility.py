"""Disturbances whose variance changes: by their own past (ARCH, GARCH), or at a given time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.parameter_checks import finite, non_negative, positive, require
from eivor.simulation.sources.recursion import autoregression


@dataclass(frozen=True, slots=True)
class Garch(Disturbance):
    """x[k] = sqrt(h[k]) w[k], h[k] = floor + sum_i a_i x[k-i]^2 + sum_j b_j h[k-j]; ARCH without b.

    Parameters
    ----------
    floor : float
        Constant part of the variance, above zero, in the square of the equation's unit.
    shocks : tuple of float
        a_1, a_2, ..., zero or more.
    persistence : tuple of float
        b_1, b_2, ..., zero or more.
    largest_square : float, optional
        Squares beyond it count as it, which keeps a heavy-tailed series finite.

    Raises
    ------
    ParameterError
        When a number is out of range, or the coefficients add up to one or more.
    """

    floor: float
    shocks: tuple[float, ...]
    persistence: tuple[float, ...] = ()
    largest_square: float | None = None

    def __post_init__(self) -> None:
        positive("floor", self.floor)
        non_negative("coefficient of shocks", *self.shocks)
        non_negative("coefficient of persistence", *self.persistence)
        if self.largest_square is not None:
            positive("largest_square", self.largest_square)
        require(
            self._sum < 1.0,
            "coefficients that add up to less than one, so that the variance is finite",
            f"{self._sum:.4g}",
            "Make one of them smaller.",
        )

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        """One realisation; before the record, squares and variances are the stationary variance."""
        white = rng.standard_normal(count)
        series = np.sqrt(self._variances(white**2)) * white
        limit = self.largest_square
        # Below the limit h is linear in its past, given w; else it has to be followed step by step.
        if limit is not None and float(np.max(series**2, initial=self._unlimited)) > limit:
            return self._limited(white, limit)
        return series

    @property
    def variance(self) -> float | None:
        """Without a limit on squares, floor / (1 - sum of coefficients); else None."""
        return self._unlimited if self.largest_square is None else None

    @property
    def _sum(self) -> float:
        return sum(self.shocks) + sum(self.persistence)

    @property
    def _unlimited(self) -> float:
        return self.floor / (1.0 - self._sum)

    def _variances(self, white_squares: Float[np.ndarray, " count"]) -> Float[np.ndarray, " count"]:
        """Variances by a linear recursion, h[k] = floor + sum_i (a_i w[k-i]^2 + b_i) h[k-i]."""
        count, lags = white_squares.size, max(len(self.shocks), len(self.persistence))
        coefficients = np.zeros((count, lags))
        driven = np.full(count, self.floor)
        for i in range(1, lags + 1):
            a = self.shocks[i - 1] if i <= len(self.shocks) else 0.0
            b = self.persistence[i - 1] if i <= len(self.persistence) else 0.0
            coefficients[i:, i - 1] = a * white_squares[: max(count - i, 0)] + b
            driven[:i] += (a + b) * self._unlimited
        return autoregression(driven, coefficients)

    def _limited(self, white: Float[np.ndarray, " count"], limit: float) -> Float[np.ndarray, " count"]:
        squares = [min(self._unlimited, limit)] * len(self.shocks)
        variances = [self._unlimited] * len(self.persistence)
        series = []
        for w in white.tolist():
            h = self.floor
            h += sum(a * square for a, square in zip(self.shocks, reversed(squares), strict=False))
            h += sum(b * past for b, past in zip(self.persistence, reversed(variances), strict=False))
            series.append(h**0.5 * w)
            squares = [*squares[1:], min(series[-1] ** 2, limit)] if squares else squares
            variances = [*variances[1:], h] if variances else variances
        return np.array(series)


@dataclass(frozen=True, slots=True)
class VarianceSwitch(Disturbance):
    """Another disturbance whose variance is multiplied from some time of the record on.

    Parameters
    ----------
    series : Disturbance
        What it is before.
    factor : float
        Of the variance, afterwards.
    at : float
        When, as a share of the record, from 0 to 1.

    Raises
    ------
    ParameterError
        When a number is out of range.
    """

    series: Disturbance
    factor: float = 10.0
    at: float = 0.5

    def __post_init__(self) -> None:
        non_negative("factor", self.factor)
        finite("at", self.at)
        require(0.0 <= self.at <= 1.0, "a share of the record from 0 to 1", f"at={self.at}")

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        """One realisation."""
        series = self.series.sample(count, step_s, rng).copy()
        series[int(np.ceil(self.at * count)) :] *= np.sqrt(self.factor)
        return series

    @property
    def variance(self) -> None:
        """None: it changes."""
        return
