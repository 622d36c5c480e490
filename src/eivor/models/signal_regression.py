"""Regression on signals, with shared noise and cross-fitting."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from eivor import checks
from eivor.errors import MissingNoiseError, TooFewSamplesError
from eivor.linalg.system import COPIED_ROWS, PASSED_ROWS, row_blocks
from eivor.models.regression import (
    Column,
    Equation,
    LinearProblem,
    Parameter,
    Regression,
    RowBlock,
    check_columns,
)
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float

#: Blocks of a record.
BLOCKS = 5
#: Columns of unit variance are shrunk as if so much of their variance were noise: directions in which they
#: hardly differ would else be fitted to what one block happens to hold, and lead far astray in another.
SHRINKAGE = 1e-6


def cross_fitted(
    exogenous: Float[np.ndarray, "n p"], values: Float[np.ndarray, "n k"], used: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n k"]:
    """Predictions of each column, by least squares with a constant over the samples used of other blocks."""
    design = _scaled(exogenous, used)
    samples = np.flatnonzero(used)
    if samples.size < 2 * BLOCKS * design.shape[1]:
        return np.broadcast_to(values[used].mean(axis=0) if samples.size else 0.0 * values[0], values.shape)
    parts = np.array_split(samples, BLOCKS)
    columns = np.column_stack([design, values])
    products = [design[part].T @ columns[part] for part in parts]
    total = np.sum(products, axis=0)
    # each block reaches from the middle between its samples and those before to that of those after
    edges = [0, *((previous[-1] + following[0] + 1) // 2 for previous, following in pairwise(parts))]
    predicted = np.empty_like(values)
    for start, stop, excluded in zip(edges, [*edges[1:], values.shape[0]], products, strict=True):
        normal, right = np.split(total - excluded, [design.shape[1]], axis=1)
        shrunk = SHRINKAGE * normal[0, 0] * np.diag(np.arange(normal.shape[0]) > 0)
        predicted[start:stop] = design[start:stop] @ np.linalg.lstsq(normal + shrunk, right, rcond=None)[0]
    return predicted


def _scaled(exogenous: Float[np.ndarray, "n p"], used: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n q"]:
    """A constant, and the columns with mean zero and variance one over the samples used."""
    constant = np.ones((exogenous.shape[0], 1))
    if not exogenous.shape[1] or not used.any():
        return constant
    centred = exogenous - exogenous[used].mean(axis=0)
    size = np.sqrt(np.mean(centred[used] ** 2, axis=0))
    return np.column_stack([constant, centred / np.where(size > 0.0, size, 1.0)])


def shared_noise(
    left: Sequence[Column],
    right: Sequence[Column],
    signals: Signals,
    first: int,
    rows: Bool[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "left right"]:
    """Average covariance of the measurement noises of two sets of columns."""
    count = signals.sample_count - first
    if count < 1 or not (rows is None or rows.any()):
        expected = f"rows: valid samples with {first} more before them"
        received = f"{signals.sample_count} samples, valid or not, and no row"
        raise TooFewSamplesError(expected, received, "Give a longer record, fewer lags, or fewer gaps.")
    shared = np.zeros((len(left), len(right)))
    for i, j, a, b in _channel_pairs(left, right):
        noise = _declared(a, signals)
        if isinstance(noise, WhiteNoise) and not (a.gain_channel or b.gain_channel):
            total, used = (noise.variance if a.lag == b.lag else 0.0), 1  # the same in every row
        else:
            total, used = 0.0, 0
            for start, stop in row_blocks(0, count, COPIED_ROWS):  # no series as long as the record is made
                block = slice(start, stop)
                growth = _growth(a, b, signals, first, block)
                growth = growth if rows is None else growth[rows[block]]
                total += float(growth.sum())
                used += growth.size
        shared[i, j] = a.gain * b.gain * total / used
    return shared


def _channel_pairs(
    left: Sequence[Column], right: Sequence[Column]
) -> Iterator[tuple[int, int, Column, Column]]:
    """Places and columns of all pairs that are of one channel."""
    for (i, a), (j, b) in product(enumerate(left), enumerate(right)):
        if a.channel and a.channel == b.channel:
            yield i, j, a, b


def _growth(a: Column, b: Column, signals: Signals, first: int, block: slice) -> Float[np.ndarray, " rows"]:
    """Covariance of the noises of two columns in each of some rows, but for constant gains."""
    lag = abs(a.lag - b.lag)
    begin = signals.offset + first - max(a.lag, b.lag)
    growth = signals.noise[a.channel].autocovariance(lag, begin + block.start, block.stop - block.start)
    for column in (a, b):
        if column.gain_channel:
            growth = growth * signals.channel(column.gain_channel)[first:][block]
    return growth


def shared_noise_of_rows(
    left: Sequence[Column], right: Sequence[Column], signals: Signals, first: int
) -> dict[tuple[int, int], Float[np.ndarray, " rows"]]:
    """Covariance of the measurement noises of two sets of columns in every row from `first` on."""
    block = slice(0, max(signals.sample_count - first, 0))
    return {
        (i, j): a.gain * b.gain * _growth(a, b, signals, first, block)
        for i, j, a, b in _channel_pairs(left, right)
        if not isinstance(_declared(a, signals), WhiteNoise) or a.lag == b.lag
    }


def _declared(column: Column, signals: Signals) -> MeasurementNoise:
    noise = signals.noise.get(column.channel)
    if noise is None:
        raise MissingNoiseError(
            f"a declared noise of channel '{column.channel}', which instruments and regressors share",
            f"noise of {', '.join(sorted(signals.noise)) or 'no channel'}",
            "Declare it in Signals(noise=...), with std 0 if the channel is exact, use other instruments, or "
            "have it estimated: ev.methods.generalized_iv_unknown_noise().",
        )
    return noise


class SignalModel(ABC):
    """An equation of motion in channels: what rows it cuts from signals, whole or in chunks."""

    @abstractmethod
    def regression(self, signals: Signals, instruments: tuple[Column, ...] = ()) -> SignalRegression:
        """Rows of `signals`, cut when they are requested."""

    @abstractmethod
    def regression_lag(self, instruments: tuple[Column, ...] = ()) -> int:
        """Samples that a row reaches back."""


@dataclass(frozen=True)
class SignalRegression(LinearProblem):
    """Rows of an equation in signals.

    Notes
    -----
    Rows start at the largest lag of any column, and leave out samples whose history is not valid.
    """

    signals: Signals  # Where the columns come from
    equation: Equation  # Response and regressors
    instrument_columns: tuple[Column, ...] = ()  # Instruments; may be empty
    parameters: tuple[Parameter, ...] = field(init=False)
    #: Columns of the right side, all columns [psi phi y], and the sample of the first row
    regressor_columns: tuple[Column, ...] = field(init=False, repr=False, compare=False)
    columns: tuple[Column, ...] = field(init=False, repr=False, compare=False)
    first: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        checks.kind("signals", self.signals, Signals, "Signals")
        checks.kind("equation", self.equation, Equation, "an Equation", "VerticalMotion().equation() is one.")
        check_columns("instrument_columns", self.instrument_columns)
        regressors = tuple([column for _, column in self.equation.terms])
        columns = (*self.instrument_columns, *regressors, self.equation.response)
        object.__setattr__(self, "parameters", tuple([parameter for parameter, _ in self.equation.terms]))
        object.__setattr__(self, "regressor_columns", regressors)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "first", max([column.lag for column in columns]))

    @property
    def instrument_count(self) -> int:
        return len(self.instrument_columns)

    @cached_property
    def used(self) -> Bool[np.ndarray, " rows"] | None:
        """Which samples from `first` on are rows; None for all of them."""
        valid = self.signals.valid
        if valid is None or bool(valid.all()):
            return None
        lag = self.first
        if valid.size <= lag:
            return np.zeros(0, dtype=np.bool_)
        broken = np.concatenate([[0], np.cumsum(~valid)])
        return np.asarray(broken[lag + 1 :] - broken[: valid.size - lag] == 0)

    def column(self, column: Column) -> Float[np.ndarray, " rows"]:
        """Values of one column."""
        values = column.values(self.signals, self.first)
        return values if self.used is None else values[self.used]

    @cached_property
    def _rows(self) -> Regression:
        p, count = self.instrument_count, self.signals.sample_count
        rows = self.columns_between(self.columns, self.first, max(count, self.first))
        noise = self.declared_noise()
        return Regression(rows[:, -1], rows[:, p:-1], rows[:, :p], self.parameters, regressor_noise=noise)

    def rows(self) -> Regression:
        return self._rows

    def blocks(self, size: int = PASSED_ROWS) -> Iterator[RowBlock]:
        """Rows of successive stretches of the signals that have some."""
        p = len(self.instrument_columns)
        for start, stop in row_blocks(self.first, self.signals.sample_count, size):
            rows = self.columns_between(self.columns, start, stop)
            if rows.size:
                yield RowBlock(rows[:, -1], rows[:, p:-1], rows[:, :p], np.zeros(len(rows), dtype=np.int64))

    def columns_between(
        self, columns: Sequence[Column], start: int, stop: int
    ) -> Float[np.ndarray, "rows columns"]:
        """Columns of the rows from sample `start` to `stop`, each contiguous in memory."""
        samples = self.samples_between(columns, start, stop)
        if self.used is None:
            return samples
        return samples.T[:, self.used[start - self.first : stop - self.first]].T

    def samples_between(
        self, columns: Sequence[Column], start: int, stop: int
    ) -> Float[np.ndarray, "samples columns"]:
        """Columns of all samples from `start` to `stop`, those among them that are no rows."""
        block = np.empty((len(columns), stop - start))
        for index, column in enumerate(columns):
            block[index] = self.slice_of(column, start, stop)
            if column.gain != 1.0:
                block[index] *= column.gain
        return block.T

    def slice_of(self, column: Column, start: int, stop: int) -> Float[np.ndarray, " samples"]:
        """Column from sample `start` to `stop` without its constant gain: a view, unless it is multiplied."""
        if not column.channel:
            values: Float[np.ndarray, " samples"] = np.ones(stop - start)
        else:
            values = self.signals.channel(column.channel)[start - column.lag : stop - column.lag]
        if column.gain_channel:
            values = values * self.signals.channel(column.gain_channel)[start:stop]
        return values

    def regressor_noise_covariance(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        columns = self.columns[self.instrument_count :]
        return shared_noise(columns, columns, self.signals, self.first, self.used)

    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        columns = self.columns[self.instrument_count :]
        return shared_noise(self.instrument_columns, columns, self.signals, self.first, self.used)

    def instruments_share_noise(self) -> bool:
        others = self.columns[self.instrument_count :]
        declared = {other.channel for other in others} & set(self.signals.noise)
        noisy = [column for column in self.instrument_columns if column.channel in declared]
        return bool(noisy) and bool(shared_noise(noisy, others, self.signals, self.first, self.used).any())
