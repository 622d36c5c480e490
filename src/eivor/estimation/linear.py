"""Methods of estimation; the linear ones assemble equations, weight, solve and check instrument strength."""

from __future__ import annotations

import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from eivor import checks
from eivor.errors import (
    CollinearError,
    ConvergenceError,
    EivorError,
    EstimationError,
    InstrumentError,
    TooFewSamplesError,
    UsageError,
    WeakInstrumentsWarning,
)
from eivor.estimation.estimate import Estimate
from eivor.estimation.moments import Assembler, Compensated, CrossMoments, Moments, ProblemMoments
from eivor.estimation.variable_projection import Minimum, minimised
from eivor.estimation.weighting import EqualRows, EquationWeighting, RowWeighting, Unweighted, WeightedRows
from eivor.inference.covariance import FEW_ROWS_DEFAULT, FLIGHT_DEFAULT, column_scale
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.diagnostics.record import first_stage_of_products
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import LinearSystem, Solution, Solver
from eivor.linalg.total_least_squares import lost_to_rounding, row_lengths
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.regression import LinearProblem, Parameter, Regression
from eivor.models.separable import LinearisableProblem, Nuisance, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.tools import Float

#: Problems that methods estimate from.
Problem = LinearProblem | SeparableProblem | ProblemMoments


class Method(ABC):
    """One way to estimate."""

    name: str
    natural_instruments: str = "references"  # Of a flight when nothing else is requested: or "lags"

    @property
    @abstractmethod
    def needs_instruments(self) -> bool:
        """True when problems must have instruments."""

    @property
    def of_flights(self) -> Method:
        """The method for problems with nuisances, whose instruments flights have; mostly itself."""
        return self

    @property
    def takes_out_own_noise(self) -> bool:
        """True when the noise of the regressors must be known; not so by default."""
        return False

    @property
    def first_past_input(self) -> int:
        """Lag in samples of the first of past inputs that may be an instrument."""
        return 1

    @abstractmethod
    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the parameters of a problem."""


#: Name of the method that follows another one.
OUTPUT_ERROR = "output_error"


@dataclass(frozen=True)
class OutputError(Method):
    """Least multi-step prediction errors of a motion, from the estimate of another method."""

    first: Method

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.first.name}+{OUTPUT_ERROR}"

    @property
    def needs_instruments(self) -> bool:
        return self.first.needs_instruments

    @property
    def of_flights(self) -> Method:
        return self.first.of_flights

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate by the first method, of a flight; plain rows have nothing to predict."""
        if not isinstance(problem, SeparableProblem):
            expected = f"a flight of a motion whose states {OUTPUT_ERROR} predicts"
            remedy = 'Use identify_flight(..., model="rigid-body"), or another method.'
            raise UsageError(expected, type(problem).__name__, remedy)
        return self.first.estimate(problem)


#: Most steps after the search: each shrinks by a factor that the noise determines.
MOST_STEPS = 60
#: A change of a nuisance below this share of its span counts as none.
CONVERGED = 1e-9

#: A method, from a linear problem to its solution.
Solve = Callable[[LinearProblem], Estimate]


def coarse_nuisances(problem: LinearisableProblem, solve: Solve) -> dict[str, float]:
    """Values of the nuisances with the least objective of a method, to coarse tolerances."""
    refused: list[EstimationError] = []

    def solution(values: Values) -> Solution:
        return solve(problem.regression(values)).solution

    def objectives(points: Sequence[Values]) -> Float[np.ndarray, " points"]:
        values = np.full(len(points), np.inf)
        for number, point in enumerate(points):
            try:
                values[number] = solution(point).objective
            except EstimationError as error:  # at some orders columns are those of others
                refused.append(error)
        if not np.isfinite(values).any():
            raise refused[0]
        return values

    return minimised(problem.nuisances, solution, objectives, coarse=True)[0]


def refined_nuisances(problem: LinearisableProblem, solve: Solve, start: Values) -> Estimate:
    """Solution at nuisances that a step of the method does not change."""
    low, high = (np.array([nuisance.grid[end] for nuisance in problem.nuisances]) for end in (0, -1))
    names = [nuisance.name for nuisance in problem.nuisances]
    values = np.array([start[name] for name in names])
    for _ in range(MOST_STEPS):
        nuisances = dict(zip(names, values.tolist(), strict=True))
        theta = solve(problem.regression(nuisances)).theta
        solved = solve(problem.linearised(nuisances, theta))
        change = solved.theta[theta.size :]
        if (np.abs(change) <= CONVERGED * (high - low)).all():
            return replace(solved, nuisances=nuisances, origin=np.append(np.zeros(theta.size), values))
        new_values = np.clip(values + change, low, high)
        if (new_values == values).any():
            stuck = [name for name, same in zip(names, new_values == values, strict=True) if same]
            received = f"one at its end, {', '.join(f'{nuisances[name]:g}' for name in stuck)}, or beyond"
            remedy = "Give a wider range, or leave out a term that the data do not show."
            raise ConvergenceError(f"a least misfit inside the range of {', '.join(stuck)}", received, remedy)
        values = new_values
    expected = f"steps of {', '.join(names)} that end"
    remedy = "Give a narrower range, a longer record, or less noise: the data hardly identify it."
    raise ConvergenceError(expected, f"some that go on after {MOST_STEPS}", remedy)


#: An estimate of which less than this share is left is weak.
MOSTLY_LEFT = 0.99


def shrinkage_bias(solution: Solution, parameters: tuple[Parameter, ...]) -> tuple[Reason, ...]:
    """Reason with the shift by regularisation; none without."""
    shrinkage = solution.shrinkage
    if shrinkage is None:
        return ()
    shifts = zip(parameters, shrinkage.shift, strict=True)
    moves = ", ".join(f"{p.name} by {move:.3g} {p.unit}".rstrip() for p, move in shifts)
    sentence = (
        f"Regularised (tikhonov, parameter {shrinkage.parameter:.3g} by {shrinkage.choice}): "
        f"{shrinkage.kept:.3g} of {shrinkage.shift.size} parameters are left, and it moved {moves}."
    )
    status = Status.IDENTIFIED if shrinkage.kept >= MOSTLY_LEFT * shrinkage.shift.size else Status.WEAK
    return (Reason(status, sentence, "A regularised estimate is biased; intervals count the whole move."),)


def check_freedom(rows: int | float, unknowns: int) -> None:
    """Refuse rows that any parameters fit: their residual of zero would pass for no error at all."""
    if rows <= unknowns:
        expected = f"more rows than the {unknowns} unknowns, since the residual determines their errors"
        raise TooFewSamplesError(expected, f"{rows:g}", "Give a longer record.")


#: Equations of a smaller condition number have full rank, however many they are.
DOUBTFUL_CONDITION = 1e6


def check_rank(system: LinearSystem, parameters: Sequence[Parameter]) -> None:
    """Refuse moment equations that rounding alone keeps from being singular."""
    A = system.matrix
    scaled = A * column_scale(A) / row_lengths(A)[:, None]
    singular, still = np.linalg.svd(scaled, compute_uv=False), not A.any(axis=0).all()
    if still or lost_to_rounding(singular, max(A.shape)):
        alike = _in_smallest(scaled, parameters)
        raise InstrumentError(
            "instruments that move every regressor in a way of its own",
            f"equations of numerical rank below {A.shape[1]}{alike and f', by the columns of {alike}'}",
            "An input that never moves carries no information, and a white one is no instrument for itself "
            "once delayed. Use generalized_iv with lag 0, other instruments, or an input with memory.",
        )


def check_instruments(rows: Regression, nuisances: int, method: str) -> None:
    """Refuse fewer instruments than unknowns, the nuisances that are searched for among them."""
    needed, available = rows.regressors.shape[1] + nuisances, rows.instruments.shape[1]
    if available < needed:
        expected = f"at least {needed} independent instruments for {needed} unknowns and the method {method}"
        remedy = "Name exogenous signals that vary: instruments=..., or --instruments."
        raise InstrumentError(expected, f"{available}", remedy)


#: Columns whose squared correlation is nearer to one than this are the same.
SAME_COLUMN = 1e-9


def first_stage_strengths(moments: CrossMoments) -> Float[np.ndarray, " n"]:
    """Conditional first-stage F of each regressor."""
    mean, p = moments.products.mean, moments.products.tested
    shared = None if moments.noise is None else moments.noise[:, :-1]
    return first_stage_of_products(mean[:p, :p], mean[:p, p:-1], mean[p:-1, p:-1], moments.rows, shared)


def weak_instruments(strengths: Float[np.ndarray, " n"], parameters: tuple[Parameter, ...]) -> Reason:
    """Reason for the status weak, reported as a warning too."""
    weakest = int(np.argmin(strengths))
    reason = Reason(
        Status.WEAK,
        f"The instruments hardly move the regressor of {parameters[weakest].name}: first-stage F is "
        f"{strengths[weakest]:.2g}, and {STRONG_FIRST_STAGE:.0f} is needed.",
        "An input that hardly moves carries no information, and a white one is no instrument for itself "
        "once delayed. Use generalized_iv with lag 0, other instruments, or an input with memory. The sets "
        "of eivor.anderson_rubin_set hold all the same.",
    )
    warnings.warn(f"{reason.sentence} {reason.remedy}", WeakInstrumentsWarning, stacklevel=user_level())
    return reason


def overstated_noise(
    moments: CrossMoments, noise: Float[np.ndarray, "p n"], parameters: tuple[Parameter, ...]
) -> tuple[Reason, ...]:
    """Reasons for the status weak where a column has less power than its declared noise."""
    cross, powers, p = moments.equations[:, :-1], moments.products.mean.diagonal(), moments.products.tested
    return tuple(
        Reason(
            Status.WEAK,
            f"The noise that is declared of the regressor of {parameters[column].name} is all there is of"
            f" it, or more: {np.sqrt(noise[row, column] / cross[row, column]):.3g}"
            " times its root mean square.",
            "Declare a smaller noise, or use instruments that share none of it.",
        )
        for row, column in zip(*np.nonzero(noise * cross >= cross * cross), strict=True)
        if cross[row, column] ** 2 >= (1.0 - SAME_COLUMN) * powers[row] * powers[p + column] > 0.0
    )


def user_level() -> int:
    """Level, as `warnings.warn` of the calling function counts, of the line that called Eivor."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "eivor":
        frame, level = frame.f_back, level + 1
    return level


#: Parameters with less than this share in a combination of columns that vanishes are not named.
LEAST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class LinearMethod(Method):
    """A method that is linear in its parameters, but for nuisances."""

    name: str  # The word that results and the command line use
    assembler: Assembler
    solver: Solver
    row_weighting: RowWeighting = field(default_factory=EqualRows)
    equation_weighting: EquationWeighting = field(default_factory=Unweighted)
    natural_instruments: str = "references"

    @property
    def needs_instruments(self) -> bool:
        return self.assembler.needs_instruments

    @property
    def takes_out_own_noise(self) -> bool:
        return self.assembler.takes_out_own_noise

    @property
    def first_past_input(self) -> int:
        return 0 if isinstance(self.assembler, Compensated) else 1

    def estimate(self, problem: Problem) -> Estimate:
        if isinstance(problem, LinearisableProblem):
            return _linearised_estimate(self, problem)
        if isinstance(problem, SeparableProblem):
            return _separable_estimate(self, problem)
        if isinstance(problem, LinearProblem):
            return _plain_estimate(self, self.solve(problem, check=True))
        solved = self.solve_moments(problem.moments, check=True)
        return _plain_estimate(self, replace(solved, joint_parameters=problem.parameters))

    def moments(self, problem: LinearProblem) -> Moments:
        """Summary of rows that the equations, every weighting of them and the instruments' strength need."""
        return self.assembler.moments(problem)

    def solve(self, problem: LinearProblem, *, check: bool = False) -> Estimate:
        return self.solve_moments(self.assembler.moments(problem), problem, check=check)

    def solve_moments(
        self, moments: Moments, problem: LinearProblem | None = None, *, check: bool = False
    ) -> Estimate:
        """Solve for the linear parameters; `check` that moments determine them and leave a residual."""
        if self.row_weighting.needs_spectra and not (
            isinstance(problem, Regression) and isinstance(problem.layout, BinRows)
        ):
            expected = "a flight, whose runs have spectra, for a method with spectral whitening"
            remedy = "Use identify_flight, or another method."
            raise UsageError(expected, "a regression of plain rows", remedy)
        system = self.assembler.system(moments)
        parameters = () if problem is None else problem.parameters
        if check:
            check_freedom(moments.rows, system.matrix.shape[1])
            check = self.assembler.moment_equations
        theta: Float[np.ndarray, " n"] | None = None
        try:
            for _ in range(self.equation_weighting.passes):
                weighted, factor = self.equation_weighting.equations(system, moments, problem, theta)
                solution = self.solver.solve(weighted)
                theta = solution.theta
        except EivorError as error:
            if check:
                check_rank(system, parameters)
            if problem is None or not isinstance(error, CollinearError):
                raise
            raise _collinear(system.matrix, parameters) from None
        if check and (factor is not None or solution.condition > DOUBTFUL_CONDITION):
            check_rank(system, parameters)
        cross = moments if self.assembler.takes_out_own_noise else None
        if isinstance(cross, CrossMoments) and cross.noise is not None:
            # squares of the residual without the noise in it, of regressors that are instruments
            residual = cross.products.with_residual(solution.theta).power.sum()
            added = cross.shared_noise(solution.theta) - cross.noise[:, -1]
            solution = replace(solution, objective=float(residual - cross.rows * added @ solution.theta))
        return Estimate(
            self.assembler, self.solver, moments, problem, system, factor, solution, self.name, parameters
        )


def _linearised_estimate(method: LinearMethod, problem: LinearisableProblem) -> Estimate:
    """Estimate whose nuisances are parameters of the method's own linear equations."""
    first = problem.regression(problem.first_values)
    if not problem.nuisances:
        return method.estimate(first)
    if method.needs_instruments:
        check_instruments(first.rows(), len(problem.nuisances), method.name)
    start = coarse_nuisances(problem, method.solve)
    candidate = refined_nuisances(problem, partial(method.solve, check=True), start)
    return _plain_estimate(method, candidate)


def _plain_estimate(method: LinearMethod, solved: Estimate) -> Estimate:
    moments, parameters = solved.moments, solved.joint_parameters
    met = () if solved.solution.shrinkage is None else shrinkage_bias(solved.solution, parameters)
    if isinstance(moments, CrossMoments):
        strengths = first_stage_strengths(moments)
        if moments.noise is not None:
            met = (*overstated_noise(moments, moments.noise[:, :-1], parameters), *met)
        if not (strengths >= STRONG_FIRST_STAGE).all():
            met = (weak_instruments(strengths, parameters), *met)
    if met:
        solved = replace(solved, met=met)
    finer = None if solved.problem is None else solved.problem.finer
    return solved if finer is None else _discretised(method, solved, finer)


#: An error of discretisation above this share of a parameter makes it weak.
COARSE = 0.03


def _discretised(method: LinearMethod, estimate: Estimate, finer: LinearProblem) -> Estimate:
    """Estimate whose intervals count its discretisation, by two finer problems."""
    try:
        first, second = (method.solve(p).theta - estimate.theta for p in (finer, finer.finer or finer))
    except EstimationError:
        return replace(estimate, met=(*estimate.met, _coarse_sampling("leave no solution")))
    change = np.copysign(np.abs(first) + np.abs(second - first), first)
    errors = np.array([estimate.std_error(name) for name in estimate.names])
    excess = np.abs(change) - np.maximum(COARSE * np.abs(estimate.values), errors)
    worst = int(excess.argmax())
    effect = f"move {estimate.names[worst]} by {abs(change[worst]):.2g}"
    reasons = (_coarse_sampling(effect),) if excess[worst] > 0.0 else ()
    return replace(estimate, discretisation=change, met=(*estimate.met, *reasons))


def _coarse_sampling(effect: str) -> Reason:
    sentence = f"The samples are far apart for derivatives by time: finer ones {effect}."
    return Reason(Status.WEAK, sentence, "Sample faster, or excite more slowly.")


def check_method(method: object, kind: type = LinearMethod) -> None:
    """Refuse what is no linear method, or none of another kind."""
    remedy = "Call the function of eivor.methods that is named so."
    checks.kind("method", method, kind, "a method, such as eivor.methods.least_squares()", remedy)


def _separable_estimate(method: LinearMethod, problem: SeparableProblem) -> Estimate:
    searched, start = [nuisance for nuisance in problem.nuisances if nuisance.searched], problem.warm_start
    if searched and method.equation_weighting.passes > 1:  # each value would have weights of its residual
        remedy = "Use reference_iv, or extended_iv with TwoStage()."
        expected = f"weights that do not change with {', '.join(nuisance.name for nuisance in searched)}"
        raise UsageError(expected, "two-step weights in a search of it", remedy)
    if start is not None:
        weights = method.row_weighting.last_pass(problem, start.theta, start.nuisances)
    else:
        weights = method.row_weighting.first_pass(problem)
    first = None if start is None else start.nuisances
    values, solution, profiles = _minimum(method, problem, weights, first)
    while weights.renewals:
        weights = weights.renewed(solution.theta, values)
        values, solution, profiles = _minimum(method, problem, weights, values)
    solved = method.solve(weights.rows(values))
    misfits, known = known_misfits(problem.nuisances, values)
    criterion = weights.criterion(solved.theta, values)
    return replace(
        solved,
        joint_parameters=(*solved.joint_parameters, *(nuisance.parameter for nuisance in searched)),
        met=shrinkage_bias(solved.solution, solved.joint_parameters),
        nuisance_columns=nuisance_columns(weights, searched, values, solution.theta),
        known=known,
        misfits=misfits,
        nuisances=values,
        profiles=profiles,
        covariance_estimator=FEW_ROWS_DEFAULT if problem.few_rows else FLIGHT_DEFAULT,
        flight_criterion=None if criterion is None else criterion + sum(misfits),
    )


def known_misfits(
    nuisances: Sequence[Nuisance], values: Values
) -> tuple[tuple[float, ...], Float[np.ndarray, "k q"]]:
    """Misfits of the nuisances that have priors; information rows, first theirs and then of parts."""
    searched = [item for item in nuisances if item.searched]
    names = [item.name for item in searched]
    ordered = sorted(searched, key=lambda item: item.prior is None)
    rows = [np.empty((0, len(names))), *(item.information(names, values) for item in ordered)]
    return tuple(item.misfit(values) for item in ordered if item.prior is not None), np.concatenate(rows)


def _minimum(
    method: LinearMethod, problem: SeparableProblem, weights: WeightedRows, start: Values | None
) -> Minimum:
    """Best nuisances with weights of one pass; roughly, where another pass follows."""
    searched = tuple(nuisance for nuisance in problem.nuisances if nuisance.searched)
    rows = weights.rows(problem.first_values)
    check_freedom(rows.response.size, rows.regressors.shape[1] + len(searched))
    if method.needs_instruments:
        known = sum(nuisance.prior is not None or bool(nuisance.part_of) for nuisance in searched)
        check_instruments(rows, len(searched) - known, method.name)

    # what is solved is mean(psi [phi' y]), neither corrected nor weighted
    plain = method.assembler.plain_products and isinstance(method.equation_weighting, Unweighted)

    def solve(values: Values) -> Estimate:
        return method.solve(weights.rows(values))

    def objectives(points: Sequence[Values]) -> Float[np.ndarray, " points"]:
        if plain:
            return method.solver.objectives(weights.products(points))
        return np.array([solve(point).solution.objective for point in points])

    def solution(values: Values) -> Solution:
        if not plain:
            return solve(values).solution
        matrix = weights.products([values])[0]
        try:
            return method.solver.solve(LinearSystem(matrix[:, :-1], matrix[:, -1]))
        except CollinearError:
            return solve(values).solution  # an error that names the parameters

    return minimised(
        problem.nuisances,
        solution,
        objectives,
        lambda values: solve(values).objective_unit(),
        coarse=weights.renewals > 0,
        costly=problem.costly,
        start=start,
    )


def first_steps(
    method: LinearMethod, estimate: Estimate, problem: LaggedRuns
) -> dict[str, tuple[float, float]]:
    """First step and standard error of each further parameter of a wider problem, without a search."""
    searched = [item for item in problem.nuisances if item.searched]
    values = {**{item.name: 0.0 for item in searched}, **estimate.nuisances}
    known = estimate.parameters
    theta = np.array([known.get(item.name, 0.0) for item in problem.parameters])
    weights = method.row_weighting.last_pass(problem, theta, values)
    solved = method.solve(weights.rows(values))
    parameters = (*problem.parameters, *(item.parameter for item in searched))
    wider = replace(
        solved,
        joint_parameters=parameters,
        nuisance_columns=nuisance_columns(weights, searched, values, solved.theta),
        known=known_misfits(problem.nuisances, values)[1],
        covariance_estimator=estimate.covariance_estimator,
    )
    equation, starts = wider.equation, np.pad(solved.theta, (0, len(searched)))
    steps = starts + np.linalg.solve(equation.slope, equation.rows.scores.sum(axis=0))
    pairs = zip(parameters, steps.tolist(), strict=True)
    return {item.name: (step, wider.std_error(item.name)) for item, step in pairs if item.name not in known}


def nuisance_columns(
    weights: WeightedRows, searched: Sequence[Nuisance], values: Values, theta: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "rows q"]:
    """Derivatives of Phi theta by nuisances, each a column; an empty table without any."""
    columns = [item.derivative(lambda v: weights.rows(v).regressors, values) @ theta for item in searched]
    return np.array(columns).T if columns else np.empty((0, 0))


def _in_smallest(matrix: Float[np.ndarray, "m n"], parameters: Sequence[Parameter]) -> str:
    """Names of the parameters in the least determined combination."""
    pairs = zip(parameters, np.abs(np.linalg.svd(matrix)[2][-1]), strict=False)
    return " and ".join(parameter.name for parameter, share in pairs if share > LEAST_SHARE)


def _collinear(matrix: Float[np.ndarray, "m n"], parameters: Sequence[Parameter]) -> CollinearError:
    """The parameters whose columns do not move, or move alike, by their names."""
    names, lengths = [parameter.name for parameter in parameters], np.linalg.norm(matrix, axis=0)
    still = [name for name, length in zip(names, lengths, strict=True) if not length > 0.0]
    if still:
        remedy = "Choose a window in which the channel moves, or leave the parameter out."
        return CollinearError("regressors that vary", f"a column that is zero, of {', '.join(still)}", remedy)
    equal = _in_smallest(matrix / lengths, parameters)
    expected = "linearly independent regressors"
    remedy = "Give data in which they move independently, or leave one of the parameters out."
    return CollinearError(expected, f"those of {equal}, of which one is a combination of the others", remedy)
