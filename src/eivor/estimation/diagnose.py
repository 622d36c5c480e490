"""Diagnostics of an estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eivor import checks
from eivor.errors import EivorError, EstimationError, UsageError
from eivor.estimation.estimate import Estimate, Record, Solved, record_of
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import Compensated, Instrumental
from eivor.estimation.weighting import TwoStage
from eivor.inference.diagnostics.excitation import (
    LEAST_BLOCKS,
    BandPower,
    Information,
    Periodicity,
    Swing,
    band_power,
    block_sums,
    blocks_of,
    information,
    largest,
    strongest_swings,
)
from eivor.inference.diagnostics.instruments import (
    NOTABLE_BIAS,
    DirectScores,
    Endogeneity,
    FirstStageTest,
    OverIdentification,
    endogeneity,
    robust_over_identification,
    strength,
)
from eivor.inference.diagnostics.record import BEYOND_DOUBT, Diagnostic, Subject
from eivor.inference.diagnostics.residuals import (
    GROUPS,
    Constancy,
    ResidualMemory,
    ResidualWhiteness,
    SegmentLeverage,
    constancy,
    influences,
    residual_memory,
    residual_whiteness,
    segment_leverage,
)
from eivor.inference.products import block_edges
from eivor.inference.verdict import Reason, Status
from eivor.linalg.total_least_squares import LeastSquares
from eivor.models.regression import LinearProblem
from eivor.models.signal_regression import SignalRegression
from eivor.models.spectral import BinRows
from eivor.tools import Float

if TYPE_CHECKING:
    import polars as pl


# -- Evidence --

#: Segments that are left out one at a time.
SEGMENTS = 10
#: A residual below this share of the terms of its equation is rounding.
ROUNDING = 1e-13


@dataclass(frozen=True)
class Evidence:
    """An estimate at its best candidate, and its record."""

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
        size = sum((abs(factor) * largest(item) for factor, item in parts), start=0.0)
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
            positions = np.append(np.flatnonzero(used), used.size)
            beyond = int(positions[min(row, positions.size - 1)])
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


def _strength(evidence: Evidence) -> FirstStageTest | None:
    """Strength of the instruments; None without instruments."""
    if not evidence.testable:
        return None
    made = evidence.solved.products
    of_rows = made is None or not made.layout.whole  # else they come from products, as the estimate's warning
    conditional = evidence.estimate.best.inference.first_stage if of_rows else None
    return strength(evidence.record.products, conditional=conditional)


def _over_identification(evidence: Evidence) -> OverIdentification | None:
    """Hansen's J; None without instruments."""
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
    """Long memory of the residual."""
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
    """Whether the parameters, or what is left over, vary periodically."""
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
    """What leaving out each of ten segments of equal length does."""
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


# -- Diagnose --

D = TypeVar("D", bound=Diagnostic)


def diagnose(estimate: Estimate) -> Diagnostics:
    """Diagnostics of an estimate at its best candidate.

    Parameters
    ----------
    estimate : Estimate
        With its rows available.

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
    endogeneity, constancy, periodicity and leverage follow; whiteness, memory and spectra read the
    residual.
    """
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    if not estimate.best.has_rows:
        raise EstimationError(
            "an estimate with its rows available, for diagnostics",
            "an estimate from moments, which do not keep the rows",
            "Identify a chunk that fits in memory, or the whole problem.",
        )
    return Diagnostics(Evidence(estimate, estimate.best.solved))


@dataclass(frozen=True)
class Diagnostics:
    """What an estimate rests on.

    Parameters
    ----------
    evidence : Evidence
        The estimate and its record; everything is said of its best candidate.
    """

    evidence: Evidence = field(repr=False)
    _made: dict[str, Diagnostic | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def estimate(self) -> Estimate:
        """What it is said of."""
        return self.evidence.estimate

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter, in the order of every array."""
        return self.evidence.estimate.names

    def __getitem__(self, name: str) -> Diagnostic | None:
        """Diagnostic of that name; None where it cannot be made."""
        if name not in DIAGNOSTICS:
            raise UsageError(
                f"a diagnostic out of {', '.join(DIAGNOSTICS)}", f"'{name}'", "Name one of them."
            )
        if name not in self._made:
            self._made[name] = DIAGNOSTICS[name](self.evidence)
        return self._made[name]

    def __iter__(self) -> Iterator[Diagnostic]:
        """Return every diagnostic that can be made, in the order of tables."""
        return (item for item in map(self.__getitem__, DIAGNOSTICS) if item is not None)

    @property
    def first_stage(self) -> FirstStageTest | None:
        """Strength of the instruments; None without instruments."""
        return self._of_kind("first_stage", FirstStageTest)

    @property
    def over_identification(self) -> OverIdentification | None:
        """Hansen's J; None without instruments."""
        return self._of_kind("over_identification", OverIdentification)

    @property
    def endogeneity(self) -> Endogeneity | None:
        """Least squares against the estimate; None when the estimate is a kind of least squares."""
        return self._of_kind("endogeneity", Endogeneity)

    @property
    def whiteness(self) -> ResidualWhiteness:
        """Autocorrelation of the residual."""
        return self._needed("whiteness", ResidualWhiteness)

    @property
    def memory(self) -> ResidualMemory | None:
        """Long memory of the residual; None where it cannot be identified."""
        return self._of_kind("memory", ResidualMemory)

    @property
    def information(self) -> Information:
        """Which combination of parameters is determined worst."""
        return self._needed("information", Information)

    @property
    def bands(self) -> BandPower:
        """Power of each column against that of the residual, in bands."""
        return self._needed("bands", BandPower)

    @property
    def constancy(self) -> Constancy | None:
        """Whether the parameters changed during the record; None for fewer than 64 samples."""
        return self._of_kind("constancy", Constancy)

    @property
    def periodicity(self) -> Periodicity | None:
        """Whether the parameters vary periodically; None for few samples, or several flights."""
        return self._of_kind("periodicity", Periodicity)

    @property
    def leverage(self) -> SegmentLeverage | None:
        """What leaving out each of ten segments does; None for too few samples."""
        return self._of_kind("leverage", SegmentLeverage)

    def _of_kind(self, name: str, kind: type[D]) -> D | None:
        result = self[name]
        return result if isinstance(result, kind) else None

    def _needed(self, name: str, kind: type[D]) -> D:
        result = self[name]
        assert isinstance(result, kind)  # noqa: S101 - its maker makes it of every estimate
        return result

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First sample and end of each segment of `leverage`."""
        return self.leverage.segments if self.leverage is not None else ()

    def when(self, share: float) -> str:
        """Where a share of the rows is: in seconds and samples of a record, else in rows."""
        return self.evidence.subject.when(share)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return tuple(reason for item in self for reason in item.reasons(self.evidence.subject))

    def to_frame(self) -> pl.DataFrame:
        """Table of every number.

        Returns
        -------
        polars.DataFrame
            Columns `diagnostic`, `of` (parameter, lag or band; empty for the whole), `value` and `compare`:
            the critical value, p-value, standard error or band that the value is to be held against.
        """
        import polars as pl

        rows = [astuple(row) for item in self for row in item.rows(self.evidence.subject)]
        columns = ("diagnostic", "of", "value", "compare")
        return pl.DataFrame(
            rows,
            schema=dict.fromkeys(columns[:2], pl.String) | dict.fromkeys(columns[2:], pl.Float64),
            orient="row",
        )

    def summary(self) -> str:
        """Every diagnostic in a line or two, and what to do about those that matter."""
        lines = [f"diagnostics of {self.evidence.estimate.method}"]
        lines.extend(line for item in self for line in item.lines(self.evidence.subject))
        lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in self.reasons)
        return "\n".join(lines)


def contradiction(problem: LinearProblem, estimate: Estimate) -> tuple[Reason, ...]:
    """Reason against a direct estimate that the problem's own instruments contradict beyond doubt."""
    direct = estimate.best.solved
    shrunk = direct.solution.shrinkage is not None and direct.solution.shrinkage.shift.any()
    if direct.problem is not problem or direct.assembler.needs_instruments or shrunk:
        return ()
    shares = problem.instruments_share_noise()
    assembler = Compensated() if shares else Instrumental()
    two_stage = LinearMethod("two_stage", assembler, LeastSquares(), equation_weighting=TwoStage())
    try:
        evidence = Evidence(estimate, two_stage.determined(two_stage.moments(problem), problem))
    except (EivorError, np.linalg.LinAlgError):
        return ()  # the instruments do not determine the parameters
    if not evidence.testable or evidence.fits_exactly:
        return ()
    record = evidence.record
    test = endogeneity(record.products, record.weights, direct=_scores(direct, evidence))
    if test is None or not test.p_value < BEYOND_DOUBT:
        return ()
    separated = np.abs(test.difference) / evidence.subject.std_errors
    j = int(np.argmax(separated))
    if not separated[j] > NOTABLE_BIAS:
        return ()
    sentence = (
        f"The instruments contradict it: they give {estimate.names[j]} "
        f"{evidence.solved.solution.theta[j]:.4g}, "
        f"{separated[j]:.1f} standard errors away (p-value {test.p_value:.1g}). A regressor is "
        f"correlated with "
        "the error, or a declared noise is wrong."
    )
    instrumental = "generalized_iv" if shares else "extended_iv"
    remedy = f"Use {instrumental}, or leave out instruments that are not exogenous."
    return (Reason(Status.WEAK, sentence, remedy),)


def _scores(direct: Solved, evidence: Evidence) -> DirectScores:
    """Scores of a direct estimate, from the products of an instrumental one."""
    products, theta = evidence.record.products, direct.solution.theta
    difference = theta - evidence.solved.solution.theta
    GG = np.asarray(products.regressors.sum(axis=0))
    power = float(products.power.sum() - 2.0 * difference @ products.regressor_residual.sum(axis=0))
    power += float(difference @ GG @ difference)
    if direct.assembler.moment_equations:
        sensitivity = products.count * direct.system.matrix
        return DirectScores(difference, np.zeros(theta.size), direct.constant, sensitivity)
    root = np.sqrt(power)
    correction = direct.solver.score_correction(np.array([root]), theta, direct.system.error_covariance)
    return DirectScores(
        difference, correction.rows[0] / root, np.zeros(theta.size), GG + correction.sensitivity
    )
