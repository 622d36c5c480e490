"""Regressions of a fractional difference equation: at known orders, and for orders that are sought."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eivor.errors import MissingNoiseError
from eivor.linalg.row_blocks import PASSED_ROWS
from eivor.models.column import Column
from eivor.models.equation import Parameter
from eivor.models.fractional.column import FractionalColumn
from eivor.models.fractional.filtered_signals import FilteredSignals
from eivor.models.regression import LinearProblem, Regression, RowBlock
from eivor.shapes import Float


@dataclass(frozen=True)
class FractionalRegression(LinearProblem):
    """Rows of a fractional difference equation whose orders are known.

    Parameters
    ----------
    filtered : FilteredSignals
        Where columns come from.
    parameters : tuple of Parameter
        One for each regressor.
    response : FractionalColumn
        Left side.
    regressors : tuple of FractionalColumn
        Right side.
    instrument_columns : tuple of Column
        Instruments; may be empty.

    Notes
    -----
    Rows start at the largest lag of any column. O(n log n) in the samples.
    """

    filtered: FilteredSignals
    parameters: tuple[Parameter, ...]
    response: FractionalColumn
    regressors: tuple[FractionalColumn, ...]
    instrument_columns: tuple[Column, ...] = ()
    first: int = field(init=False)

    def __post_init__(self) -> None:
        parts = [part.lag for column in (self.response, *self.regressors) for part in column]
        object.__setattr__(self, "first", max([*parts, *(column.lag for column in self.instrument_columns)]))

    @property
    def instrument_count(self) -> int:
        """Number of instruments."""
        return len(self.instrument_columns)

    @cached_property
    def _rows(self) -> Regression:
        Phi = np.column_stack([self.filtered.values(column, self.first) for column in self.regressors])
        signals = self.filtered.signals
        instruments = [column.values(signals, self.first) for column in self.instrument_columns]
        Psi = np.column_stack(instruments) if instruments else np.empty((Phi.shape[0], 0))
        try:
            noise = self.regressor_noise_covariance()
        except MissingNoiseError:
            noise = None
        response = self.filtered.values(self.response, self.first)
        return Regression(response, Phi, Psi, self.parameters, regressor_noise=noise)

    def rows(self) -> Regression:
        """Rows in arrays, built once."""
        return self._rows

    def blocks(self, size: int = PASSED_ROWS) -> Iterator[RowBlock]:
        """Views of successive rows."""
        return self._rows.blocks(size)

    @cached_property
    def _own_noise(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        return self.filtered.noise_covariance((*self.regressors, self.response), self.first)

    def regressor_noise_covariance(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        """Noise covariance of [Phi y] from the columns' tags and the declared noises.

        Raises
        ------
        MissingNoiseError
            When the noise of a channel is not declared.
        """
        return self._own_noise

    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        """C and c from the columns' tags and the declared noises.

        Raises
        ------
        MissingNoiseError
            When an instrument and another column are of one channel whose noise is not declared.
        """
        columns = (*self.regressors, self.response)
        return self.filtered.shared_noise(self.instrument_columns, columns, self.first)

    def instruments_share_noise(self) -> bool:
        """Return whether declared noises make an instrument and another column correlated."""
        declared = self.filtered.signals.noise
        known = tuple(column for column in self.instrument_columns if column.channel in declared)
        columns = (*self.regressors, self.response)
        return bool(np.any(self.filtered.shared_noise(known, columns, self.first)))
