"""Diagnostics of an estimate."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import scipy

from eivor import checks
from eivor.errors import EivorError, EstimationError
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import Compensated, CrossMoments, Instrumental, block_count
from eivor.estimation.weighting import TwoStage
from eivor.inference.diagnostics import excitation, instruments, residuals
from eivor.inference.diagnostics.record import BEYOND_DOUBT, Diagnostic, EquationProducts, Subject
from eivor.inference.estimating_equation import Products, block_edges, products_of_rows
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import MULTIPLIED_ROWS, row_blocks
from eivor.linalg.total_least_squares import LeastSquares
from eivor.models.regression import LinearProblem, Regression
from eivor.models.signal_regression import SignalRegression
from eivor.models.spectral import BinRows
from eivor.tools import Float

if TYPE_CHECKING:
    import polars as pl


#: Shared noise below this share of a product is its rounding.
SHARED_ROUNDING = 1e-9


@dataclass(frozen=True)
class Record:
    """A record as its diagnostics see it."""

    products: EquationProducts  # With the method's test functions psi as instruments
    weights: Float[np.ndarray, "p n"]  # W A, the combinations of the equations that the estimate solves
    residual: Float[np.ndarray, " samples"]  # e in time order
    columns: tuple[Float[np.ndarray, " samples"], ...]  # Regressors in time order
    factors: tuple[float, ...]  # Parameters, times those gains
    step_s: float | None  # Time between samples [s]
    thinning: int | None = None

    @cached_property
    def score_sums(self) -> Float[np.ndarray, "K n"]:
        """Sums of the estimating equation's scores over each block."""
        return self.products.equation_sums @ self.weights

    @cached_property
    def influences(self) -> Float[np.ndarray, "K n"]:
        """Contribution of each block to each parameter."""
        sensitivity = self.products.count * self.weights.T @ self.products.sensitivity
        return residuals.influences(self.score_sums, sensitivity)


def record_of(estimate: Estimate) -> Record:
    """Products of a solution's record. Linear in the rows."""
    problem, moments = estimate.problem, estimate.moments
    products = moments.products if isinstance(moments, CrossMoments) else None
    if products is not None and products.counts.size > 1 and isinstance(problem, SignalRegression):
        return _block_record(problem, estimate, products)
    return _row_record(estimate)


def _row_record(estimate: Estimate) -> Record:
    problem, theta = estimate.problem, estimate.theta
    rows = next(iter(problem.blocks(sys.maxsize))) if isinstance(problem, SignalRegression) else estimate.rows
    residual = rows.response - rows.regressors @ theta
    jacobian = np.column_stack([rows.regressors, *estimate.nuisance_columns.T])
    if estimate.assembler.moment_equations:
        psi = estimate.assembler.test_functions(rows)
    else:
        correction = estimate.solver.score_correction(residual, theta, estimate.system.error_covariance)
        psi = jacobian + np.pad(correction.rows, ((0, 0), (0, jacobian.shape[1] - theta.size)))
    step_s, thinning, size, blocks = None, None, residual.size, (psi, jacobian, residual[:, None])
    parts, p, width = iter([(None, *blocks)]), psi.shape[1], psi.shape[1] + jacobian.shape[1] + 1
    if isinstance(problem, SignalRegression):
        step_s = problem.signals.step_s
    elif isinstance(rows, Regression) and isinstance(rows.layout, BinRows):
        runs = rows.layout.runs
        parts = rows.layout.series(*(block / np.sqrt(2.0) for block in blocks))
        step_s, size = runs[0].step_s, sum(run.length for run in runs)
        thinning = max(int(0.5 / (step_s * max(run.band_hz[1] for run in runs))), 1)
    edges, start = block_edges(size, block_count(size, p)), 0
    sums, series = np.zeros((edges.size - 1, width, width)), np.empty((theta.size + 1, size))
    for _, psi, jacobian, errors in parts:
        stop = start + errors.size
        first, last = np.searchsorted(edges, [start, stop - 1], "right")
        inside = np.clip(edges[first - 1 : last + 1], start, stop) - start
        sums[first - 1 : last] += products_of_rows(psi, jacobian, errors[:, 0], edges=inside).sums
        series[:-1, start:stop], series[-1, start:stop] = jacobian[:, : theta.size].T, errors[:, 0]
        start = stop
        del psi, jacobian, errors  # before the next are made
    products, (*columns, residual) = Products(np.diff(edges).astype(np.float64), sums, p), series
    factors = tuple(theta.tolist())
    return Record(*_assembled(estimate, products), residual, tuple(columns), factors, step_s, thinning)


def _assembled(estimate: Estimate, products: Products) -> tuple[EquationProducts, Float[np.ndarray, "p n"]]:
    """Products with the compensation, or a direct method's correction; and W A."""
    total = np.asarray(products.cross.sum(axis=0))
    if estimate.assembler.moment_equations:
        # the equations are means over rows; of rows in frequency there are not as many as samples
        rows = estimate.count / products.count
        A = total / estimate.count
        linear = estimate.system.matrix.shape[1]
        noise = A[:, :linear] - estimate.system.matrix
        shared = np.zeros(A.shape)
        significant = np.abs(noise) > SHARED_ROUNDING * np.abs(A[:, :linear])
        shared[:, :linear] = rows * np.where(significant, noise, 0.0)
        A[:, :linear] = estimate.system.matrix
        WA = A if estimate.factor is None else scipy.linalg.cho_solve((estimate.factor, True), A)
        constant = rows * estimate.constant
    else:
        known = estimate.prior_rows()
        sensitivity = estimate.equation.sensitivity - estimate.residual_variance() * known.T @ known
        shared = (total - sensitivity) / products.count
        WA, constant = np.eye(total.shape[0]), np.zeros(total.shape[0])
    sums = products.counts, products.sums, products.tested
    return EquationProducts(*sums, shared, constant, estimate.count), WA


def _block_record(problem: SignalRegression, estimate: Estimate, raw: Products) -> Record:
    """Products with the residual y - Phi theta in place of y, from those with y."""
    first, last = problem.first, problem.signals.sample_count
    theta, columns = estimate.theta, problem.regressor_columns
    values = [problem.slice_of(column, first, last) for column in columns]
    factors = [float(parameter) * column.gain for parameter, column in zip(theta, columns, strict=True)]
    response = problem.equation.response
    residual = response.gain * problem.slice_of(response, first, last)
    for factor, series in zip(factors, values, strict=True):
        product = np.empty(min(MULTIPLIED_ROWS, residual.size))
        for start, stop in row_blocks(0, residual.size, MULTIPLIED_ROWS):
            block, part = slice(start, stop), product[: stop - start]
            np.multiply(series[block], factor, out=part)
            residual[block] -= part
    products = raw.with_residual(theta)
    # The power of the residual is no difference of large numbers.
    edges = np.concatenate([[0], np.cumsum(raw.counts).astype(np.int64)])
    products.sums[:, -1, -1] = [residual[a:b] @ residual[a:b] for a, b in pairwise(edges.tolist())]
    step_s = problem.signals.step_s
    return Record(*_assembled(estimate, products), residual, tuple(values), tuple(factors), step_s)


#: Segments that are left out one at a time.
SEGMENTS = 10
#: A residual below this share of the terms of its equation is rounding.
ROUNDING = 1e-13
#: Every diagnostic, in the order of tables and of sentences.
DIAGNOSTICS = (
    *("first_stage", "over_identification", "endogeneity", "whiteness", "memory"),
    *("information", "bands", "constancy", "periodicity", "leverage"),
)


def diagnose(estimate: Estimate) -> Diagnostics:
    """Diagnostics of an estimate.

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
    One pass over the rows gives sums of products over a hundred blocks or so. From these follow strength, J,
    endogeneity, constancy, periodicity and leverage. Whiteness, memory and spectra read the residual.
    """
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    if not estimate.has_rows:
        expected = "an estimate with its rows available, for diagnostics"
        remedy = "Identify a chunk that fits in memory, or the whole problem."
        raise EstimationError(expected, "an estimate from moments, which do not keep the rows", remedy)
    return Diagnostics(estimate)


@dataclass(frozen=True)
class Diagnostics:
    """What an estimate rests on."""

    estimate: Estimate = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter, in the order of every array."""
        return self.estimate.names

    @cached_property
    def record(self) -> Record:
        """Products of the record's columns over blocks of time, and its residual."""
        return record_of(self.estimate)

    @property
    def instrumental(self) -> bool:
        """Whether the method has instruments."""
        return self.estimate.assembler.needs_instruments

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
        theta = np.abs(self.estimate.theta)
        # The products settle it without a pass: no value is above the root of its sum of squares.
        roots = np.sqrt(products.regressor_mean.diagonal()[: theta.size])
        if float(products.power.sum()) > (ROUNDING * products.count * float(theta @ roots)) ** 2:
            return False
        parts = zip(record.factors, record.columns, strict=True)
        size = sum((abs(factor) * excitation.largest(item) for factor, item in parts), start=0.0)
        return excitation.largest(record.residual) <= ROUNDING * size

    @cached_property
    def subject(self) -> Subject:
        """The estimate, as the sentences of its diagnostics name it."""
        errors = np.sqrt(self.estimate.covariance.diagonal())
        return Subject(self.names, errors, self.at_row, self.record.residual.size)

    def at_row(self, row: int) -> str:
        """Position of a row: in seconds and samples of a record, gaps and first lags counted."""
        problem = self.estimate.problem
        if not isinstance(problem, SignalRegression):
            step_s = self.record.step_s
            return f"row {row}" if step_s is None else f"{row * step_s:.4g} s of the time used"
        if problem.used is not None:
            positions = np.append(np.flatnonzero(problem.used), problem.used.size)
            row = int(positions[min(row, positions.size - 1)])
        sample, signals = problem.first + row, problem.signals
        time = signals.start_s + sample * signals.step_s
        return f"{time:.4g} s (sample {signals.offset + sample})"

    @property
    def in_one_flight(self) -> bool:
        """Whether all rows are of one flight, and share its time."""
        if isinstance(self.estimate.problem, SignalRegression):
            return True
        flights = self.estimate.rows.layout.flight_of_row
        return not bool((flights != flights[:1]).any())

    @cached_property
    def times(self) -> Float[np.ndarray, " samples"] | None:
        """Time of each sample of the residual of one flight; None where samples are one step apart."""
        step, problem = self.record.step_s or 1.0, self.estimate.problem
        if isinstance(problem, SignalRegression):
            return None if problem.used is None else step * np.flatnonzero(problem.used)
        layout = self.estimate.rows.layout
        if not isinstance(layout, BinRows):
            return None
        return step * np.concatenate([run.start + np.arange(run.length) for run in layout.runs])

    @cached_property
    def first_stage(self) -> instruments.FirstStageTest | None:
        """Strength of the instruments; None without instruments."""
        if not self.testable:
            return None
        estimate = self.estimate
        by_rows = not isinstance(estimate.moments, CrossMoments) or self.in_frequency
        # else it comes from products, as the estimate's warning
        return instruments.strength(
            self.record.products, conditional=estimate.first_stage if by_rows else None
        )

    @cached_property
    def over_identification(self) -> instruments.OverIdentification | None:
        """Hansen's J; None without instruments."""
        if self.instrumental and self.in_frequency:
            J, p_value = self.estimate.over_identification
            return instruments.OverIdentification(J, max(self.estimate.degrees, 0), p_value)
        return instruments.robust_over_identification(self.record.products) if self.testable else None

    @cached_property
    def endogeneity(self) -> instruments.Endogeneity | None:
        """Least squares against the estimate; None when the estimate is a kind of least squares."""
        return instruments.endogeneity(self.record.products, self.record.weights) if self.testable else None

    @cached_property
    def whiteness(self) -> residuals.ResidualWhiteness:
        """Autocorrelation of the residual in time; of rows in frequency, of the residual in their band."""
        return residuals.residual_whiteness(
            np.ascontiguousarray(self.record.residual[:: self.record.thinning])
        )

    @cached_property
    def memory(self) -> residuals.ResidualMemory | None:
        """Long memory of the residual; None where it cannot be identified."""
        return None if self.in_frequency else residuals.residual_memory(self.record.residual)

    @cached_property
    def information(self) -> excitation.Information:
        """Scaled information matrix: which combination of parameters is determined worst."""
        return excitation.information(self.record.products, instrumental=self.instrumental)

    @cached_property
    def bands(self) -> excitation.BandPower:
        """Power of each column against that of the residual, in bands."""
        record, theta = self.record, self.estimate.theta
        rate_hz = 1.0 if record.step_s is None else 1.0 / record.step_s
        # The products hold the sums of squares: no pass over the columns.
        squares = record.products.count * theta**2 * np.diag(record.products.regressor_mean)[: theta.size]
        return excitation.band_power(
            record.columns, record.factors, record.residual, rate_hz, squares.tolist()
        )

    @cached_property
    def constancy(self) -> residuals.Constancy | None:
        """Whether the parameters changed during the record; None for fewer than 64 samples."""
        divisible = self.record.products.counts.size % residuals.GROUPS == 0
        return residuals.constancy(self.record.influences) if divisible else None

    @cached_property
    def periodicity(self) -> excitation.Periodicity | None:
        """Whether the parameters vary periodically; None for few samples, or several flights."""
        return self.periodicity_with(None)

    def periodicity_with(
        self, left_over: tuple[excitation.Swing, ...] | None
    ) -> excitation.Periodicity | None:
        """Whether the parameters, or the residual by default, vary periodically."""
        record = self.record
        counts = record.products.counts
        if not self.in_one_flight or counts.size < excitation.LEAST_BLOCKS or self.fits_exactly:
            return None
        step, times = record.step_s or 1.0, self.times
        influences = record.influences
        named = tuple(zip(self.names, self.estimate.units, strict=True))
        if left_over is None and not self.in_frequency:
            first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
            residual = np.add.reduceat(record.residual, first) / record.residual.size
            influences, named = np.column_stack([influences, residual]), (*named, ("the response", ""))
        blocks = excitation.block_sums(influences, counts, times, step)
        unit = "rows" if record.step_s is None else "s"
        swings = excitation.strongest_swings(blocks, named)
        parameters, left_over = swings[: len(self.names)], left_over or swings[len(self.names) :]
        return excitation.Periodicity(parameters, left_over, unit, 1.0 / blocks.span) if parameters else None

    @cached_property
    def leverage(self) -> residuals.SegmentLeverage | None:
        """Effect of leaving out each of ten equal segments; None for too few samples."""
        record, products = self.record, self.record.products
        counts = products.counts
        if counts.size < 2 * SEGMENTS or self.fits_exactly:
            return None
        edges = block_edges(counts.size, SEGMENTS)
        ends = np.concatenate([[0.0], np.cumsum(counts)])[edges]
        cross = np.add.reduceat(products.cross, edges[:-1], axis=0)
        return residuals.segment_leverage(
            np.add.reduceat(record.score_sums, edges[:-1], axis=0),
            record.weights.T @ (cross - np.diff(ends)[:, None, None] * products.shared),
            self.subject.std_errors,
            tuple((int(a), int(b)) for a, b in pairwise(ends)),
        )

    def __getitem__(self, name: str) -> Diagnostic | None:
        """Diagnostic of that name; None where it cannot be made."""
        checks.index_of("a diagnostic", name, DIAGNOSTICS)
        diagnostic: Diagnostic | None = getattr(self, name)
        return diagnostic

    def __iter__(self) -> Iterator[Diagnostic]:
        """Return every diagnostic that can be made, in the order of tables."""
        return (item for name in DIAGNOSTICS if (item := getattr(self, name)) is not None)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return tuple(reason for item in self for reason in item.reasons(self.subject))

    def to_frame(self) -> pl.DataFrame:
        """Table of every number: `diagnostic`, `of` (parameter, lag or band), `value`, and `compare`.

        The last is the critical value, p-value, standard error or band that it is to be held against.
        """
        import polars as pl

        rows = [row[:4] for item in self for row in item.rows(self.subject)]
        columns = ("diagnostic", "of", "value", "compare")
        schema = dict.fromkeys(columns[:2], pl.String) | dict.fromkeys(columns[2:], pl.Float64)
        return pl.DataFrame(rows, schema=schema, orient="row")

    def summary(self) -> str:
        """Every diagnostic in a line or two, and what to do about those that matter."""
        lines = [f"diagnostics of {self.estimate.method}"]
        lines.extend(row.line for item in self for row in item.rows(self.subject) if row.line)
        lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in self.reasons)
        return "\n".join(lines)


def periodic(estimate: Estimate) -> tuple[Reason, ...]:
    """Reason against an estimate that parameters vary periodically."""
    try:
        diagnostics = Diagnostics(estimate)
        periodicity = diagnostics.periodicity
        reasons = () if periodicity is None else tuple(periodicity.reasons(diagnostics.subject))
    except (EivorError, np.linalg.LinAlgError):
        return ()  # what has no covariance has no diagnostics
    return tuple(reason for reason in reasons if reason.status is Status.WEAK)


def contradiction(problem: LinearProblem, estimate: Estimate) -> tuple[Reason, ...]:
    """Reason against a direct estimate that the problem's own instruments contradict beyond doubt."""
    direct = estimate
    shrunk = direct.solution.shrinkage is not None and direct.solution.shrinkage.shift.any()
    if direct.problem is not problem or direct.assembler.needs_instruments or shrunk:
        return ()
    shares = problem.instruments_share_noise()
    assembler = Compensated() if shares else Instrumental()
    two_stage = LinearMethod("two_stage", assembler, LeastSquares(), equation_weighting=TwoStage())
    try:
        instrumental = Diagnostics(two_stage.solve(problem, check=True))
    except (EivorError, np.linalg.LinAlgError):
        return ()  # the instruments do not determine the parameters
    if not instrumental.testable or instrumental.fits_exactly:
        return ()
    record = instrumental.record
    test = instruments.endogeneity(record.products, record.weights, direct=_scores(direct, instrumental))
    if test is None or not test.p_value < BEYOND_DOUBT:
        return ()
    separated = np.abs(test.difference) / instrumental.subject.std_errors
    j = int(np.argmax(separated))
    if not separated[j] > instruments.NOTABLE_BIAS:
        return ()
    sentence = (
        f"The instruments contradict it: they give {estimate.names[j]} "
        f"{instrumental.estimate.theta[j]:.4g}, {separated[j]:.1f} standard errors away (p-value "
        f"{test.p_value:.1g}). A regressor is correlated with the error, or a declared noise is wrong."
    )
    method = "generalized_iv" if shares else "extended_iv"
    remedy = f"Use {method}, or leave out instruments that are not exogenous."
    return (Reason(Status.WEAK, sentence, remedy),)


def _scores(direct: Estimate, instrumental: Diagnostics) -> instruments.DirectScores:
    products, theta = instrumental.record.products, direct.theta
    difference = theta - instrumental.estimate.theta
    GG = products.count * products.regressor_mean
    power = float(products.with_residual(difference).power.sum())
    if direct.assembler.moment_equations:
        sensitivity = products.count * direct.system.matrix
        return instruments.DirectScores(difference, np.zeros(theta.size), direct.constant, sensitivity)
    root = np.sqrt(power)
    correction = direct.solver.score_correction(np.array([root]), theta, direct.system.error_covariance)
    pull, zero = correction.rows[0] / root, np.zeros(theta.size)
    return instruments.DirectScores(difference, pull, zero, GG + correction.sensitivity)
