"""Regression on columns with instruments and declared noises."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from eivor import checks
from eivor.errors import (
    CovarianceError,
    MissingNoiseError,
    NonFiniteError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.linalg.system import PASSED_ROWS, row_blocks
from eivor.signals.signals import Signals
from eivor.tools import Float, Int

PerRow = Float[np.ndarray, " rows"]

#: Lags of one channel: each is a column of every row, and more of them no record can distinguish.
MOST_LAGS = 10_000


@dataclass(frozen=True, slots=True)
class Column:
    """``gain * gain_channel[k] * channel[k - lag]``.

    Raises
    ------
    UsageError
        When the lag is no whole number or negative, the gain not finite, or a name no text.
    """

    channel: str  # Canonical name; empty for the intercept, which is a column of ones without noise
    lag: int = 0  # Samples back, zero or more
    gain: float = 1.0  # Constant, noise-free factor
    #: Channel whose values, known without noise, multiply the column row by row; empty for none
    gain_channel: str = ""

    def __post_init__(self) -> None:
        checks.text("channel", self.channel)
        checks.text("gain_channel", self.gain_channel)
        remedy = "Only past samples are regressors."
        checks.counted("lag", self.lag, 0, "a lag of zero or more samples", remedy)
        checks.number("gain", self.gain)
        if not math.isfinite(self.gain):
            raise UsageError("a finite gain", f"{self.gain}", "A column of zeros has the gain 0.")

    @property
    def name(self) -> str:
        """How the column is called in tables: ``input(k-3)``."""
        if not self.channel:
            return "intercept"
        return f"{self.channel}(k-{self.lag})" if self.lag else self.channel

    def values(self, signals: Signals, first: int) -> PerRow:
        """Column of `signals`, for the samples from `first` on; refused where none is that late."""
        count = signals.sample_count - first
        if count < 1 or self.lag > first:
            expected = f"more than {max(first, self.lag)} samples"
            remedy = "Give a longer record or fewer lags."
            raise TooFewSamplesError(expected, f"{signals.sample_count}", remedy)
        gain = self.gain * (signals.channel(self.gain_channel)[first:] if self.gain_channel else 1.0)
        if not self.channel:
            return np.full(count, gain)
        return gain * signals.channel(self.channel)[first - self.lag : first - self.lag + count]


def check_columns(name: str, columns: object) -> None:
    """Refuse what is no tuple of columns."""
    checks.items(name, columns, Column, "columns", 'Give ev.lags("input", 1, 10), for example.')


def lags(channel: str, first: int, last: int) -> tuple[Column, ...]:
    """Columns of `channel` at the lags from `first` to `last`, both included.

    Raises
    ------
    UsageError
        When `last` lies before `first`, a lag is negative or no whole number, or there are more than
        `MOST_LAGS`.
    """
    checks.whole("first", first)
    checks.whole("last", last)
    if last < first:
        raise UsageError("first <= last", f"first={first}, last={last}", "Both ends are included.")
    if last - first >= MOST_LAGS:
        remedy = "Each is a column of its own."
        raise UsageError(f"{MOST_LAGS} lags or fewer", f"first={first}, last={last}", remedy)
    return tuple(Column(channel, lag) for lag in range(first, last + 1))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown."""

    name: str  # Term of the field, as used in results ("viscous_friction")
    unit: str = ""  # SI; empty for a pure number


@dataclass(frozen=True, slots=True)
class Equation:
    """``response = sum of parameter * column + error``."""

    response: Column
    terms: tuple[tuple[Parameter, Column], ...]  # Right side, in the order of the parameter vector
    derivative_of: str = ""


class RowLayout(ABC):
    """What the rows of a regression are."""

    flight_of_row: Int[np.ndarray, " rows"]  # Number of the flight that each row belongs to
    axis_of_row: Int[np.ndarray, " rows"]  # Number of the axis of motion that each row is an equation of

    @property
    def independent(self) -> float:
        """Share of as many independent rows: less where spectra lack samples."""
        return 1.0

    @abstractmethod
    def scores(self, test: Float[np.ndarray, "rows n"], residual: PerRow) -> Float[np.ndarray, "samples n"]:
        """Products of test functions and residual by sample; their sum is ``test.T @ residual``."""


@dataclass(frozen=True, slots=True)
class SampleRows(RowLayout):
    """Rows are time samples of one axis, in their order."""

    flight_of_row: Int[np.ndarray, " rows"]

    @property
    def axis_of_row(self) -> Int[np.ndarray, " rows"]:  # type: ignore[override]
        return np.zeros(self.flight_of_row.size, dtype=np.int64)

    def scores(self, test: Float[np.ndarray, "rows n"], residual: PerRow) -> Float[np.ndarray, "samples n"]:
        return test * residual[:, None]


@dataclass(frozen=True, slots=True)
class AxisRows(RowLayout):
    """Rows are time samples of several axes."""

    flight_of_row: Int[np.ndarray, " rows"]
    axis_of_row: Int[np.ndarray, " rows"]
    samples: Int[np.ndarray, " rows"]

    def scores(self, test: Float[np.ndarray, "rows n"], residual: PerRow) -> Float[np.ndarray, "samples n"]:
        times = np.stack([self.flight_of_row, self.samples], axis=1)
        distinct, position = np.unique(times, axis=0, return_inverse=True)
        scores: Float[np.ndarray, "samples n"] = np.zeros((distinct.shape[0], test.shape[1]))
        np.add.at(scores, position.ravel(), test * residual[:, None])
        return scores


#: Largest variance that products can be formed with.
LARGEST_VARIANCE = 1e150

#: Stands for a layout that was not given: all rows are samples of one flight, however many there are.
ONE_FLIGHT = SampleRows(np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, slots=True)
class RowBlock:
    """Successive rows of a problem. Performs no checks."""

    response: PerRow
    regressors: Float[np.ndarray, "rows n"]
    instruments: Float[np.ndarray, "rows p"]
    flights: Int[np.ndarray, " rows"]


class LinearProblem(ABC):
    """Anything that has rows ``y = Phi theta + e``: arrays, or signals that rows can be cut from."""

    parameters: tuple[Parameter, ...]
    finer: LinearProblem | None = None  # The same with a smaller error of discretisation

    @property
    def names(self) -> tuple[str, ...]:
        return tuple([parameter.name for parameter in self.parameters])

    @abstractmethod
    def rows(self) -> Regression:
        """Rows in arrays."""

    @property
    @abstractmethod
    def instrument_count(self) -> int:
        """Number of instruments, p."""

    def blocks(self, size: int = PASSED_ROWS) -> Iterator[RowBlock]:
        """Rows in their order, block by block; of signals without building them all."""
        return self.rows().blocks(size)

    @abstractmethod
    def regressor_noise_covariance(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        """Covariance of the noises of [Phi y], a mean over rows; a `MissingNoiseError` where not declared."""

    def declared_noise(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"] | None:
        """The same; None where a noise is not declared."""
        try:
            return self.regressor_noise_covariance()
        except MissingNoiseError:
            return None

    @abstractmethod
    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        """Covariance of the noises of Psi with those of [Phi y], averaged over the rows: C and c."""

    @abstractmethod
    def instruments_share_noise(self) -> bool:
        """Return whether an instrument is known to share noise with a regressor or the response."""


@dataclass(frozen=True)
class Regression(LinearProblem):
    """Response, regressors and instruments, row by row.

    Raises
    ------
    ShapeError, NonFiniteError, TooFewSamplesError, CovarianceError
        When lengths differ, that of the layout among them, a number is not finite, there are fewer rows than
        unknowns, or a covariance is not one.
    UsageError
        When two parameters have one name, or an argument is of another type.
    """

    response: Float[np.ndarray, "..."]  # y, shape (rows,)
    regressors: Float[np.ndarray, "..."]  # Phi, shape (rows, n)
    instruments: Float[np.ndarray, "..."]  # Psi, shape (rows, p); zero columns when there are none
    parameters: tuple[Parameter, ...]  # One for each column of Phi
    layout: RowLayout = ONE_FLIGHT  # What the rows are. Default: samples of one flight.
    #: Covariance of the measurement noises of [Phi y], shape (n + 1, n + 1)
    regressor_noise: Float[np.ndarray, "..."] | None = None
    #: Covariance of the noises of Psi with those of [Phi y], shape (p, n + 1)
    instrument_noise: Float[np.ndarray, "..."] | None = None

    def __post_init__(self) -> None:
        for name in ("response", "regressors", "instruments", "regressor_noise", "instrument_noise"):
            values = getattr(self, name)
            if values is not None or not name.endswith("noise"):
                object.__setattr__(self, name, checks.real_array(name, values))
        checks.items("parameters", self.parameters, Parameter, "Parameter")
        checks.kind("layout", self.layout, RowLayout, "a layout of rows", "SampleRows(flights) is one.")
        _check(self)
        rows = self.response.size
        if self.layout is ONE_FLIGHT:
            object.__setattr__(self, "layout", SampleRows(np.zeros(rows, dtype=np.int64)))
        laid_out = self.layout.flight_of_row.shape
        if laid_out != (rows,):
            expected = f"a layout of {rows} rows, as many as the response has"
            remedy = "Give the flight of every row, or no layout for the samples of one flight."
            raise ShapeError(expected, f"one of shape {laid_out}", remedy)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple(p.unit for p in self.parameters)

    def rows(self) -> Regression:
        return self

    @property
    def instrument_count(self) -> int:
        return self.instruments.shape[1]

    def blocks(self, size: int = PASSED_ROWS) -> Iterator[RowBlock]:
        flights = self.layout.flight_of_row
        for stretch in row_blocks(0, self.response.size, size):
            here = slice(*stretch)
            yield RowBlock(self.response[here], self.regressors[here], self.instruments[here], flights[here])

    def regressor_noise_covariance(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        remedy = "Give regression(noise_covariance=...); zeros say that a column is exact."
        return _declared(self.regressor_noise, "measurement noises of regressors and response", remedy)

    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        remedy = "Give regression(instrument_noise_covariance=...); zeros say that they share none."
        description = "instruments' noises with those of regressors and response"
        return _declared(self.instrument_noise, description, remedy)

    def instruments_share_noise(self) -> bool:
        return self.instrument_noise is not None and bool(np.any(self.instrument_noise))


def _declared(covariance: np.ndarray | None, description: str, remedy: str) -> np.ndarray:
    if covariance is None:
        raise MissingNoiseError(f"the covariance of the {description}", "none", remedy)
    return covariance


def _check(problem: Regression) -> None:
    y, Phi, Psi, names = problem.response, problem.regressors, problem.instruments, problem.names
    if y.ndim != 1 or Phi.ndim != 2 or Psi.ndim != 2:
        expected = "a response of shape (rows,), and instruments and regressors with two dimensions"
        remedy = "Stack columns with numpy.column_stack."
        raise ShapeError(expected, f"shapes {y.shape}, {Phi.shape} and {Psi.shape}", remedy)
    rows, unknowns = Phi.shape
    if y.shape != (rows,) or Psi.shape[0] != rows:
        expected = "response, regressors and instruments with equally many rows"
        remedy = "Cut them from the same samples."
        raise ShapeError(expected, f"{y.shape}, {Phi.shape} and {Psi.shape}", remedy)
    if len(names) != unknowns:
        raise ShapeError(f"one name for each of {unknowns} regressors", f"{len(names)}", "Name every column.")
    repeated = sorted(item for item, count in Counter(names).items() if count > 1)
    if repeated:
        expected = "a name of its own for every parameter"
        remedy = "An estimate is requested by the name of its parameter."
        raise UsageError(expected, f"{', '.join(repr(item) for item in repeated)} more than once", remedy)
    if rows < unknowns:
        remedy = "Give a longer record."
        raise TooFewSamplesError(f"at least {unknowns} rows for {unknowns} unknowns", f"{rows}", remedy)
    for name, values in (("response", y), ("regressors", Phi), ("instruments", Psi)):
        check_finite(name, values)
    specific, shared, available = problem.regressor_noise, problem.instrument_noise, Psi.shape[1]
    if specific is not None:
        check_covariance(specific, unknowns + 1)
    if shared is not None:
        if shared.shape != (available, unknowns + 1):
            size, owners = f"{available} x {unknowns + 1}", "the instruments' noises with those of"
            remedy = "Its last column belongs to the response."
            received = f"shape {shared.shape}"
            raise ShapeError(f"a {size} covariance of {owners} [regressors, response]", received, remedy)
        check_finite("instrument noise covariance", shared)


def check_finite(name: str, values: Float[np.ndarray, "..."]) -> None:
    """Raise when a value is not finite; sums first, since almost always all are."""
    with np.errstate(invalid="ignore", over="ignore"):
        if np.isfinite(np.sum(values)):
            return
    bad = ~np.isfinite(values)
    if bad.any():
        received = f"{int(bad.sum())} NaN or infinite, the first in row {int(np.argwhere(bad)[0][0])}"
        raise NonFiniteError(f"finite {name}", received, "Repair or leave out those samples.")


def noise_of_surrogate(rows: Regression, noisier: Regression) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
    """Covariance of the noises in [Phi y], by rows that have so much more of all of them."""
    added = np.column_stack([noisier.regressors - rows.regressors, noisier.response - rows.response])
    return added.T @ added / added.shape[0]


def check_covariance(matrix: Float[np.ndarray, "..."], size: int) -> None:
    """Raise when a matrix is not a covariance of the noises of so many columns."""
    if matrix.shape != (size, size):
        expected = f"a {size} x {size} covariance of the noises of [regressors, response]"
        raise ShapeError(expected, f"shape {matrix.shape}", "Its last row and column belong to the response.")
    check_finite("covariance", matrix)
    if np.abs(matrix).max(initial=0.0) > LARGEST_VARIANCE:
        remedy = "Give columns and noises in other units; products of these no double can hold."
        raise CovarianceError(f"variances up to {LARGEST_VARIANCE:g}", f"{np.abs(matrix).max():g}", remedy)
    lowest = np.abs(np.diag(matrix)[np.diag(matrix) != 0.0]).min(initial=1.0)
    if lowest < 1.0 / LARGEST_VARIANCE:
        remedy = "Give columns and noises in other units, or zero for what is exact."
        raise CovarianceError(f"variances of zero, or from {1.0 / LARGEST_VARIANCE:g}", f"{lowest:g}", remedy)
    scale = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = matrix / np.outer(scale, scale)
    if np.abs(unit - unit.T).max(initial=0.0) > 1e-10:
        raise CovarianceError("a symmetric covariance", "one that is not", "Symmetrise it: 0.5 * (C + C.T).")
    smallest = float(np.linalg.eigvalsh(unit)[0])
    if smallest < -1e-10:
        expected = "a positive semidefinite covariance"
        remedy = "Check the signs and sizes of its off-diagonal elements."
        raise CovarianceError(expected, f"one whose correlations have the eigenvalue {smallest:.3g}", remedy)


def regression(
    response: ArrayLike,
    regressors: ArrayLike,
    instruments: ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    noise_covariance: ArrayLike | None = None,
    instrument_noise_covariance: ArrayLike | None = None,
) -> Regression:
    """Regression of plain arrays, rows in time order.

    Parameters
    ----------
    response : array_like, shape (rows,)
        y.
    regressors : array_like, shape (rows, n) or (rows,)
        Phi. Add a column of ones for an intercept.
    instruments : array_like, shape (rows, p) or (rows,), optional
        Psi, exogenous columns, those of the regressors that are exogenous among them.
    names : sequence of str, optional
        Names of the parameters; default those of a table's columns, as of pandas or polars, or
        ``theta_1``, ``theta_2``, ...
    noise_covariance : array_like, shape (n + 1, n + 1), optional
        Covariance of the measurement noises of the regressors and, last, the response; zero rows and
        columns for exact ones. For total least squares and bias-compensated least squares.
    instrument_noise_covariance : array_like, shape (p, n + 1), optional
        Covariance of the instruments' measurement noises with those of the regressors and, last, the
        response: C and c of the compensated equations. For generalized IV.

    Returns
    -------
    Regression
        In double precision; the arrays given are not modified, and what a mask hides counts as NaN.

    Raises
    ------
    DataError
        When there are complex numbers, texts or dates among the numbers.
    ShapeError, NonFiniteError, TooFewSamplesError, CovarianceError, UsageError
        See `Regression`.
    """
    y, Phi = checks.real_array("response", response), checks.real_array("regressors", regressors)
    Psi = np.empty((y.size, 0)) if instruments is None else checks.real_array("instruments", instruments)
    Phi, Psi = (columns[:, None] if columns.ndim == 1 else columns for columns in (Phi, Psi))
    if names is not None:
        checks.texts("names", names, "Give one name for each regressor.")
    elif (names := getattr(regressors, "columns", None)) is None:
        name = getattr(regressors, "name", None)
        numbered = [f"theta_{j + 1}" for j in range(Phi.shape[1])]
        names = [name] if isinstance(name, str) and name else numbered
    given = {"noise_covariance": noise_covariance, "instrument_noise_covariance": instrument_noise_covariance}
    noises = [None if item is None else checks.real_array(name, item) for name, item in given.items()]
    return Regression(y, Phi, Psi, tuple([Parameter(str(label)) for label in names]), ONE_FLIGHT, *noises)
