"""Regression: the rows an estimator works on, and how they came about.

``y = Phi theta + e``, with instruments Psi beside it. Rows are time samples, or the real and imaginary
parts of the frequency bins of a run; `RowLayout` says which, and brings scores back to time, where their
autocorrelation can be seen.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from eivor.errors import NonFiniteError, ShapeError, TooFewSamplesError
from eivor.models.column import Column
from eivor.models.parameter import Parameter


class RowLayout(ABC):
    """What the rows of a regression are."""

    @property
    @abstractmethod
    def flight_of_row(self) -> Int[np.ndarray, " rows"]:
        """Number of the flight that each row belongs to."""

    @abstractmethod
    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Products of test functions and residual, sample by sample; their sum is ``test.T @ residual``."""


@dataclass(frozen=True, slots=True)
class SampleRows(RowLayout):
    """Rows are time samples, in their order.

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

    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Row-wise products."""
        return test * residual[:, None]


@dataclass(frozen=True)
class Regression:
    """Response, regressors and instruments, row by row.

    Parameters
    ----------
    response : ndarray, shape (rows,)
        y.
    regressors : ndarray, shape (rows, n)
        Phi.
    instruments : ndarray, shape (rows, p)
        Psi; zero columns when there are none.
    parameters : tuple of Parameter
        One for each column of Phi.
    columns, instrument_columns : tuple of Column
        Tags; empty for plain arrays.
    error_scale : ndarray, shape (n + 1,), optional
        Standard deviations of the errors in the columns of Phi and in y, see `LinearSystem`.
    layout : RowLayout
        What the rows are. Default: samples of one flight.

    Raises
    ------
    ShapeError, NonFiniteError, TooFewSamplesError
        When lengths differ, a number is not finite, or there are fewer rows than unknowns.
    """

    response: Float[np.ndarray, " rows"]
    regressors: Float[np.ndarray, "rows n"]
    instruments: Float[np.ndarray, "rows p"]
    parameters: tuple[Parameter, ...]
    columns: tuple[Column, ...] = ()
    instrument_columns: tuple[Column, ...] = ()
    error_scale: Float[np.ndarray, " n_plus_1"] | None = None
    layout: RowLayout = field(default_factory=lambda: SampleRows(np.zeros(0, dtype=np.int64)))

    def __post_init__(self) -> None:
        rows, unknowns = self.regressors.shape
        if self.response.shape != (rows,) or self.instruments.shape[0] != rows:
            raise ShapeError(
                "response, regressors and instruments with equally many rows",
                f"{self.response.shape}, {self.regressors.shape} and {self.instruments.shape}",
                "Cut them from the same samples.",
            )
        if len(self.parameters) != unknowns:
            raise ShapeError(
                f"one name for each of {unknowns} regressors", f"{len(self.parameters)}", "Name every column."
            )
        if rows < unknowns:
            raise TooFewSamplesError(
                f"at least {unknowns} rows for {unknowns} unknowns", f"{rows}", "Give a longer record."
            )
        for name in ("response", "regressors", "instruments"):
            bad = ~np.isfinite(getattr(self, name))
            if bad.any():
                raise NonFiniteError(
                    f"finite {name}",
                    f"{int(bad.sum())} NaN or infinite, the first in row {int(np.argwhere(bad)[0][0])}",
                    "Repair or leave out those samples.",
                )
        if isinstance(self.layout, SampleRows) and self.layout.flights.size != rows:
            object.__setattr__(self, "layout", SampleRows(np.zeros(rows, dtype=np.int64)))

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple(p.unit for p in self.parameters)


def regression(
    *,
    response: Float[np.ndarray, " rows"],
    regressors: Float[np.ndarray, "rows n"],
    instruments: Float[np.ndarray, "rows p"] | None = None,
    names: tuple[str, ...] | None = None,
    error_scale: Float[np.ndarray, " n_plus_1"] | None = None,
) -> Regression:
    """Regression of plain arrays, rows in time order.

    Parameters
    ----------
    response : array_like, shape (rows,)
        y.
    regressors : array_like, shape (rows, n)
        Phi. Add a column of ones for an intercept.
    instruments : array_like, shape (rows, p), optional
        Psi, exogenous columns.
    names : tuple of str, optional
        Names of the parameters; default ``theta_1``, ``theta_2``, ...
    error_scale : array_like, shape (n + 1,), optional
        Standard deviations of the errors in the regressors and, last, in the response; for total
        least squares.

    Returns
    -------
    Regression
        In double precision; the arrays given are not modified.

    Raises
    ------
    ShapeError, NonFiniteError, TooFewSamplesError
        See `Regression`.
    """
    Phi = np.asarray(regressors, dtype=np.float64)
    if Phi.ndim != 2:
        raise ShapeError(
            "regressors of shape (rows, n)", f"shape {Phi.shape}", "Stack columns with np.column_stack."
        )
    y = np.asarray(response, dtype=np.float64)
    Psi = np.empty((Phi.shape[0], 0)) if instruments is None else np.asarray(instruments, dtype=np.float64)
    if Psi.ndim != 2:
        raise ShapeError(
            "instruments of shape (rows, p)", f"shape {Psi.shape}", "Stack columns with np.column_stack."
        )
    labels = names if names is not None else tuple(f"theta_{j + 1}" for j in range(Phi.shape[1]))
    scale = None if error_scale is None else np.asarray(error_scale, dtype=np.float64)
    return Regression(y, Phi, Psi, tuple(Parameter(label) for label in labels), error_scale=scale)
