"""Identify: run a method on a problem and gather the estimate."""

from __future__ import annotations

import numpy as np

from eivor.errors import InstrumentError
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.inferred import Solved
from eivor.estimation.method import Method
from eivor.estimation.moments import CrossMoments, Moments
from eivor.estimation.nuisance import (
    COARSE_TOLERANCE_S,
    LAG_TOLERANCE_S,
    lag_column,
    no_lag,
    search_lag,
)
from eivor.estimation.solve import SolvedEquations, check_rank, solve, solve_moments
from eivor.estimation.streaming import ProblemMoments
from eivor.estimation.strength import weak_instruments
from eivor.inference.covariances.estimators import FLIGHT_DEFAULT
from eivor.models.regression import LinearProblem, Regression
from eivor.models.separable import ACTUATOR_LAG, SeparableProblem


def identify(problem: LinearProblem | SeparableProblem | ProblemMoments, method: Method) -> Estimate:
    """Estimate the parameters of `problem` by `method`.

    Parameters
    ----------
    problem : Regression, SignalRegression, SeparableProblem or ProblemMoments
        Rows; signals that rows are cut from; one set of rows for each lag and delay of an actuator; or
        moments, whose estimate has no residuals and no intervals.
    method : Method
        One of `eivor.methods`.

    Returns
    -------
    Estimate
        With the lag among its parameters when it was searched for.

    Raises
    ------
    InstrumentError
        When the method needs instruments that the problem does not have, or they share noise with it.
    MissingNoiseError
        When a compensated method needs a noise that is not declared.
    EstimationError
        When the equations have no unique solution.
    """
    if isinstance(problem, SeparableProblem):
        return _separable_estimate(problem, method)
    if isinstance(problem, ProblemMoments):
        solved_moments = _determined(method, problem.moments, None)
        solution = solved_moments.solution
        reasons = weak_instruments(problem.moments, solved_moments.system, problem.parameters)
        candidate = Candidate(0.0, solution.theta, solution, no_lag(solution), None)
        return Estimate(method.name, problem.parameters, (candidate,), reasons)
    moments = method.assembler.moments(problem, instrument_products=method.assembler.needs_instruments)
    solved = _determined(method, moments, problem)
    reasons = weak_instruments(moments, solved.system, problem.parameters)
    source = Solved(
        problem,
        method,
        solved.system,
        solved.factor,
        solved.solution,
        np.empty((0, 0)),
        moments.rows,
        moments.blocks if isinstance(moments, CrossMoments) else None,
    )
    candidate = Candidate(0.0, solved.solution.theta, solved.solution, no_lag(solved.solution), source)
    return Estimate(method.name, problem.parameters, (candidate,), reasons)


def _determined(method: Method, moments: Moments, problem: LinearProblem | None) -> SolvedEquations:
    """Solution of moments whose instruments determine the parameters."""
    if method.assembler.moment_equations:
        check_rank(method.assembler.system(moments))
    return solve_moments(method, moments, problem)


def _separable_estimate(problem: SeparableProblem, method: Method) -> Estimate:
    candidates = tuple(_candidate(problem, method, delay) for delay in problem.delays_s)
    searched = problem.lag_grid_s.size > 1
    nuisance = (ACTUATOR_LAG,) if searched else ()
    return Estimate(method.name, candidates[0].rows.parameters + nuisance, candidates)


def _candidate(problem: SeparableProblem, method: Method, delay_s: float) -> Candidate:
    """Estimate at one delay: passes of lag search and renewed row weights."""
    weighting = method.weighting
    weights = weighting.start(problem)
    searched = int(problem.lag_grid_s.size > 1)
    for last in range(weighting.passes - 1, -1, -1):
        _check_instruments(
            weights.regression(problem, float(problem.lag_grid_s[0]), delay_s), method, searched
        )
        tolerance_s = COARSE_TOLERANCE_S if last else LAG_TOLERANCE_S
        profile = search_lag(problem, method, weights, delay_s, tolerance_s)
        if last:
            weights = weighting.renewed(weights, problem, profile.solution.theta, profile.lag_s, delay_s)
    values = profile.solution.theta
    if searched:
        rows, slope = lag_column(problem, weights, profile.solution.theta, profile.lag_s, delay_s)
        values, columns = np.append(values, profile.lag_s), slope[:, None]
    else:
        rows = weights.regression(problem, profile.lag_s, delay_s)
        columns = np.empty((rows.response.size, 0))
    solved = solve(method, rows)
    source = Solved(rows, method, solved.system, solved.factor, solved.solution, columns, rows.response.size)
    return Candidate(delay_s, values, profile.solution, profile, source, FLIGHT_DEFAULT)


def _check_instruments(rows: Regression, method: Method, nuisance: int) -> None:
    """Refuse fewer instruments than unknowns, the nuisance that is searched for among them."""
    needed, available = rows.regressors.shape[1] + nuisance, rows.instruments.shape[1]
    if method.assembler.needs_instruments and available < needed:
        raise InstrumentError(
            f"at least {needed} independent instruments for {needed} unknowns and the method {method.name}",
            f"{available}",
            "Name exogenous signals that vary: instruments=..., or --instruments.",
        )
