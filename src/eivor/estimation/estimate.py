"""The estimate: values, covariance and intervals, and functions of its parameters."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import scipy

from eivor import checks
from eivor.errors import EstimationError, UsageError
from eivor.estimation import moments as equations
from eivor.estimation.variable_projection import NuisanceProfile
from eivor.inference import covariance as cov
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import conditional_first_stage, orthonormal_basis
from eivor.inference.distributions import chi_square_tail
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation, singular_sensitivity
from eivor.inference.regions import Ellipse
from eivor.inference.verdict import Reason, Status, verdict
from eivor.linalg import system as linalg
from eivor.linalg.total_least_squares import row_lengths
from eivor.models.regression import LinearProblem, Parameter, Regression, RowBlock, SampleRows
from eivor.models.spectral import BinRows
from eivor.tools import Float, html_table

if TYPE_CHECKING:
    import polars as pl
from eivor.inference.confidence_set import ConfidenceSet, gradient_of, principal_axes, profile_interval
from eivor.inference.regions import fieller_set

Blocks = Callable[[], Iterable[RowBlock]]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Named parameters with units, intervals, and all that inference needs to know of them."""

    assembler: equations.Assembler
    solver: linalg.Solver
    moments: equations.Moments
    problem: LinearProblem | None  # None of an estimate from moments
    system: linalg.LinearSystem  # Equations before their weighting
    factor: Float[np.ndarray, "p p"] | None  # Factor L of the equations' weighting
    solution: linalg.Solution  # Linear parameters, and the condition of their equations
    method: str = ""  # Name of the method
    joint_parameters: tuple[Parameter, ...] = ()  # In the order of the joint vector
    met: tuple[Reason, ...] = ()  # Reasons against the estimate, from its solution
    doubts: Callable[[Estimate], tuple[Reason, ...]] | None = None  # Further reasons, computed on demand
    noises: tuple[
        equations.FittedNoise, ...
    ] = ()  # Fitted together with the parameters, by a spectral method
    nuisance_columns: Float[np.ndarray, "rows q"] = field(default_factory=lambda: np.empty((0, 0)))
    known: Float[np.ndarray, "k q"] = field(default_factory=lambda: np.empty((0, 0)))  # See `prior_rows`
    misfits: tuple[float, ...] = ()
    nuisances: Mapping[str, float] = field(default_factory=dict)  # Value of every nuisance
    profiles: tuple[NuisanceProfile, ...] = ()  # One for each continuous nuisance that was searched for
    covariance_estimator: cov.CovarianceEstimator = cov.DEFAULT
    #: Covariance made elsewhere: by a second pass over chunks, for an estimate from moments; or by a pool.
    streamed_covariance: cov.JointCovariance | None = field(default=None, repr=False)
    #: Criterion of a pool or of a likelihood, in place of its own.
    flight_criterion: float | None = None
    #: Change of the joint vector by a finer discretisation.
    discretisation: Float[np.ndarray, " n"] | None = None
    #: Parameters and nuisances at another order of the response, which fits as well
    other_order: Mapping[str, float] = field(default_factory=dict)
    #: Terms of a wider model that the data do not show, with their first steps and standard errors
    left_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Difference from the values before output error, beyond the errors of both
    unrefined: Float[np.ndarray, " n"] | None = None
    origin: Float[np.ndarray, " n"] | None = None  # Linearisation point that the unknowns are changes from

    def __getstate__(self) -> dict[str, object]:
        """State without the equation and the basis, which are computed again on demand."""
        return {
            name: value
            for name, value in self.__dict__.items()
            if name not in ("equation", "_basis", "reasons")
        }

    @property
    def theta(self) -> Float[np.ndarray, " m"]:
        """Linear parameters."""
        return self.solution.theta

    @cached_property
    def values(self) -> Float[np.ndarray, " n"]:
        """Joint vector: the linear parameters, then the continuous nuisances that were searched for."""
        if self.origin is not None:
            return self.origin + self.theta
        return np.array([*self.theta, *(self.nuisances[item.nuisance.name] for item in self.profiles)])

    @property
    def count(self) -> float:
        """Number of rows."""
        return self.moments.rows

    @property
    def unknowns(self) -> int:
        """Length of the joint vector."""
        return self.theta.size + self.nuisance_columns.shape[1]

    @property
    def constant(self) -> Float[np.ndarray, " p"]:
        """C theta - c, what measurement noises add to each of the method's products on average."""
        if not isinstance(self.moments, equations.CrossMoments):
            return np.zeros(self.theta.size)
        return self.moments.shared_noise(self.theta)

    @property
    def has_rows(self) -> bool:
        """Whether the rows are available; they are not for an estimate from moments."""
        return self.problem is not None

    @property
    def rows(self) -> Regression:
        """Weighted rows at the estimate; an `EstimationError` for an estimate from moments."""
        if self.problem is None:
            expected = "an estimate with its rows available, for residuals and standard errors"
            remedy = "Pass over the chunks again with eivor.identify_chunks, or identify the whole problem."
            raise EstimationError(expected, "an estimate from moments, which do not keep the rows", remedy)
        return self.problem.rows()

    @property
    def residuals(self) -> Float[np.ndarray, " rows"]:
        """Residuals of the weighted rows."""
        rows = self.rows
        return rows.response - rows.regressors @ self.theta

    @property
    def jacobian(self) -> Float[np.ndarray, "rows n"]:
        """Derivatives of the model by the joint vector."""
        return np.column_stack([self.rows.regressors, *self.nuisance_columns.T])

    def residual_variance(self) -> float:
        """s^2 of the weighted rows."""
        residual = self.residuals
        return float(residual @ residual) / max(self.count - self.unknowns, 1)

    def row_power(self) -> float:
        """Variance of a row's score over s^2 and over the sensitivity that the row gives."""
        if not self.assembler.moment_equations:
            return 1.0
        psi = self.assembler.test_functions(self.rows)
        if self.factor is not None:
            psi = scipy.linalg.solve_triangular(self.factor, psi.T, lower=True).T
        return float(np.mean(psi**2))

    def objective_unit(self) -> float:
        """Mean growth of the solver's objective with each equation beyond the unknowns."""
        if self.assembler.needs_instruments:
            return self.residual_variance() * self.row_power() / self.count
        return self.solution.objective / max(self.count - self.unknowns, 1)

    def prior_rows(self) -> Float[np.ndarray, "k n"]:
        """Rows of pseudo-observations by priors, over the square root of their variance."""
        rows = np.zeros((len(self.known), self.unknowns))
        rows[:, self.theta.size : self.theta.size + self.known.shape[1]] = self.known
        return rows

    @cached_property
    def equation(self) -> EstimatingEquation:
        """The estimating equation that the solution meets; an `EstimationError` for one from moments."""
        problem = self.rows if self.problem is None else self.problem
        if not isinstance(problem, Regression) or (
            isinstance(problem.layout, SampleRows) and not self.nuisance_columns.size
        ):
            return estimating_equation(self, problem.blocks)
        # Rows in frequency, and of several axes, go back to time all at once.
        equation = estimating_equation(self, lambda: problem.blocks(round(self.count)))
        rows = equation.rows
        timed = replace(rows, scores=problem.layout.scores(rows.test_functions, rows.residual))
        return replace(equation, sample_count=timed.scores.shape[0], blocks=lambda: [timed])

    @property
    def criterion(self) -> float:
        """Criterion of comparison, in units of a chi-square of one degree of freedom."""
        if self.flight_criterion is not None:
            return self.flight_criterion
        if self.assembler.needs_instruments:
            return self.over_identification[0]
        smallest = np.finfo(np.float64).tiny
        return self.count * float(np.log(max(self.solution.objective, smallest))) + sum(self.misfits)

    @cached_property
    def over_identification(self) -> tuple[float, float]:
        """J and its p-value; (0, 1) without instruments, NaN for compensated equations."""
        if not self.assembler.needs_instruments:
            return 0.0, 1.0
        if self.constant.any():
            return float("nan"), float("nan")
        moments, variance = self._basis.T @ self.equation.residual, self.equation.variance
        J = float(moments @ moments) / variance * self.rows.layout.independent if variance > 0.0 else 0.0
        J += sum(self.misfits)
        return J, chi_square_tail(J, self.degrees) if self.degrees > 0 else 1.0

    @cached_property
    def first_stage(self) -> Float[np.ndarray, " n"]:
        """Conditional first-stage F of each joint parameter; NaN without instruments."""
        if not self.assembler.needs_instruments:
            return np.full(self.unknowns, np.nan)
        known = np.sqrt(self.equation.variance) * self.prior_rows()
        basis = scipy.linalg.block_diag(self._basis, np.eye(len(known))) if known.size else self._basis
        # a part and its total have the strength of their sum, at fixed shares
        names, to_sums = self.names, np.eye(self.unknowns)
        parts = [(profile.nuisance.name, profile.nuisance.part_of) for profile in self.profiles]
        indices = [(names.index(name), names.index(total)) for name, total in parts if total in names]
        for part, total in indices:
            share = self.values[part] / (self.values[part] + self.values[total])
            to_sums[[total, total, part], [total, part, total]] = 1.0 - share, -1.0, share
        jacobian, spectra = np.vstack([self.jacobian, known]) @ to_sums, isinstance(self.rows.layout, BinRows)
        strengths = conditional_first_stage(basis, jacobian, len(known), effective=spectra)
        for part, total in indices:
            strengths[part] = strengths[total]
        return strengths * self.rows.layout.independent

    @property
    def degrees(self) -> float:
        """Equations that are left over: instruments and known nuisances, less the unknowns they determine."""
        return self.rank + len(self.misfits) - self.unknowns + self.undetermined

    @cached_property
    def undetermined(self) -> float:
        """Unknowns, in part, that equations leave to their uniform distribution: how a sum is split.

        At an end of its values, equations do not move it: all of it counts.
        """
        uniform = len(self.known) - len(self.misfits)
        if not uniform or not self.assembler.needs_instruments:
            return 0.0
        if any(item.nuisance.at_end(self.nuisances[item.nuisance.name]) for item in self.profiles):
            return float(uniform)
        known = np.sqrt(self.equation.variance) * self.prior_rows()
        directions = np.linalg.qr(np.vstack([self._basis.T @ self.jacobian, known]))[0]
        return float((directions[-uniform:] ** 2).sum())

    @property
    def rank(self) -> int:
        """Number of independent instruments; 0 without."""
        return self._basis.shape[1] if self.assembler.needs_instruments else 0

    @property
    def instrument_power(self) -> Float[np.ndarray, " rows"]:
        """Length of each row of the orthonormal instruments."""
        return np.asarray(np.linalg.norm(self._basis, axis=1))

    @cached_property
    def _basis(self) -> Float[np.ndarray, "rows q"]:
        return orthonormal_basis(self.rows.instruments)

    @property
    def has_covariance(self) -> bool:
        """Whether intervals can be had: the rows are available, or chunks were passed over."""
        return self.has_rows or self.streamed_covariance is not None

    @cached_property
    def joint_covariance(self) -> cov.JointCovariance:
        """Covariance of the joint vector; an `EstimationError` for moments without a second pass."""
        if self.streamed_covariance is not None:
            return self.streamed_covariance
        return self.covariance_estimator.joint(self.equation)

    @cached_property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons against the estimate, or of what should be known of it."""
        return self.met if self.doubts is None else (*self.met, *self.doubts(self))

    @property
    def status(self) -> Status:
        """Weak when the instruments are, see `reasons` and `first_stage`.

        With nuisances it is provisional by whitened least squares: its intervals do not hold in closed loop.
        """
        reasons = list(self.reasons)
        if self.profiles and np.any(self.first_stage < STRONG_FIRST_STAGE):
            reasons.append(Reason(Status.WEAK, "The instruments are weak: see `first_stage`."))
        if self.profiles and self.method == "whitened_least_squares":
            reasons.append(Reason(Status.PROVISIONAL, "A direct method is biased in closed loop."))
        return verdict(reasons).status

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter."""
        return tuple([p.name for p in self.joint_parameters])

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint parameter."""
        return tuple(p.unit for p in self.joint_parameters)

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each joint parameter."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance, in the order of `names`: see `JointCovariance.matrix`."""
        return self.joint_covariance.matrix

    @property
    def condition(self) -> float:
        """Condition number of the equations, columns scaled to unit length."""
        return self.solution.condition

    def direction(self, name: str) -> Float[np.ndarray, " n"]:
        """Unit vector of a parameter; a `UsageError`, here and below, when there is none of that name."""
        return np.eye(len(self.names))[checks.index_of("a parameter", name, self.names)]

    def with_covariance(self, estimator: cov.CovarianceEstimator) -> Estimate:
        """Same estimates, with intervals from another covariance; an `EstimationError` without the rows."""
        cov.check_covariance_estimator(estimator)
        if not self.has_rows:
            expected = "an estimate with its rows available, for another covariance"
            remedy = "Name the covariance when you identify: identify_chunks(..., covariance=...)."
            raise EstimationError(expected, "one from chunks or moments, which keeps no rows", remedy)
        return replace(self, covariance_estimator=estimator)

    def ellipse(self, name: str, other: str, level: float = 0.95) -> Ellipse:
        """Joint confidence region of two parameters; of several covariances, that whose region is largest."""
        checks.level(level)
        checks.text("name", name)
        checks.text("other", other)
        if name == other:
            raise UsageError("two parameters", f"'{name}' twice", "Name another one.")
        directions = np.stack([self.direction(name), self.direction(other)])
        ellipses = []
        for part in self.joint_covariance.parts:
            C = directions @ (part.matrix / part.share) @ directions.T
            ellipses.append(Ellipse(directions @ self.values, 0.5 * (C + C.T), level, part.degrees))
        return max(ellipses, key=lambda ellipse: ellipse.area)

    def std_error(self, name: str) -> float:
        """Largest of the standard errors."""
        return self.joint_covariance.std_error(self.direction(name))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter."""
        checks.level(level)
        direction = self.direction(name)
        value, half = float(direction @ self.values), self.joint_covariance.half_width(direction, level)
        return value - half, value + half

    def p_value(self, name: str) -> float:
        """Of the hypothesis that a parameter is zero, two-sided: its interval of level 1 - p ends at zero."""
        direction = self.direction(name)
        return self.joint_covariance.p_value(direction, float(direction @ self.values))

    @property
    def params(self) -> dict[str, float]:
        """`parameters`, by the name that other packages use."""
        return self.parameters

    @property
    def std_errors(self) -> dict[str, float]:
        """`std_error` of each joint parameter."""
        return {name: self.std_error(name) for name in self.names}

    @property
    def pvalues(self) -> dict[str, float]:
        """`p_value` of each joint parameter."""
        return {name: self.p_value(name) for name in self.names}

    def conf_int(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """`interval` of each joint parameter."""
        return {name: self.interval(name, level) for name in self.names}

    def to_frame(self) -> pl.DataFrame:
        """Table of `parameter`, `value`, `unit`; and, with a covariance, `std_error`, `low`, `high`."""
        import polars as pl

        columns: dict[str, list[str] | list[float]] = {
            "parameter": list(self.names),
            "value": list(self.parameters.values()),
            "unit": list(self.units),
        }
        if self.has_covariance:
            intervals = self.conf_int().values()
            columns["std_error"] = list(self.std_errors.values())
            columns["low"] = [low for low, _ in intervals]
            columns["high"] = [high for _, high in intervals]
        return pl.DataFrame(columns)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.5g}" for name, value in self.parameters.items())
        return f"<Estimate by {self.method}: {values}; {self.status.value}>"

    def to_html(self) -> str:
        """Table of `to_frame` as an element of HTML, texts escaped; notebooks show it."""
        frame = self.to_frame()
        rows = [[f"{x:.5g}" if isinstance(x, float) else str(x) for x in row] for row in frame.rows()]
        note = " ".join(f"{reason.sentence} {reason.remedy}" for reason in self.reasons)
        return html_table(f"{self.method}: {self.status.value}", frame.columns, rows, note)

    _repr_html_ = to_html

    def to_json(self) -> str:
        """Text of a JSON document: the table of `to_frame`, row by row, and the covariance."""
        rows = json.loads(self.to_frame().write_json())  # what is not finite is null
        covariance = self.covariance.tolist() if self.has_covariance else None
        document = {"method": self.method, "parameters": rows, "covariance": covariance}
        return json.dumps(document, indent=2, allow_nan=False) + "\n"

    def summary(self) -> str:
        """Table of parameters as text: standard errors, rows, covariance, J and the least first-stage F."""
        if not self.has_covariance:
            values = (f"{name:<20}{value:>12.5g}" for name, value in self.parameters.items())
            return "\n".join([f"{self.method} (from moments: no standard errors)", *values])
        head = f"{'parameter':<20}{'value':>12}{'std. error':>12}{'95 % interval':>30}  unit"
        lines = [self.method, head]
        for (name, value), unit in zip(self.parameters.items(), self.units, strict=True):
            low, high = self.interval(name)
            interval = f"[{low:.5g}, {high:.5g}]"
            lines.append(f"{name:<20}{value:>12.5g}{self.std_error(name):>12.3g}{interval:>30}  {unit}")
        covariances = ", ".join(part.name.replace("_", " ") for part in self.joint_covariance.parts)
        lines.append(f"{self.count:.0f} rows; covariance: {covariances}")
        if self.has_rows and self.assembler.needs_instruments:
            (J, p_value), strengths = self.over_identification, self.first_stage
            weakest = int(np.argmin(strengths))
            known = self.degrees > 0 and math.isfinite(J)
            over = f"Sargan's J {J:.3g} (p {p_value:.2g}, errors white)" if known else "no Sargan's J"
            lines.append(f"{over}; first-stage F {strengths[weakest]:.3g} for {self.names[weakest]}")
        lines.extend(f"noise of {noise.sentence}" for noise in self.noises)
        lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in self.reasons)
        return "\n".join(lines)


def estimating_equation(estimate: Estimate, blocks: Blocks) -> EstimatingEquation:
    """Estimating equation of a solution, in coordinates in which its sensitivity is triangular."""
    columns, shrinkage = estimate.nuisance_columns, estimate.solution.shrinkage

    def augmented() -> Iterator[RowBlock]:
        """Blocks with the columns of nuisances beside the regressors: all rows are one block then."""
        for block in blocks():
            yield replace(block, regressors=np.column_stack([block.regressors, columns]))

    make = _moment_equation if estimate.assembler.moment_equations else _direct_equation
    equation = make(estimate, augmented if columns.size else blocks)
    move = estimate.discretisation
    if shrinkage is not None:
        move = np.pad(shrinkage.shift, (0, columns.shape[1])) + (0.0 if move is None else move)
    return equation if move is None else replace(equation, move=move)


def _moment_equation(estimate: Estimate, blocks: Blocks) -> EstimatingEquation:
    assembler, count, factor, A = estimate.assembler, estimate.count, estimate.factor, estimate.system.matrix
    known, theta, constant, unit = estimate.known, estimate.theta, estimate.constant, 0.0
    searched = estimate.nuisance_columns.size > 0
    if searched:
        linear_A, first_block = A, next(iter(blocks()))
        A = assembler.test_functions(first_block).T @ first_block.regressors / count
        A[: linear_A.shape[0], : linear_A.shape[1]] = linear_A
        theta = np.pad(theta, (0, A.shape[1] - linear_A.shape[1]))
        constant = np.pad(constant, (0, A.shape[0] - linear_A.shape[0]))
    if factor is not None:
        A = scipy.linalg.solve_triangular(factor, A, lower=True)
    stacked = A
    if known.size:
        known, unit = estimate.prior_rows(), estimate.row_power() * estimate.residual_variance()
        stacked = np.vstack([A, np.sqrt(unit / count) * known])
    lengths = row_lengths(stacked)[:, None]  # as many equations as unknowns: coordinates without their units
    combinations, R = linalg.orthogonal_factors(stacked / lengths)
    root = (combinations * lengths).T @ stacked
    combinations, pseudo = (combinations / lengths)[: len(A)], (combinations / lengths)[len(A) :]
    if factor is not None:
        combinations = scipy.linalg.solve_triangular(factor, combinations, lower=True, trans="T")
    combined = constant @ combinations

    def equation_rows(block: RowBlock) -> EquationRows:
        residual = block.response - block.regressors @ theta
        scores = block.instruments * residual[:, None]
        scores += combined
        return EquationRows(block.instruments, residual, scores, block.flights, combined)

    def rows() -> Iterator[EquationRows]:
        """Rows with combinations of test functions as instruments, whose columns stay contiguous."""
        problem = estimate.problem
        if not searched and assembler.needs_instruments and equations.lags_without_gaps(problem):
            ends = linalg.row_blocks(problem.first, problem.signals.sample_count, linalg.COPIED_ROWS)
            make = partial(equations.filtered_instruments, problem, combinations)
            return linalg.map_ahead(lambda stretch: equation_rows(make(*stretch)), ends)
        psi = assembler.test_functions
        tested = (replace(block, instruments=(combinations.T @ psi(block).T).T) for block in blocks())
        return linalg.map_ahead(equation_rows, tested)

    prior = np.sqrt(unit * count) * pseudo
    return EstimatingEquation(root, count * R, round(count), rows, prior.T @ prior)


def _direct_equation(estimate: Estimate, blocks: Blocks) -> EstimatingEquation:
    system, theta, searched = estimate.system, estimate.theta, estimate.nuisance_columns.shape[1]
    known, root = estimate.prior_rows(), linalg.triangular_root(system.matrix)
    unit = estimate.residual_variance() if known.size else 0.0
    if searched:
        root = linalg.triangular_root(np.vstack([next(iter(blocks())).regressors, np.sqrt(unit) * known]))
    if root.shape[0] < root.shape[1]:
        raise singular_sensitivity()

    def corrected(residual: Float[np.ndarray, " rows"]) -> linalg.ScoreCorrection:
        return estimate.solver.score_correction(residual, theta, system.error_covariance)

    correction = np.pad(corrected(system.right - system.matrix @ theta).sensitivity, (0, searched))
    slope = root + over_root(correction, root).T if correction.any() else root

    def rows() -> Iterator[EquationRows]:
        for block in blocks():
            residual = block.response - block.regressors @ np.pad(theta, (0, searched))
            correction_rows = np.pad(corrected(residual).rows, ((0, 0), (0, searched)))
            psi = over_root(block.regressors + correction_rows, root)
            yield EquationRows(psi, residual, psi * residual[:, None], block.flights)

    prior = unit * over_root(known, root) if known.size else known
    return EstimatingEquation(root, slope, round(estimate.count), rows, prior.T @ prior)


def equation_map(solved: Estimate) -> Float[np.ndarray, "n p"]:
    """Derivative of the solution by the mean scores, to first order: (A'WA)^-1 A'W."""
    A, factor = solved.system.matrix, solved.factor
    if factor is not None:
        A = scipy.linalg.solve_triangular(factor, A, lower=True)
    Q, R = np.linalg.qr(A)
    if factor is not None:
        Q = scipy.linalg.solve_triangular(factor, Q, lower=True, trans="T")
    return scipy.linalg.solve_triangular(R, Q.T)


def over_root(rows: Float[np.ndarray, "k n"], root: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "k n"]:
    """Rows in the coordinates of a triangular root: rows R^-1."""
    if not np.diag(root).all():
        raise singular_sensitivity()
    return scipy.linalg.solve_triangular(root, rows.T, trans="T").T


#: Share of the half-width by which a function may bend before it is profiled.
LARGEST_BEND = 0.05

Function = Callable[[Mapping[str, float]], float]
OfVector = Callable[[cov.Vector], float]


@dataclass(frozen=True, slots=True)
class DerivedQuantity:
    """A function of the parameters."""

    value: float  # At the estimate
    std_error: float
    interval: tuple[float, float]  # Lowest and highest value
    bend: float
    profiled: bool


def derived(estimate: Estimate, function: Function, level: float = 0.95) -> DerivedQuantity:
    """A smooth function of the parameters, with its interval.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    function : callable
        From the mapping of names to values, such as ``lambda p: p["gain"] / p["friction"]``.
        For a ratio whose denominator may be near zero use `ratio`.
    level : float
        Confidence level.

    Raises
    ------
    UsageError
        When the level is not between 0 and 1, or the function is not finite within the interval.
    """
    checks.level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    remedy = 'Give lambda p: p["theta_1"] ** 2, for example.'
    checks.function("a function of the parameters", function, remedy)

    def evaluate(values: cov.Vector) -> float:
        result = function(dict(zip(estimate.names, (float(value) for value in values), strict=True)))
        checks.number("what the function gives", result)
        return float(result)

    results = derived_from(evaluate, cov.JointEstimate(estimate.values, estimate.joint_covariance), level)
    numbers = (results.value, results.std_error, *results.interval)
    if math.isnan(results.bend) or not np.isfinite(numbers).all():
        expected = "a function that is finite within the interval"
        remedy = "For a ratio whose denominator may be zero use eivor.ratio."
        raise UsageError(expected, f"{results.value} with the interval {results.interval}", remedy)
    return results


def derived_from(
    function: OfVector, joint: cov.JointEstimate, level: float, largest_bend: float = LARGEST_BEND
) -> DerivedQuantity:
    """A smooth function of a vector of estimates; its interval is a union over parts of the covariance."""
    values, covariance = joint.values, joint.covariance
    pieces = [_derived_of_part(function, values, part, level, largest_bend) for part in covariance.parts]
    scale = np.sqrt(np.diag(covariance.matrix))
    return DerivedQuantity(
        value=function(values),
        std_error=covariance.std_error(gradient_of(function, values, scale)),
        interval=(min(piece.interval[0] for piece in pieces), max(piece.interval[1] for piece in pieces)),
        bend=max(piece.bend for piece in pieces),
        profiled=any(piece.profiled for piece in pieces),
    )


def ratio(
    estimate: Estimate, numerator: str | float | int, denominator: str | float | int, level: float = 0.95
) -> ConfidenceSet:
    """Confidence set of a ratio of parameters, or of a number and a parameter, by Fieller's method.

    Parameters
    ----------
    estimate : Estimate
        With its covariance at hand.
    numerator, denominator : str or float
        Name of a parameter, or an exact number: ``ratio(fit, 1.0, "friction")`` is the time
        constant 1/K [s].
    level : float
        Confidence level.

    Returns
    -------
    ConfidenceSet
        Without a bound when the denominator cannot be distinguished from zero. A union over the
        assumptions of the covariance.

    Raises
    ------
    UsageError
        When a name is unknown, or the level is not between 0 and 1.
    """
    checks.level(level)
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    for name, value in (("numerator", numerator), ("denominator", denominator)):
        if not isinstance(value, str):
            checks.number(name, value)
    terms, zero = (numerator, denominator), np.zeros(len(estimate.names))
    exact = np.array([0.0 if isinstance(term, str) else float(term) for term in terms])
    rows = np.stack([estimate.direction(term) if isinstance(term, str) else zero for term in terms])
    intervals: list[tuple[float, float]] = []
    for part in estimate.joint_covariance.parts:
        values, V = exact + rows @ estimate.values, rows @ part.matrix @ rows.T
        intervals.extend(fieller_set(values, V, part.half_widths(level)).intervals)
    return ConfidenceSet.union(intervals)


def _derived_of_part(
    function: OfVector, values: cov.Vector, part: cov.CovariancePart, level: float, largest_bend: float
) -> DerivedQuantity:
    t = part.half_widths(level)
    gradient = gradient_of(function, values, np.sqrt(np.diag(part.matrix)))
    error = math.sqrt(part.variance(gradient))
    centre, half = function(values), t * error
    axes = list(principal_axes(part.matrix, t).T)
    if half > 0.0:
        axes.append(t * part.matrix @ gradient / error)
    nonlinearity = max(
        abs(function(values + sign * axis) - centre - sign * float(gradient @ axis))
        for axis in axes
        for sign in (-1.0, 1.0)
    )
    bend = nonlinearity / half if half > 0.0 else (0.0 if nonlinearity == 0.0 else math.inf)
    if bend <= largest_bend:
        return DerivedQuantity(centre, error, (centre - half, centre + half), bend, profiled=False)
    interval = profile_interval(function, values, part.matrix, t)
    return DerivedQuantity(centre, error, interval, bend, profiled=True)
