"""Identify: run a method on a problem and gather the estimate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eivor.errors import InstrumentError
from eivor.estimation.estimate import Candidate, Estimate
from eivor.estimation.method import Method
from eivor.estimation.nuisance import LagProfile, lag_column, search_lag
from eivor.estimation.weighting import Weights, orthonormal_basis
from eivor.inference.covariance import joint_covariance
from eivor.inference.instrument_tests import conditional_first_stage, over_identification
from eivor.linalg.system import Solution
from eivor.models.regression import Regression
from eivor.models.separable import ACTUATOR_LAG, SeparableProblem


def identify(problem: Regression | SeparableProblem, method: Method) -> Estimate:
    """Estimate the parameters of `problem` by `method`.

    Parameters
    ----------
    problem : Regression or SeparableProblem
        Rows, or one set of rows for each lag and delay of an actuator.
    method : Method
        One of `eivor.methods`.

    Returns
    -------
    Estimate
        With the lag among its parameters when it was searched for.

    Raises
    ------
    InstrumentError
        When the method needs instruments that the problem does not have.
    EstimationError
        When the equations have no unique solution.
    """
    if isinstance(problem, Regression):
        return _fixed_estimate(problem, method)
    searched = problem.lag_grid_s.size > 1
    candidates = tuple(_candidate(problem, method, delay, searched=searched) for delay in problem.delays_s)
    nuisance = (ACTUATOR_LAG,) if searched else ()
    return Estimate(method.name, candidates[0].rows.parameters + nuisance, candidates)


def _fixed_estimate(problem: Regression, method: Method) -> Estimate:
    rows = method.weighting.fixed(problem)
    _check_instruments(rows, method)
    solution = method.solver.solve(method.assembler.system(rows))
    profile = LagProfile(np.zeros(1), np.array([solution.objective]), 0.0, solution)
    return Estimate(method.name, rows.parameters, (_inferred(rows, method, profile, rows.regressors, 0.0),))


def _candidate(problem: SeparableProblem, method: Method, delay_s: float, *, searched: bool) -> Candidate:
    """Estimate at one delay: passes of lag search and renewed weights, then inference."""
    weights = method.weighting.start(problem)
    profile = None
    for last in [False] * (method.weighting.passes - 1) + [True]:
        if profile is not None:
            weights = method.weighting.renewed(
                weights, problem, profile.solution.theta, profile.lag_s, delay_s
            )
        _check_instruments(weights.regression(problem, float(problem.lag_grid_s[0]), delay_s), method)
        profile = search_lag(problem, method, weights, delay_s, refine=True if last else searched)
    assert profile is not None  # noqa: S101 - passes >= 1
    return _joint_candidate(problem, method, weights, profile, delay_s, searched=searched)


def _joint_candidate(
    problem: SeparableProblem,
    method: Method,
    weights: Weights,
    profile: LagProfile,
    delay_s: float,
    *,
    searched: bool,
) -> Candidate:
    if not searched:
        rows = weights.regression(problem, profile.lag_s, delay_s)
        return _inferred(rows, method, profile, rows.regressors, delay_s)
    rows, slope = lag_column(problem, weights, profile.solution.theta, profile.lag_s, delay_s)
    return _inferred(rows, method, profile, np.column_stack([rows.regressors, slope]), delay_s)


def _inferred(
    rows: Regression,
    method: Method,
    profile: LagProfile,
    jacobian: Float[np.ndarray, "rows n"],
    delay_s: float,
) -> Candidate:
    """Joint covariance, strength of the instruments and over-identification at a solution."""
    solution: Solution = profile.solution
    residual = rows.response - rows.regressors @ solution.theta
    count, unknowns = jacobian.shape
    linear = rows.regressors.shape[1]
    nuisance = unknowns - linear
    variance = float(residual @ residual) / max(count - unknowns, 1)
    correction = method.solver.score_correction(residual, solution.theta, rows.error_scale)
    test = method.assembler.test_functions(rows, jacobian)
    sensitivity = test.T @ jacobian
    sensitivity[:linear, :linear] += correction.sensitivity
    test = test + np.pad(correction.rows, ((0, 0), (0, nuisance)))
    covariance = joint_covariance(
        sensitivity=sensitivity,
        test=test,
        residual=residual,
        variance=variance,
        scores=rows.layout.scores(test, residual),
        flight_of_row=rows.layout.flight_of_row,
    )
    values = np.append(solution.theta, [profile.lag_s] * nuisance)
    if method.assembler.needs_instruments:
        basis = orthonormal_basis(rows.instruments)
        tested = over_identification(basis, residual, variance, unknowns)
        strength, criterion, rank = conditional_first_stage(basis, jacobian), tested[0], basis.shape[1]
    else:
        tested, strength, rank = (0.0, 1.0), np.full(unknowns, np.nan), 0
        criterion = float(profile.solution.objective / _scale(profile.solution, variance))
    return Candidate(
        delay_s,
        values,
        covariance,
        criterion,
        tested,
        strength,
        variance,
        solution.condition,
        rank,
        rows,
        profile,
    )


def _scale(solution: Solution, variance: float) -> float:
    return variance if variance > 0.0 else max(solution.objective, 1.0)


def _check_instruments(rows: Regression, method: Method) -> None:
    needed, available = rows.regressors.shape[1], rows.instruments.shape[1]
    if method.assembler.needs_instruments and available < needed:
        raise InstrumentError(
            f"at least {needed} independent instruments for the method {method.name}",
            f"{available}",
            "Name exogenous signals that vary: instruments=..., or --instruments.",
        )
