"""Rows of successive samples: every sample has one, and those that do not count are zeros."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eivor.errors import InstrumentError
from eivor.estimation.assembler import Assembler
from eivor.linalg.row_blocks import PASSED_ROWS, row_blocks
from eivor.models.regression import RowBlock
from eivor.models.shared_noise import shared_noise_of_rows
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Bool, Float

#: Places (instrument, column) of a table of noises that vary from row to row.
Places = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class TimedRows:
    """Rows of successive samples.

    Parameters
    ----------
    psi : ndarray, shape (samples, p)
        Test functions.
    right : ndarray, shape (samples, n + 1)
        Regressors and response.
    noise : ndarray, shape (samples, s)
        What measurement noises add to the products of psi and right at `places`, on average.
    counted : ndarray, shape (samples,)
        One where the sample counts, zero where it does not.
    places : tuple of tuple of int
        Row and column of each noise.

    Notes
    -----
    Performs no checks. Rows that do not count are zeros.
    """

    psi: Float[np.ndarray, "samples p"]
    right: Float[np.ndarray, "samples n_plus_1"]
    noise: Float[np.ndarray, "samples s"]
    counted: Float[np.ndarray, " samples"]
    places: Places = ()

    @property
    def count(self) -> int:
        """Samples, those among them that do not count."""
        return self.counted.size

    @cached_property
    def columns(self) -> Float[np.ndarray, "samples columns"]:
        """[psi right noise counted]."""
        return np.column_stack([self.psi, self.right, self.noise, self.counted])

    def from_columns(self, columns: Float[np.ndarray, "samples columns"]) -> TimedRows:
        """Other rows of the same columns."""
        ends = np.cumsum([self.psi.shape[1], self.right.shape[1], self.noise.shape[1]])
        psi, right, noise, counted = np.split(columns, ends, axis=1)
        return replace(self, psi=psi, right=right, noise=noise, counted=counted[:, 0])

    def between(self, start: int, stop: int) -> TimedRows:
        """Rows of a stretch of samples."""
        here = slice(start, stop)
        return replace(
            self,
            psi=self.psi[here],
            right=self.right[here],
            noise=self.noise[here],
            counted=self.counted[here],
        )

    def then(self, other: TimedRows) -> TimedRows:
        """Rows of both, one after the other."""
        if not self.count:
            return other
        return self.from_columns(np.concatenate([self.columns, other.columns]))

    def stretches(self, first: int, look: int) -> Iterator[TimedRows]:
        """Stretches that end where a multiple of `look` samples is full, of which `first` came before."""
        start = 0
        while start < self.count:
            stop = min(start + look - (first + start) % look, self.count)
            yield self.between(start, stop)
            start = stop


def timed_rows(problem: SignalRegression, assembler: Assembler) -> Iterator[TimedRows]:
    """Rows of signals, stretch by stretch.

    Parameters
    ----------
    problem : SignalRegression
        Rows from its first on.
    assembler : Assembler
        Which test functions, and whether their products are compensated.

    Raises
    ------
    InstrumentError
        When instruments share declared noise with other columns and nothing is compensated.
    MissingNoiseError
        When a noise that must be compensated is not declared.
    """
    if assembler.plain_products and problem.instruments_share_noise():
        raise InstrumentError(
            "instruments whose measurement noise no regressor and no response shares",
            "an instrument of the same channel and lag as a noisy regressor",
            "Use lags from 1 on, another channel, or generalized_iv.",
        )
    signals, first = problem.signals, problem.first
    if signals.sample_count <= first:
        return
    tested = problem.instrument_columns if assembler.needs_instruments else problem.regressor_columns
    right = (*problem.regressor_columns, problem.equation.response)
    noises = shared_noise_of_rows(tested, right, signals, first) if assembler.compensates else {}
    for start, stop in row_blocks(first, signals.sample_count, PASSED_ROWS):
        here = slice(start - first, stop - first)
        used = np.ones(stop - start, dtype=np.bool_) if problem.used is None else problem.used[here]
        block = RowBlock(
            problem.samples_between([problem.equation.response], start, stop)[:, 0],
            problem.samples_between(problem.regressor_columns, start, stop),
            problem.samples_between(problem.instrument_columns, start, stop),
            np.zeros(stop - start, dtype=np.int64),
        )
        noise = (
            np.stack([noises[place][here] for place in noises], axis=1) if noises else used[:, None][:, :0]
        )
        yield counted_rows(
            assembler.test_functions(block),
            np.column_stack([block.regressors, block.response]),
            noise.astype(np.float64),
            used,
            tuple(noises),
        )


def counted_rows(
    psi: Float[np.ndarray, "samples p"],
    right: Float[np.ndarray, "samples n_plus_1"],
    noise: Float[np.ndarray, "samples s"],
    used: Bool[np.ndarray, " samples"],
    places: Places = (),
) -> TimedRows:
    """Rows with zeros where a sample does not count, whatever stands there."""
    if not used.all():
        psi, right, noise = (np.where(used[:, None], part, 0.0) for part in (psi, right, noise))
    return TimedRows(psi, right, noise, used.astype(np.float64), places)
