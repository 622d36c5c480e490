"""Methods whose solver regularises: what counts as an equation, what intervals count, and what is told."""

from __future__ import annotations

import numpy as np
import pytest
from nuisance_runs import lag, problem, share
from test_moments_and_streams import chunks_of

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.inference.verdict import Status
from eivor.lab.regularised import DECADES, POINTS, RegularisedLeastSquares
from eivor.linalg import LinearSystem

M = ev.methods
GRID = np.append(0.0, np.logspace(*DECADES, (DECADES[1] - DECADES[0]) * POINTS + 1))
MOTION = ev.VerticalMotion(intercept=False)


def signals(seed, rows=400):
    """A record with noise of every channel and an input with memory."""
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(rows + 2), [0.5, 1.0, 0.5], mode="valid")
    v = np.zeros(rows)
    for k in range(1, rows):
        v[k] = 0.9 * v[k - 1] + 0.3 * u[k - 1]
    channels = {"velocity_z": v, "input": u, "specific_force_z": 1.5 * u - 0.8 * v}
    stds = {"velocity_z": 0.1, "input": 0.2, "specific_force_z": 0.3}
    measured = {name: x + stds[name] * rng.standard_normal(rows) for name, x in channels.items()}
    return ev.Signals(5.0, measured, noise={name: ev.WhiteNoise(std) for name, std in stds.items()})


def problem_of(seed, first=0, last=6):
    return MOTION.regression(signals(seed), ev.lags("input", first, last))


def parameter(estimate):
    return estimate.best.solution.shrinkage.parameter


def test_rows_are_the_equations_of_a_direct_method():
    """The root of three rows stands for all: as many as the whole matrix has."""
    rows = problem_of(1).rows()
    whole = RegularisedLeastSquares().solve(LinearSystem(rows.regressors, rows.response))
    result = ev.identify(rows, M.regularised(M.least_squares()))
    assert parameter(result) == whole.shrinkage.parameter
    np.testing.assert_allclose(result.best.theta, whole.theta, rtol=1e-9)
    uncounted = RegularisedLeastSquares().solve(
        LinearSystem(result.best.system.matrix, result.best.system.right)
    )
    assert uncounted.shrinkage.parameter != whole.shrinkage.parameter


@pytest.mark.parametrize("weighting", [M.Unweighted(), M.TwoStage()], ids=["unweighted", "two-stage"])
def test_moments_are_the_equations_of_an_instrumental_method(weighting):
    """Seven instruments give seven equations, whatever number of rows they are means over."""
    method, made = M.generalized_iv(weighting), problem_of(2)
    plain = method.solve(made)
    A, b = plain.system.matrix, plain.system.right
    if plain.factor is not None:
        A, b = np.linalg.solve(plain.factor, A), np.linalg.solve(plain.factor, b)
    unit = A / np.linalg.norm(A, axis=0)
    grid, scores = GRID, []
    for a in grid:
        hat = unit @ np.linalg.solve(unit.T @ unit + a * np.eye(2), unit.T)
        scores.append(np.sum((b - hat @ b) ** 2) / (7.0 - np.trace(hat)) ** 2)
    result = ev.identify(made, M.regularised(method))
    best = scores[int(np.flatnonzero(grid == parameter(result))[0])]
    assert best == pytest.approx(min(scores), rel=1e-9)
    assert parameter(result) > 0.0


def test_moments_without_an_equation_left_over_tell_no_noise():
    square = M.regularised(M.bias_compensated_least_squares())
    with pytest.raises(
        EstimationError, match=r"more equations than the 2 unknowns .*moments count, not rows"
    ):
        ev.identify(problem_of(3), square)
    ev.identify(problem_of(3), M.regularised(M.bias_compensated_least_squares(), parameter=0.1))


@pytest.mark.parametrize(
    "name", ["least_squares", "total_least_squares", "generalized_iv", "generalized_iv_tls"]
)
def test_nothing_is_changed_by_a_parameter_of_zero(name):
    method, made = getattr(M, name)(), problem_of(4)
    plain = ev.identify(made, method)
    result = ev.identify(made, M.regularised(method, parameter=0.0))
    np.testing.assert_allclose(result.best.values, plain.best.values, rtol=1e-9)
    np.testing.assert_allclose(result.covariance, plain.covariance, rtol=1e-7)
    assert result.status is plain.status
    assert result.method == f"{name}_tikhonov"


@pytest.mark.parametrize(
    "name", ["least_squares", "total_least_squares", "generalized_iv", "generalized_iv_tls"]
)
def test_intervals_count_the_whole_move(name):
    """Mean square errors: what the equations leave, and the square of what regularisation did."""
    method, made = getattr(M, name)(), problem_of(5)
    plain = ev.identify(made, method)
    result = ev.identify(made, M.regularised(method, parameter=0.3))
    move = result.best.values - plain.best.values
    np.testing.assert_allclose(result.best.solution.shrinkage.shift, move, rtol=1e-6)
    left = np.diag(result.covariance) - move**2
    assert (left > 0.5 * np.diag(plain.covariance)).all()
    assert result.status is Status.WEAK
    assert "of 2 parameters are left, and it moved viscous_friction by" in result.reasons[-1].sentence
    assert "A pulled estimate is biased" in result.summary()


def test_intervals_cover_although_the_estimate_is_biased():
    """By intervals of the spread alone hardly one in two would."""
    covered, narrow, runs = 0, 0, 120
    for run in range(runs):
        rng = np.random.default_rng([6, run])
        X = rng.standard_normal((60, 2))
        rows = ev.regression(response=X @ [1.0, 2.0] + rng.standard_normal(60), regressors=X)
        covariance = ev.identify(rows, M.regularised(M.least_squares(), parameter=0.1))
        covariance = covariance.with_covariance(ev.covariances.Classical())
        low, high = covariance.interval("theta_2")
        covered += low <= 2.0 <= high
        error = covariance.std_error("theta_2") ** 2 - covariance.best.solution.shrinkage.shift[1] ** 2
        narrow += abs(covariance.parameters["theta_2"] - 2.0) <= 1.96 * np.sqrt(error)
    assert narrow < 0.85 * runs
    assert covered > 0.91 * runs


def test_towards_the_estimate_of_another_method():
    """All the way it is that estimate; the input's gain of a white input is then that of least squares."""
    made, least = problem_of(7), M.least_squares()
    result = ev.identify(made, M.regularised(M.generalized_iv(), parameter=1e9, towards=least))
    wanted = ev.identify(made, least)
    np.testing.assert_allclose(result.best.values, wanted.best.values, rtol=1e-6)
    assert result.status is Status.WEAK
    given = M.regularised(M.generalized_iv(), parameter=0.5, towards=wanted.best.theta)
    named = M.regularised(M.generalized_iv(), parameter=0.5, towards=least)
    np.testing.assert_allclose(
        ev.identify(made, given).best.values, ev.identify(made, named).best.values, rtol=1e-12
    )
    assert named.needs_instruments


def test_chunks_are_the_whole_record():
    record, columns = signals(8), ev.lags("input", 0, 6)
    for method in (M.regularised(M.least_squares()), M.regularised(M.generalized_iv())):
        whole = ev.identify(MOTION.regression(record, columns), method)
        parts = ev.identify_chunks(
            lambda: chunks_of(record, [90, 200]), model=MOTION, method=method, instruments=columns
        )
        np.testing.assert_allclose(parts.best.values, whole.best.values, rtol=1e-9)
        assert parts.interval("input_gain") == pytest.approx(whole.interval("input_gain"), rel=1e-6)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_nuisance_beside_it_is_not_moved():
    made = problem(lag(), share(grid=np.array([0.4])))
    result = ev.identify(made, M.regularised(M.least_squares(), parameter=1e-3))
    assert result.names == ("friction", "gain", "actuator_lag")
    assert "it moved friction by" in result.reasons[-1].sentence
    move = result.best.equation.move
    np.testing.assert_array_equal(move, np.append(result.best.solution.shrinkage.shift, 0.0))


def test_what_cannot_be_regularised_is_refused():
    with pytest.raises(UsageError, match="solved by least squares or total least squares; received fuller"):
        M.regularised(M.fuller(), towards=M.least_squares())
    with pytest.raises(UsageError, match="solved by least squares"):
        M.regularised(M.regularised(M.generalized_iv()))
