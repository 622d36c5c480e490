"""What the rows of a regression are: samples, or bins of spectra; of which flight, and of which axis.

Scores, the products of test functions and residual, are brought back to time, where their
autocorrelation can be seen. What several axes of one flight say at one time is one score: a gust that moves
them together must not count as several.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float, Int


class RowLayout(ABC):
    """What the rows of a regression are."""

    @property
    @abstractmethod
    def flight_of_row(self) -> Int[np.ndarray, " rows"]:
        """Number of the flight that each row belongs to."""

    @property
    @abstractmethod
    def axis_of_row(self) -> Int[np.ndarray, " rows"]:
        """Number of the axis of motion that each row is an equation of."""

    @abstractmethod
    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Products of test functions and residual by sample; their sum is ``test.T @ residual``."""


@dataclass(frozen=True, slots=True)
class SampleRows(RowLayout):
    """Rows are time samples of one axis, in their order.

    Parameters
    ----------
    flights : ndarray of int, shape (rows,)
        Flight of each row.
    """

    flights: Int[np.ndarray, " rows"]

    @property
    def flight_of_row(self) -> Int[np.ndarray, " rows"]:
        """Flight of each row."""
        return self.flights

    @property
    def axis_of_row(self) -> Int[np.ndarray, " rows"]:
        """Zeros: there is one axis."""
        return np.zeros(self.flights.size, dtype=np.int64)

    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Row-wise products."""
        return test * residual[:, None]


@dataclass(frozen=True, slots=True)
class AxisRows(RowLayout):
    """Rows are time samples of several axes.

    Parameters
    ----------
    flights, axes, samples : ndarray of int, shape (rows,)
        Flight, axis, and sample of the flight, of each row. Rows of one flight and sample are of one time.
    """

    flights: Int[np.ndarray, " rows"]
    axes: Int[np.ndarray, " rows"]
    samples: Int[np.ndarray, " rows"]

    @property
    def flight_of_row(self) -> Int[np.ndarray, " rows"]:
        """Flight of each row."""
        return self.flights

    @property
    def axis_of_row(self) -> Int[np.ndarray, " rows"]:
        """Axis of each row."""
        return self.axes

    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Row-wise products, added over the axes; flight after flight, in time order."""
        times = np.stack([self.flights, self.samples], axis=1)
        distinct, place = np.unique(times, axis=0, return_inverse=True)
        scores: Float[np.ndarray, "samples n"] = np.zeros((distinct.shape[0], test.shape[1]))
        np.add.at(scores, place.ravel(), test * residual[:, None])
        return scores
