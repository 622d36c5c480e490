"""Diagnose: what an estimate rests on, each part made when it is first asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.diagnosis_reasons import reasons_of
from eivor.estimation.diagnosis_table import summary_of, table_of
from eivor.estimation.estimate import Estimate
from eivor.estimation.inferred import Solved
from eivor.estimation.record_products import RecordProducts, record_products
from eivor.inference.diagnostics.constancy import GROUPS, Constancy, constancy
from eivor.inference.diagnostics.endogeneity import Endogeneity, endogeneity
from eivor.inference.diagnostics.excitation import BandPower, Information, band_power, information
from eivor.inference.diagnostics.first_stage import FirstStage, first_stage
from eivor.inference.diagnostics.leverage import SegmentLeverage, segment_leverage
from eivor.inference.diagnostics.over_identification import OverIdentification, robust_over_identification
from eivor.inference.diagnostics.residual_memory import residual_memory
from eivor.inference.diagnostics.residual_whiteness import ResidualWhiteness, residual_whiteness
from eivor.inference.diagnostics.time_products import block_edges
from eivor.inference.verdict import Reason
from eivor.models.signal_regression import SignalRegression
from eivor.signals.long_memory import LongMemory

if TYPE_CHECKING:
    import polars as pl

#: Segments that are left out one at a time.
SEGMENTS = 10
#: A residual below this share of the terms of its equation is rounding.
ROUNDING = 1e-13


def diagnose(estimate: Estimate) -> Diagnostics:
    """Diagnostics of an estimate at its best delay.

    Parameters
    ----------
    estimate : Estimate
        With its rows at hand.

    Returns
    -------
    Diagnostics
        Whose parts are computed when they are first used, and kept.

    Raises
    ------
    EstimationError
        For an estimate from moments, which do not keep the rows.

    Notes
    -----
    One pass over the rows gives sums of products over a hundred blocks or so, from which strength, J,
    endogeneity, constancy and leverage follow; whiteness, memory and spectra read the residual.
    """
    solved = estimate.best.solved
    if solved is None:
        raise EstimationError(
            "an estimate with its rows at hand, for diagnostics",
            "an estimate from moments, which do not keep the rows",
            "Identify a chunk that fits in memory, or the whole problem.",
        )
    return Diagnostics(estimate, solved)


@dataclass(frozen=True)
class Diagnostics:
    """What an estimate rests on.

    Parameters
    ----------
    estimate : Estimate
        The estimate; everything is said of its best delay.
    solved : Solved
        How that was solved.
    """

    estimate: Estimate = field(repr=False)
    solved: Solved = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter, in the order of every array."""
        return self.estimate.names

    @cached_property
    def first_stage(self) -> FirstStage | None:
        """Strength of the instruments; None without instruments."""
        if not self._instrumental or self._too_short:
            return None
        return first_stage(self._record.products)

    @cached_property
    def over_identification(self) -> OverIdentification | None:
        """Hansen's J with a weight that allows for autocorrelation; None without instruments."""
        if not self._instrumental or self._too_short:
            return None
        return robust_over_identification(self._record.products)

    @cached_property
    def endogeneity(self) -> Endogeneity | None:
        """Least squares against the estimate; None when the estimate is a kind of least squares."""
        if not self._instrumental or self._too_short:
            return None
        return endogeneity(self._record.products, self._record.weights)

    @cached_property
    def whiteness(self) -> ResidualWhiteness:
        """Autocorrelation of the residual in time; of rows in frequency, of the residual in their band."""
        return residual_whiteness(np.ascontiguousarray(self._record.residual[:: self._record.thinning]))

    @cached_property
    def memory(self) -> LongMemory | None:
        """Long memory of the residual.

        None for a record that is too short, a residual of zero, or rows in frequency, which lack the lowest.
        """
        return None if self._record.thinning is not None else residual_memory(self._record.residual)

    @cached_property
    def information(self) -> Information:
        """Scaled information matrix: which combination of parameters is determined worst."""
        return information(self._record.products, instrumental=self._instrumental)

    @cached_property
    def bands(self) -> BandPower:
        """Power of each column against that of the residual, in bands."""
        record = self._record
        rate_hz = 1.0 if record.step_s is None else 1.0 / record.step_s
        return band_power(record.columns, record.factors, record.residual, rate_hz)

    @cached_property
    def constancy(self) -> Constancy | None:
        """Whether the parameters changed during the record; None for fewer than 64 samples."""
        sums = self._record.score_sums
        if sums.shape[0] % GROUPS:
            return None
        return constancy(sums, np.asarray(self._record.sensitivities.sum(axis=0)))

    @cached_property
    def leverage(self) -> SegmentLeverage | None:
        """What leaving out each of ten segments of equal length does.

        None for too few samples, or for a residual that is nothing but rounding.
        """
        if self._record.products.counts.size < 2 * SEGMENTS or self._fits_exactly:
            return None
        std_errors = np.array([self.estimate.std_error(name) for name in self.names])
        starts = block_edges(self._record.products.counts.size, SEGMENTS)[:-1]
        return segment_leverage(
            np.add.reduceat(self._record.score_sums, starts, axis=0),
            np.add.reduceat(self._record.sensitivities, starts, axis=0),
            std_errors,
        )

    @cached_property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First sample and end of each segment of `leverage`."""
        counts = self._record.products.counts
        ends = np.concatenate([[0.0], np.cumsum(counts)])[block_edges(counts.size, SEGMENTS)]
        return tuple((int(a), int(b)) for a, b in pairwise(ends))

    def when(self, share: float) -> str:
        """Where a share of the rows is: in seconds and samples of a record, else in rows."""
        return self.at_row(round(share * self._record.residual.size))

    def at_row(self, row: int) -> str:
        """Where a row is: in seconds and samples of a record, gaps and first lags counted, else as it is."""
        problem = self.solved.problem
        if not isinstance(problem, SignalRegression):
            step_s = self._record.step_s
            return f"row {row}" if step_s is None else f"{row * step_s:.4g} s of the time used"
        used = problem.used
        beyond = row
        if used is not None:
            places = np.append(np.flatnonzero(used), used.size)
            beyond = int(places[min(row, places.size - 1)])
        sample, signals = problem.first + beyond, problem.signals
        time = signals.start_s + sample * signals.step_s
        return f"{time:.4g} s (sample {signals.offset + sample})"

    @cached_property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return tuple(reasons_of(self))

    def to_frame(self) -> pl.DataFrame:
        """Table of every number.

        Returns
        -------
        polars.DataFrame
            Columns `diagnostic`, `of` (parameter, lag or band; empty for the whole), `value` and `compare`:
            the critical value, p-value, standard error or band that the value is to be held against.
        """
        import polars as pl

        rows = table_of(self)
        columns = ("diagnostic", "of", "value", "compare")
        return pl.DataFrame(
            rows,
            schema=dict.fromkeys(columns[:2], pl.String) | dict.fromkeys(columns[2:], pl.Float64),
            orient="row",
        )

    def summary(self) -> str:
        """Every diagnostic in a line or two, and what to do about those that matter."""
        return summary_of(self)

    @property
    def _instrumental(self) -> bool:
        return self.solved.method.assembler.needs_instruments

    @property
    def _fits_exactly(self) -> bool:
        record = self._record
        parts = zip(record.factors, record.columns, strict=True)
        size = sum((abs(factor) * float(np.abs(one).max()) for factor, one in parts), start=0.0)
        return float(np.abs(record.residual).max()) <= ROUNDING * size

    @property
    def _too_short(self) -> bool:
        """Fewer blocks than a long-run covariance of as many scores needs."""
        products = self._record.products
        return products.counts.size < 4 * products.whitening.shape[1]

    @cached_property
    def _record(self) -> RecordProducts:
        return record_products(self.solved)
