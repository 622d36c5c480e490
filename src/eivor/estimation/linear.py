"""Linear methods: an assembler, a weighting of rows, a weighting of equations, and a solver.

Nuisances that move columns are searched outside, the linear parameters are solved for inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eivor import checks
from eivor.errors import CollinearError, UsageError
from eivor.estimation.assembler import Assembler, Compensated
from eivor.estimation.candidate import Candidate
from eivor.estimation.competing import bounded_sums
from eivor.estimation.estimate import Estimate
from eivor.estimation.linearised import nearly, settled
from eivor.estimation.method import Method, NaturalInstruments, Problem
from eivor.estimation.moments import Moments, ProblemMoments
from eivor.estimation.nested_grids import on_nested_grids
from eivor.estimation.pulled import pulled
from eivor.estimation.refusals import check_freedom, check_instruments, check_rank
from eivor.estimation.search import Minimum, Search
from eivor.estimation.solved import Solved
from eivor.estimation.strength import overstated_noise, weak_instruments
from eivor.estimation.weighting.equations import EquationWeighting, Unweighted, UnweightedEquations
from eivor.estimation.weighting.rows import EqualRows, RowWeighting, WeightedRows
from eivor.inference.covariances.by_row import FEW_ROWS_DEFAULT
from eivor.inference.covariances.estimators import FLIGHT_DEFAULT
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT
from eivor.inference.verdict import Reason
from eivor.linalg.system import Solution, Solver
from eivor.models.equation import Parameter
from eivor.models.linearisable import LinearisableProblem
from eivor.models.regression import LinearProblem, Regression
from eivor.models.separable import Nuisance, SeparableProblem, Values
from eivor.models.spectral import BinRows
from eivor.shapes import Float

#: Parameters with less than this share in a combination of columns that vanishes are not named.
LEAST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class LinearMethod(Method):
    """A method that is linear in its parameters, but for nuisances.

    Parameters
    ----------
    name : str
        The word that results and the command line use.
    assembler : Assembler
        Which equations.
    solver : Solver
        How the equations are solved.
    row_weighting : RowWeighting
        How rows are weighted.
    equation_weighting : EquationWeighting
        How equations are weighted.
    natural_instruments : NaturalInstruments
        What serves as instruments of a flight when nothing else is asked for.
    """

    name: str
    assembler: Assembler
    solver: Solver
    row_weighting: RowWeighting = field(default_factory=EqualRows)
    equation_weighting: EquationWeighting = field(default_factory=Unweighted)
    natural_instruments: NaturalInstruments = NaturalInstruments.REFERENCES

    @property
    def needs_instruments(self) -> bool:
        """As the assembler does."""
        return self.assembler.needs_instruments

    @property
    def takes_out_own_noise(self) -> bool:
        """As the assembler does."""
        return self.assembler.takes_out_own_noise

    @property
    def first_past_input(self) -> int:
        """One where instruments must share no noise, none for compensated ones, the paper's (28)."""
        return 0 if isinstance(self.assembler, Compensated) else 1

    @property
    def plain_products(self) -> bool:
        """Whether what is solved is mean(psi [phi' y]), neither corrected nor weighted."""
        unweighted = (
            self.equation_weighting.passes == 1 and not self.equation_weighting.needs_instrument_products
        )
        return unweighted and self.assembler.plain_products

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate the parameters of rows, of a problem with nuisances, or of moments."""
        if isinstance(problem, LinearisableProblem):
            return _linearised_estimate(self, problem)
        if isinstance(problem, SeparableProblem):
            return _separable_estimate(self, problem)
        if isinstance(problem, ProblemMoments):
            moments, parameters, rows = problem.moments, problem.parameters, None
        else:
            moments, parameters, rows = self.moments(problem), problem.parameters, problem
        solved = self.determined(moments, rows)
        return Estimate(self.name, parameters, (Candidate({}, solved),), _reasons(solved, parameters))

    def moments(self, problem: LinearProblem) -> Moments:
        """Summary of rows that the equations, every weighting of them and the instruments' strength need."""
        return (
            self.assembler.full_moments(problem)
            if self.needs_instruments
            else self.assembler.moments(problem)
        )

    def solve(self, problem: LinearProblem) -> Solved:
        """Solve for the linear parameters of a problem with its rows at hand."""
        full = self.equation_weighting.needs_instrument_products
        moments = self.assembler.full_moments(problem) if full else self.assembler.moments(problem)
        return self.solve_moments(moments, problem)

    def solve_moments(self, moments: Moments, problem: LinearProblem | None = None) -> Solved:
        """Solve for the linear parameters from moments, in as many passes as the equations' weighting asks.

        Raises
        ------
        UsageError
            When the weighting of rows needs spectra and there are none.
        EstimationError
            When the equations have no unique solution.
        """
        if self.row_weighting.needs_spectra and not _has_spectra(problem):
            raise UsageError(
                "a flight, whose runs have spectra, for a method with spectral whitening",
                "a regression of plain rows",
                "Use identify_flight, or another method.",
            )
        system = self.assembler.system(moments)
        theta: Float[np.ndarray, " n"] | None = None
        for _ in range(self.equation_weighting.passes):
            weighted = self.equation_weighting.equations(UnweightedEquations(system, moments, problem, theta))
            try:
                solution = self.solver.solve(weighted.system)
            except CollinearError as error:
                raise (error if problem is None else _collinear(system.matrix, problem.parameters)) from None
            theta = solution.theta
        solution = replace(solution, objective=self.assembler.left(moments, solution))
        return Solved(self.assembler, self.solver, moments, problem, system, weighted.factor, solution)

    def determined(self, moments: Moments, problem: LinearProblem | None = None) -> Solved:
        """Solution of moments that determine the parameters, and leave a residual to judge them by.

        Raises
        ------
        TooFewSamplesError
            When there are no more rows than parameters.
        InstrumentError
            When the instruments do not determine the parameters.
        EstimationError
            When the equations have no unique solution.
        """
        system = self.assembler.system(moments)
        check_freedom(moments.rows, system.matrix.shape[1])
        if self.assembler.moment_equations:
            check_rank(system)
        return self.solve_moments(moments, problem)


def _has_spectra(problem: LinearProblem | None) -> bool:
    return isinstance(problem, Regression) and isinstance(problem.layout, BinRows)


# -- problems whose nuisances have columns of their own ----------------------------------------------------


def _linearised_estimate(method: LinearMethod, problem: LinearisableProblem) -> Estimate:
    """Estimate whose nuisances are parameters of the method's own linear equations."""
    first = problem.regression(problem.first_values)
    if not problem.nuisances:
        return method.estimate(first)
    if method.needs_instruments:
        check_instruments(first.rows(), len(problem.nuisances), method.name)

    def solve(linear: LinearProblem) -> Solved:
        return method.determined(method.moments(linear), linear)

    found = settled(problem, solve, nearly(problem, method.solve))
    solved = found.solved
    parameters = solved.rows.parameters
    candidate = Candidate(found.at, solved, origin=found.origin)
    return Estimate(method.name, parameters, (candidate,), _reasons(solved, parameters))


def _reasons(solved: Solved, parameters: tuple[Parameter, ...]) -> tuple[Reason, ...]:
    """Grounds for the status weak of an estimate of plain rows."""
    return (
        *weak_instruments(solved.moments, solved.system, parameters),
        *overstated_noise(solved.moments, parameters),
        *pulled(solved.solution, parameters),
    )


# -- problems with nuisances ------------------------------------------------------------------------------


def check_linear(method: object) -> None:
    """Refuse what is no linear method.

    Raises
    ------
    UsageError
        With what came instead.
    """
    remedy = "Call the function of eivor.methods that is named so."
    checks.kind("method", method, LinearMethod, "a method, such as eivor.methods.least_squares()", remedy)


def _separable_estimate(method: LinearMethod, problem: SeparableProblem) -> Estimate:
    """Estimate with a candidate for each combination of the discrete nuisances' values."""

    def made(fixed: dict[str, float], beside: Candidate | None) -> Candidate:
        return _candidate(method, problem, fixed, beside)

    candidates = on_nested_grids(problem.nuisances, made, lambda candidate: candidate.criterion, _rejected)
    refined = tuple(nuisance.parameter for nuisance in problem.nuisances if nuisance.refined)
    joint = candidates[0].rows.parameters + refined
    best = (
        min(candidates, key=lambda candidate: candidate.criterion) if len(candidates) > 1 else candidates[0]
    )
    reasons = pulled(best.solution, best.rows.parameters)
    return Estimate(method.name, joint, candidates, reasons, bounded_sums(problem.nuisances))


def _rejected(candidate: Candidate) -> bool:
    """Whether the instruments disagree beyond doubt."""
    return candidate.inference.over_identification[1] < BEYOND_DOUBT


def _candidate(
    method: LinearMethod, problem: SeparableProblem, fixed: dict[str, float], beside: Candidate | None
) -> Candidate:
    """Estimate at some values of the discrete nuisances: passes of search and renewed row weights.

    The first pass is spared where a candidate close by has been estimated, and all but the last where nearly
    the same problem was.
    """
    if problem.begun is not None:
        weights = method.row_weighting.last_pass(problem, problem.begun.theta, problem.begun.at)
    else:
        weights = method.row_weighting.first_pass(problem)
        if beside is not None and weights.renewal is not None:
            weights = weights.renewal(beside.theta, beside.at)
    found = _minimum(method, problem, weights, fixed)
    while weights.renewal is not None:
        weights = weights.renewal(found.solution.theta, found.at)
        found = _minimum(method, problem, weights, fixed)
    solved = method.solve(weights.rows(found.at))
    refined = [nuisance for nuisance in problem.nuisances if nuisance.refined]
    columns = [slope(weights, nuisance, found.at, found.solution.theta) for nuisance in refined]
    precision = [0.0 if nuisance.prior is None else nuisance.prior.std**-2.0 for nuisance in refined]
    known = [nuisance for nuisance in problem.nuisances if nuisance.searched and nuisance.prior is not None]
    solved = replace(
        solved,
        nuisance_columns=np.column_stack([np.empty((solved.rows.response.size, 0)), *columns]),
        precision=np.array(precision),
        misfits=tuple(nuisance.misfit(found.at) for nuisance in known),
    )
    at = {nuisance.name: found.at[nuisance.name] for nuisance in problem.nuisances}
    covariance = FEW_ROWS_DEFAULT if problem.few_rows else FLIGHT_DEFAULT
    own = weights.criterion(solved.solution.theta, found.at)
    criterion = None if own is None else own + sum(solved.misfits)
    return Candidate(at, solved, found.profiles, covariance, own_criterion=criterion)


def _minimum(
    method: LinearMethod, problem: SeparableProblem, weights: WeightedRows, fixed: dict[str, float]
) -> Minimum:
    """Best continuous nuisances with weights of one pass; roughly, where another pass follows."""
    sought = tuple(nuisance for nuisance in problem.nuisances if nuisance.refined)
    rows = weights.rows(problem.first_values | fixed)
    check_freedom(rows.response.size, rows.regressors.shape[1] + len(sought))
    if method.needs_instruments:
        unknown = sum(nuisance.prior is None for nuisance in sought)
        check_instruments(rows, unknown, method.name)

    def solve(at: Values) -> Solution:
        return method.solve(weights.rows(at)).solution

    def unit(at: Values) -> float:
        return method.solve(weights.rows(at)).objective_unit()

    def objectives(points: Sequence[Values]) -> Float[np.ndarray, " points"]:
        if method.plain_products:
            return method.solver.objectives(weights.products(points))
        return np.array([solve(at).objective for at in points])

    return Search(sought, fixed, solve, objectives, unit).minimum(coarse=weights.renewal is not None)


def slope(
    weights: WeightedRows, nuisance: Nuisance, at: Values, theta: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " rows"]:
    """Derivative of Phi theta by a nuisance."""
    return nuisance.derivative(lambda moved: weights.rows(moved).regressors, at) @ theta


def _collinear(matrix: Float[np.ndarray, "m n"], parameters: Sequence[Parameter]) -> CollinearError:
    """The parameters whose columns do not move, or move alike, by their names."""
    names, lengths = [parameter.name for parameter in parameters], np.linalg.norm(matrix, axis=0)
    still = [name for name, length in zip(names, lengths, strict=True) if not length > 0.0]
    if still:
        return CollinearError(
            "regressors that vary",
            f"a column that is zero, of {', '.join(still)}",
            "Choose a window in which the channel moves, or leave the parameter out.",
        )
    shares = np.abs(np.linalg.svd(matrix / lengths)[2][-1])
    alike = [name for name, share in zip(names, shares, strict=True) if share > LEAST_SHARE]
    return CollinearError(
        "linearly independent regressors",
        f"those of {' and '.join(alike)}, of which one is a combination of the others",
        "Give data in which they move independently, or leave one of the parameters out.",
    )
