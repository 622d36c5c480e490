"""What a bootstrap gives: replicates of an estimate, and the intervals that are read from them.

A replicate is put together from c independent pieces (blocks of a record, flights of a pool) drawn with
replacement. Its variance is that of the pieces divided by c, not c - 1, and percentiles are those of a
normal variable, not of Student's t: for few pieces percentile intervals are too narrow by
sqrt((c - 1) / c) and z / t. The *expanded* interval undoes both (Hesterberg 2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.inference.quantiles import check_level, normal_quantile, t_quantile
from eivor.shapes import Float


def check_draws(runs: object, seed: object) -> None:
    """Refuse fewer replicates than two, and a seed that is none.

    Raises
    ------
    UsageError
        With what came instead.
    """
    checks.whole("runs", runs)
    if isinstance(runs, int | np.integer) and runs < 2:
        raise UsageError("two runs or more", f"runs={runs}", "A thousand are usual.")
    if isinstance(seed, np.random.Generator):
        return
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer):
        raise UsageError(
            "a whole number or a numpy.random.Generator for seed",
            checks.described(seed),
            "Give 0, for example.",
        )
    if seed < 0:
        raise UsageError("a seed of zero or more", f"seed={seed}", "Any other one will do.")


class IntervalKind(StrEnum):
    """How an interval is read from replicates. Notation: v value, v* replicate, s and s* standard errors."""

    PERCENTILE = "percentile"
    """Quantiles of v*."""
    EXPANDED = "expanded"
    """Quantiles of v*, their distances from v times sqrt(c / (c - 1)) t / z: for few pieces."""
    BASIC = "basic"
    """v minus quantiles of v* - v, in reverse order."""
    STUDENTISED = "studentised"
    """v minus quantiles of (v* - v) / s* times s, in reverse order."""


@dataclass(frozen=True)
class Bootstrap:
    """Replicates of an estimate.

    Parameters
    ----------
    names, units : tuple of str, length n
        Of the quantities.
    values : ndarray, shape (n,)
        The estimate that the replicates are replicates of.
    replicates : ndarray, shape (runs, n)
        Of those runs that gave an estimate.
    failed : int
        Runs that did not.
    pieces : int
        Blocks, or flights, that a replicate is put together from.
    block_length : float
        Rows of a block; NaN when whole flights are drawn.
    seed : int or None
        What the generator was made of; None when a generator was given.
    std_errors : ndarray, shape (n,), optional
        Standard error of each value, computed as those of the replicates.
    studentised : ndarray, shape (runs, n), optional
        (v* - v) / s* of each replicate.

    Raises
    ------
    UsageError
        When fewer than two replicates gave an estimate.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, " n"]
    replicates: Float[np.ndarray, "runs n"]
    failed: int
    pieces: int
    block_length: float
    seed: int | None
    std_errors: Float[np.ndarray, " n"] | None = None
    studentised: Float[np.ndarray, "runs n"] | None = None

    def __post_init__(self) -> None:
        if self.replicates.shape[0] < 2:
            raise UsageError(
                "at least two replicates with an estimate",
                f"{self.replicates.shape[0]}, and {self.failed} without",
                "Ask for more runs; where most fail, the data do not determine the parameters.",
            )

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the replicates, times c / (c - 1): c pieces vary about a mean of their own."""
        spread = self.replicates - self.replicates.mean(axis=0)
        few = self.pieces / (self.pieces - 1) if self.pieces > 1 else math.inf
        covariance: Float[np.ndarray, "n n"] = spread.T @ spread / (spread.shape[0] - 1) * few
        return covariance

    def std_error(self, name: str) -> float:
        """Root of the quantity's variance, see `covariance`.

        Raises
        ------
        UsageError
            When there is no quantity of that name.
        """
        place = self._place(name)
        return math.sqrt(float(self.covariance[place, place]))

    def bias(self, name: str) -> float:
        """Mean of the replicates minus the value.

        Raises
        ------
        UsageError
            When there is no quantity of that name.
        """
        place = self._place(name)
        return float(self.replicates[:, place].mean() - self.values[place])

    def interval(
        self, name: str, level: float = 0.95, kind: IntervalKind = IntervalKind.EXPANDED
    ) -> tuple[float, float]:
        """Confidence interval of a quantity.

        Parameters
        ----------
        name : str
            The quantity.
        level : float
            Confidence level.
        kind : IntervalKind
            How it is read from the replicates.

        Raises
        ------
        UsageError
            When there is no quantity of that name, the level is not between 0 and 1 or needs more
            replicates than there are, or a studentised interval is asked of replicates without standard
            errors.
        """
        place = self._place(name)
        check_level(level)
        try:
            chosen = IntervalKind(kind)
        except ValueError as error:
            known = ", ".join(IntervalKind)
            raise UsageError(f"a kind out of {known}", checks.described(kind), "Name one of them.") from error
        return _INTERVALS[chosen](self, place, level)

    def _place(self, name: str) -> int:
        checks.text("name", name)
        if name not in self.names:
            raise UsageError(f"a quantity out of {', '.join(self.names)}", f"'{name}'", "Name one of them.")
        return self.names.index(name)


def _quantiles(values: Float[np.ndarray, " runs"], level: float) -> tuple[float, float]:
    """Order statistics (R + 1) p of R runs: another replicate is below the p-quantile with probability p.

    Raises
    ------
    UsageError
        When R is too small for such an order statistic to be there.
    """
    needed = math.ceil(2.0 / (1.0 - level) * (1.0 - 1e-12)) - 1
    if values.size < needed:
        raise UsageError(
            f"{needed} replicates or more for a level of {level:g}",
            f"{values.size}",
            "Draw more runs, or ask for a lower level.",
        )
    low, high = np.quantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level], method="weibull")
    return float(low), float(high)


def _percentile(found: Bootstrap, place: int, level: float) -> tuple[float, float]:
    return _quantiles(found.replicates[:, place], level)


def _expanded(found: Bootstrap, place: int, level: float) -> tuple[float, float]:
    if found.pieces < 2:
        return -math.inf, math.inf
    wider = math.sqrt(found.pieces / (found.pieces - 1)) * t_quantile(level, found.pieces - 1)
    wider /= normal_quantile(level)
    value = float(found.values[place])
    low, high = _quantiles(found.replicates[:, place], level)
    return value + wider * (low - value), value + wider * (high - value)


def _basic(found: Bootstrap, place: int, level: float) -> tuple[float, float]:
    value = float(found.values[place])
    low, high = _quantiles(found.replicates[:, place], level)
    return 2.0 * value - high, 2.0 * value - low


def _studentised(found: Bootstrap, place: int, level: float) -> tuple[float, float]:
    if found.studentised is None or found.std_errors is None:
        raise UsageError(
            "replicates with standard errors of their own, for a studentised interval",
            "replicates without",
            "Draw blocks of one length, or take another kind of interval.",
        )
    value, error = float(found.values[place]), float(found.std_errors[place])
    low, high = _quantiles(found.studentised[:, place], level)
    return value - high * error, value - low * error


_INTERVALS: dict[IntervalKind, Callable[[Bootstrap, int, float], tuple[float, float]]] = {
    IntervalKind.PERCENTILE: _percentile,
    IntervalKind.EXPANDED: _expanded,
    IntervalKind.BASIC: _basic,
    IntervalKind.STUDENTISED: _studentised,
}
