"""A regression that stays with the signals it is cut from: its rows are views until they are asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eivor import checks
from eivor.errors import MissingNoiseError
from eivor.linalg.row_blocks import PASSED_ROWS, row_blocks
from eivor.models.column import Column, check_columns
from eivor.models.equation import Equation, Parameter
from eivor.models.regression import LinearProblem, Regression, RowBlock
from eivor.models.shared_noise import shared_noise
from eivor.shapes import Bool, Float
from eivor.signals.signals import Signals


class SignalModel(ABC):
    """An equation of motion in channels: what rows it cuts from signals, whole or in chunks."""

    @abstractmethod
    def regression(self, signals: Signals, instruments: tuple[Column, ...] = ()) -> SignalRegression:
        """Rows of `signals`, cut when they are asked for."""

    @abstractmethod
    def regression_lag(self, instruments: tuple[Column, ...] = ()) -> int:
        """Samples that a row reaches back."""


@dataclass(frozen=True)
class SignalRegression(LinearProblem):
    """Rows of an equation in signals.

    Parameters
    ----------
    signals : Signals
        Where the columns come from.
    equation : Equation
        Response and regressors.
    instrument_columns : tuple of Column
        Instruments; may be empty.

    Notes
    -----
    Rows start at the largest lag of any column, and leave out samples whose history is not valid.
    """

    signals: Signals
    equation: Equation
    instrument_columns: tuple[Column, ...] = ()
    parameters: tuple[Parameter, ...] = field(init=False)

    def __post_init__(self) -> None:
        checks.kind("signals", self.signals, Signals, "Signals")
        checks.kind("equation", self.equation, Equation, "an Equation", "VerticalMotion().equation() is one.")
        check_columns("instrument_columns", self.instrument_columns)
        object.__setattr__(self, "parameters", tuple(parameter for parameter, _ in self.equation.terms))

    @property
    def regressor_columns(self) -> tuple[Column, ...]:
        """Columns of the right side."""
        return tuple(column for _, column in self.equation.terms)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def instrument_count(self) -> int:
        """Number of instruments."""
        return len(self.instrument_columns)

    @property
    def first(self) -> int:
        """Sample of the first row."""
        columns = (self.equation.response, *self.regressor_columns, *self.instrument_columns)
        return max(column.lag for column in columns)

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
        """Values of one column.

        Raises
        ------
        MissingChannelError, TooFewSamplesError
            When the channel is absent, or the record shorter than the largest lag.
        """
        values = column.values(self.signals, self.first)
        return values if self.used is None else values[self.used]

    @cached_property
    def _rows(self) -> Regression:
        Phi = np.column_stack([self.column(column) for column in self.regressor_columns])
        instruments = [self.column(column) for column in self.instrument_columns]
        Psi = np.column_stack(instruments) if instruments else np.empty((Phi.shape[0], 0))
        return Regression(
            self.column(self.equation.response),
            Phi,
            Psi,
            self.parameters,
            regressor_noise=self.declared_regressor_noise(),
        )

    def rows(self) -> Regression:
        """Rows in arrays, built once."""
        return self._rows

    def blocks(self, size: int = PASSED_ROWS) -> Iterator[RowBlock]:
        """Rows of successive stretches of the signals; a stretch may have none where samples are invalid."""
        for start, stop in row_blocks(self.first, self.signals.sample_count, size):
            response = self.columns_between([self.equation.response], start, stop)[:, 0]
            yield RowBlock(
                response,
                self.columns_between(self.regressor_columns, start, stop),
                self.columns_between(self.instrument_columns, start, stop),
                np.zeros(response.size, dtype=np.int64),
            )

    def columns_between(
        self, columns: Sequence[Column], start: int, stop: int
    ) -> Float[np.ndarray, "rows columns"]:
        """Columns of the rows from sample `start` to `stop`, each contiguous in memory."""
        every = self.samples_between(columns, start, stop)
        if self.used is None:
            return every
        rows: Float[np.ndarray, "rows columns"] = every.T[
            :, self.used[start - self.first : stop - self.first]
        ].T
        return rows

    def samples_between(
        self, columns: Sequence[Column], start: int, stop: int
    ) -> Float[np.ndarray, "samples columns"]:
        """Columns of all samples from `start` to `stop`, those among them that are no rows."""
        block = np.empty((len(columns), stop - start))
        for place, column in enumerate(columns):
            block[place] = self.slice_of(column, start, stop)
            if column.gain != 1.0:
                block[place] *= column.gain
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
        """Noise covariance of [Phi y] from the columns' tags and the declared noises.

        Raises
        ------
        MissingNoiseError
            When the noise of a channel is not declared.
        """
        columns = (*self.regressor_columns, self.equation.response)
        return shared_noise(columns, columns, self.signals, self.first, self.used)

    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        """C and c from the columns' tags and the declared noises.

        Raises
        ------
        MissingNoiseError
            When an instrument and another column are of one channel whose noise is not declared.
        """
        columns = (*self.regressor_columns, self.equation.response)
        return shared_noise(self.instrument_columns, columns, self.signals, self.first, self.used)

    def declared_regressor_noise(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"] | None:
        """Covariance of the noises of [Phi y]; None when a channel's noise is not declared."""
        try:
            return self.regressor_noise_covariance()
        except MissingNoiseError:
            return None

    def instruments_share_noise(self) -> bool:
        """Return whether declared noises make an instrument and another column correlated."""
        others = (*self.regressor_columns, self.equation.response)
        declared = set(self.signals.noise)
        pairs = [
            (one, other)
            for one in self.instrument_columns
            for other in others
            if one.channel and one.channel == other.channel and one.channel in declared
        ]
        at = (self.signals, self.first, self.used)
        return any(shared_noise([one], [other], *at).any() for one, other in pairs)
