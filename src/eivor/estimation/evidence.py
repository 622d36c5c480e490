"""What diagnostics are made of: an estimate with its record, and a table of their makers.

A new diagnostic is one file, a class with its maker, and one line in the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.estimation.products.at_estimate import Record, record_of
from eivor.estimation.solved import Solved
from eivor.inference.diagnostics.constancy import GROUPS, Constancy, constancy
from eivor.inference.diagnostics.diagnostic import Diagnostic, Subject
from eivor.inference.diagnostics.endogeneity import Endogeneity, endogeneity
from eivor.inference.diagnostics.excitation import BandPower, Information, band_power, information, largest
from eivor.inference.diagnostics.influences import influences
from eivor.inference.diagnostics.leverage import SegmentLeverage, segment_leverage
from eivor.inference.diagnostics.over_identification import OverIdentification, robust_over_identification
from eivor.inference.diagnostics.periodicity import (
    LEAST_BLOCKS,
    Periodicity,
    Swing,
    block_sums,
    blocks_of,
    strongest_swings,
)
from eivor.inference.diagnostics.residual_memory import ResidualMemory, residual_memory
from eivor.inference.diagnostics.residual_whiteness import ResidualWhiteness, residual_whiteness
from eivor.inference.diagnostics.strength import Strength, strength
from eivor.inference.products import block_edges
from eivor.models.signal_regression import SignalRegression
from eivor.models.spectral import BinRows
from eivor.shapes import Float

#: Segments that are left out one at a time.
SEGMENTS = 10
#: A residual below this share of the terms of its equation is rounding.
ROUNDING = 1e-13


@dataclass(frozen=True)
class Evidence:
    """An estimate at its best candidate, and its record.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    solved : Solved
        How it was solved.
    """

    estimate: Estimate
    solved: Solved

    @cached_property
    def record(self) -> Record:
        """Products of the record's columns over blocks of time, and its residual."""
        return record_of(self.solved)

    @property
    def instrumental(self) -> bool:
        """Whether the method has instruments."""
        return self.solved.assembler.needs_instruments

    @property
    def testable(self) -> bool:
        """Whether there are instruments, and blocks enough for the long-run covariance of their scores."""
        products = self.record.products
        return self.instrumental and products.counts.size >= 4 * products.whitening.shape[1]

    @property
    def in_frequency(self) -> bool:
        """Whether the rows are bins of spectra, whitened."""
        return self.record.thinning is not None

    @cached_property
    def fits_exactly(self) -> bool:
        """Whether the residual is nothing but rounding."""
        record, products = self.record, self.record.products
        theta = np.abs(self.solved.solution.theta)
        # The products settle it without a pass: no value is above the root of its sum of squares.
        roots = np.sqrt(np.diag(products.regressor_mean)[: theta.size])
        if float(products.power.sum()) > (ROUNDING * products.count * float(theta @ roots)) ** 2:
            return False
        parts = zip(record.factors, record.columns, strict=True)
        size = sum((abs(factor) * largest(one) for factor, one in parts), start=0.0)
        return largest(record.residual) <= ROUNDING * size

    @cached_property
    def subject(self) -> Subject:
        """The estimate, as the sentences of its diagnostics name it."""
        names = self.estimate.names
        errors = np.array([self.estimate.std_error(name) for name in names])
        return Subject(names, errors, self.at_row, self.record.residual.size)

    def at_row(self, row: int) -> str:
        """Where a row is: in seconds and samples of a record, gaps and first lags counted, else as it is."""
        problem = self.solved.problem
        if not isinstance(problem, SignalRegression):
            step_s = self.record.step_s
            return f"row {row}" if step_s is None else f"{row * step_s:.4g} s of the time used"
        used = problem.used
        beyond = row
        if used is not None:
            places = np.append(np.flatnonzero(used), used.size)
            beyond = int(places[min(row, places.size - 1)])
        sample, signals = problem.first + beyond, problem.signals
        time = signals.start_s + sample * signals.step_s
        return f"{time:.4g} s (sample {signals.offset + sample})"

    @property
    def in_one_flight(self) -> bool:
        """Whether all rows are of one flight, and share its time."""
        if isinstance(self.solved.problem, SignalRegression):
            return True
        flights = self.solved.rows.layout.flight_of_row
        return not bool((flights != flights[:1]).any())

    @cached_property
    def times(self) -> Float[np.ndarray, " samples"] | None:
        """Time of each sample of the residual of one flight; None where samples are one step apart."""
        step, problem = self.record.step_s or 1.0, self.solved.problem
        if isinstance(problem, SignalRegression):
            return None if problem.used is None else step * np.flatnonzero(problem.used)
        layout = self.solved.rows.layout
        if not isinstance(layout, BinRows):
            return None
        return step * np.concatenate([run.start + np.arange(run.length) for run in layout.runs])


def _strength(evidence: Evidence) -> Strength | None:
    """Strength of the instruments; None without instruments."""
    if not evidence.testable:
        return None
    made = evidence.solved.products
    of_rows = made is None or not made.layout.whole  # else they come from products, as the estimate's warning
    conditional = evidence.estimate.best.inference.first_stage if of_rows else None
    return strength(evidence.record.products, conditional=conditional)


def _over_identification(evidence: Evidence) -> OverIdentification | None:
    """Hansen's J; None without instruments.

    Of whitened rows with their variance, which is what the whitening is for; of others with a weight that
    allows for autocorrelation.
    """
    if evidence.instrumental and evidence.in_frequency:
        inference = evidence.estimate.best.inference
        J, p_value = inference.over_identification
        return OverIdentification(J, max(inference.degrees, 0), p_value, None)
    if not evidence.testable:
        return None
    return robust_over_identification(evidence.record.products)


def _endogeneity(evidence: Evidence) -> Endogeneity | None:
    """Least squares against the estimate; None when the estimate is a kind of least squares."""
    if not evidence.testable:
        return None
    return endogeneity(evidence.record.products, evidence.record.weights)


def _whiteness(evidence: Evidence) -> ResidualWhiteness:
    """Autocorrelation of the residual in time; of rows in frequency, of the residual in their band."""
    return residual_whiteness(np.ascontiguousarray(evidence.record.residual[:: evidence.record.thinning]))


def _memory(evidence: Evidence) -> ResidualMemory | None:
    """Long memory of the residual.

    None for a record that is too short, a residual of zero, or rows in frequency, which lack the lowest.
    """
    return None if evidence.in_frequency else residual_memory(evidence.record.residual)


def _information(evidence: Evidence) -> Information:
    """Scaled information matrix: which combination of parameters is determined worst."""
    return information(evidence.record.products, instrumental=evidence.instrumental)


def _bands(evidence: Evidence) -> BandPower:
    """Power of each column against that of the residual, in bands."""
    record = evidence.record
    rate_hz = 1.0 if record.step_s is None else 1.0 / record.step_s
    return band_power(record.columns, record.factors, record.residual, rate_hz)


def _constancy(evidence: Evidence) -> Constancy | None:
    """Whether the parameters changed during the record; None for fewer than 64 samples."""
    sums = evidence.record.score_sums
    if sums.shape[0] % GROUPS:
        return None
    return constancy(sums, np.asarray(evidence.record.sensitivities.sum(axis=0)))


def periodicity(evidence: Evidence, left_over: tuple[Swing, ...] | None = None) -> Periodicity | None:
    """Whether the parameters, or what is left over, vary periodically.

    Parameters
    ----------
    evidence : Evidence
        An estimate with its record.
    left_over : tuple of Swing, optional
        Of residuals in time. Default: of the rows' own, if they are samples; whitened rows have another unit.

    Returns
    -------
    Periodicity or None
        None for several flights, which share no time, for few samples and for a residual of rounding.
    """
    record = evidence.record
    counts = record.products.counts
    if not evidence.in_one_flight or counts.size < LEAST_BLOCKS or evidence.fits_exactly:
        return None
    step, times = record.step_s or 1.0, evidence.times
    made = influences(record.score_sums, np.asarray(record.sensitivities.sum(axis=0)))
    if left_over is None and not evidence.in_frequency:
        residual = blocks_of(record.residual, times, step, counts.size)
        left_over = strongest_swings(residual, (("the response", ""),), 1.0 / record.residual.size)
    blocks = block_sums(made, counts, times, step)
    unit = "rows" if record.step_s is None else "s"
    parameters = strongest_swings(
        blocks, tuple(zip(evidence.estimate.names, evidence.estimate.units, strict=True))
    )
    return Periodicity(parameters, left_over or (), unit, 1.0 / blocks.span) if parameters else None


def _leverage(evidence: Evidence) -> SegmentLeverage | None:
    """What leaving out each of ten segments of equal length does.

    None for too few samples, or for a residual that is nothing but rounding.
    """
    record = evidence.record
    counts = record.products.counts
    if counts.size < 2 * SEGMENTS or evidence.fits_exactly:
        return None
    edges = block_edges(counts.size, SEGMENTS)
    ends = np.concatenate([[0.0], np.cumsum(counts)])[edges]
    return segment_leverage(
        np.add.reduceat(record.score_sums, edges[:-1], axis=0),
        np.add.reduceat(record.sensitivities, edges[:-1], axis=0),
        evidence.subject.std_errors,
        tuple((int(a), int(b)) for a, b in pairwise(ends)),
    )


#: Every diagnostic by its name, in the order of tables and of sentences.
DIAGNOSTICS: dict[str, Callable[[Evidence], Diagnostic | None]] = {
    "first_stage": _strength,
    "over_identification": _over_identification,
    "endogeneity": _endogeneity,
    "whiteness": _whiteness,
    "memory": _memory,
    "information": _information,
    "bands": _bands,
    "constancy": _constancy,
    "periodicity": periodicity,
    "leverage": _leverage,
}
