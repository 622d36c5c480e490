"""Weights of rows: from a problem with nuisances to weighted rows, pass by pass.

Weights do not depend on the nuisances, so that a whole search shares them. Those that are made of residuals
are renewed at each estimate, so often as the weighting says; then they stand.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem, Values
from eivor.shapes import Float


class WeightedRows(ABC):
    """A problem's rows with weights of one pass."""

    @abstractmethod
    def rows(self, at: Values) -> Regression:
        """Weighted rows at values of the nuisances."""

    def products(self, points: Sequence[Values]) -> Float[np.ndarray, "points p n_plus_1"]:
        """Mean of psi [phi' y] at many values of the nuisances."""
        return np.stack([_mean_products(self.rows(at)) for at in points])

    def columns(self, points: Sequence[Values]) -> Float[np.ndarray, "points rows n_plus_1"]:
        """Weighted rows of [phi y] at many values of the nuisances."""
        return np.stack([_columns(self.rows(at)) for at in points])

    def criterion(self, _theta: Float[np.ndarray, " n"], _at: Values, /) -> float | None:
        """What candidates are compared by, where weights know better than the estimate; by default None."""
        return None

    @property
    @abstractmethod
    def renewal(self) -> Callable[[Float[np.ndarray, " n"], Values], WeightedRows] | None:
        """From an estimate, theta and the nuisances' values, to the next pass; None when this is the last."""


def _mean_products(rows: Regression) -> Float[np.ndarray, "p n_plus_1"]:
    return rows.instruments.T @ _columns(rows) / rows.response.size


def _columns(rows: Regression) -> Float[np.ndarray, "rows n_plus_1"]:
    return np.column_stack([rows.regressors, rows.response])


class RowWeighting(ABC):
    """A way to weight rows."""

    @property
    @abstractmethod
    def needs_spectra(self) -> bool:
        """True when rows must be bins of spectra, which plain regressions do not have."""

    @abstractmethod
    def first_pass(self, problem: SeparableProblem) -> WeightedRows:
        """Rows weighted before anything is known."""

    @abstractmethod
    def last_pass(
        self, problem: SeparableProblem, theta: Float[np.ndarray, " n"], at: Values, /
    ) -> WeightedRows:
        """Rows weighted by the residuals of an estimate, for good."""


@dataclass(frozen=True, slots=True)
class TimeRows(WeightedRows):
    """Rows in time, as they are.

    Parameters
    ----------
    problem : SeparableProblem
        Whose.
    """

    problem: SeparableProblem

    def rows(self, at: Values) -> Regression:
        """Rows in time."""
        return self.problem.rows(at)

    @property
    def renewal(self) -> None:
        """None: there is nothing to renew."""
        return None


@dataclass(frozen=True, slots=True)
class EqualRows(RowWeighting):
    """Every row in time with weight one."""

    @property
    def needs_spectra(self) -> bool:
        """No."""
        return False

    def first_pass(self, problem: SeparableProblem) -> TimeRows:
        """Rows in time."""
        return TimeRows(problem)

    def last_pass(
        self, problem: SeparableProblem, _theta: Float[np.ndarray, " n"], _at: Values, /
    ) -> TimeRows:
        """Rows in time: no weight is made of residuals."""
        return TimeRows(problem)
