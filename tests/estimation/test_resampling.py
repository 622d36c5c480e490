"""Bootstrap of time: against estimates from the rows themselves, its spread, and its coverage."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from nuisance_runs import LAG_S, PARAMETERS, SHARE, columns, lag, share
from scipy.signal import lfilter

import eivor
import eivor as ev
from eivor.errors import UsageError
from eivor.estimation import methods
from eivor.estimation.bootstrap import bootstrap, pool_flights
from eivor.estimation.methods import least_squares, reference_iv
from eivor.estimation.weighting import whitened_by_residuals
from eivor.inference.bootstrap import BlockScheme, IntervalKind, block_plan
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.regression import Regression, SampleRows, regression

ROWS = 1003
METHODS = {
    "least squares": methods.least_squares(),
    "total least squares": methods.total_least_squares(),
    "bias-compensated": methods.bias_compensated_least_squares(),
    "generalized IV": methods.generalized_iv(),
    "generalized IV, two-stage": methods.generalized_iv(methods.TwoStage()),
    "generalized IV, TLS": methods.generalized_iv_tls(),
    "extended IV": methods.extended_iv(),
    "extended IV, two-stage": methods.extended_iv(methods.TwoStage()),
    "extended IV, TLS": methods.extended_iv_tls(),
}


def rows_of(index, *, compensated):
    """Some rows of one noisy data set, of which the first two instruments share noise with a regressor."""
    random = np.random.default_rng(1)
    u = lfilter([1.0], [1.0, -0.7], random.normal(size=ROWS + 6))
    lagged = np.column_stack([u[6 - k : ROWS + 6 - k] for k in range(6)])
    y = lagged[:, :2] @ [1.0, 0.5] + lfilter([1.0], [1.0, -0.5], random.normal(size=ROWS))
    shared = np.zeros((5, 3))
    shared[0, 0] = shared[1, 1] = 0.05
    return regression(
        response=y[index],
        regressors=lagged[index, :2],
        instruments=lagged[index, :5],
        noise_covariance=np.diag([0.05, 0.05, 1.0]),
        instrument_noise_covariance=shared if compensated else None,
    )


@pytest.mark.thorough
@pytest.mark.parametrize("scheme", list(BlockScheme))
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_replicates_are_estimates_from_the_drawn_rows(method, scheme):
    problem = partial(rows_of, compensated=method.name.startswith("generalized"))
    result = bootstrap(problem(np.arange(ROWS)), method, runs=4, block_length=7, scheme=scheme, seed=3)
    plan, random = block_plan(ROWS, 7.0, scheme), np.random.default_rng(3)
    for replicate in result.replicates:
        drawn = plan.rows_of(plan.drawn(random))
        wanted = method.solve(problem(drawn)).solution.theta
        np.testing.assert_allclose(replicate, wanted, rtol=1e-10)


def test_robust_weights_are_those_of_the_sample():
    """A weight made of residuals is kept, and the replicates are close to those that renew it."""
    method = methods.extended_iv(methods.TwoStepRobust())
    result = bootstrap(rows_of(np.arange(ROWS), compensated=False), method, runs=20, block_length=7, seed=3)
    plan, random = block_plan(ROWS, 7.0), np.random.default_rng(3)
    renewed = np.array(
        [
            method.solve(rows_of(plan.rows_of(plan.drawn(random)), compensated=False)).solution.theta
            for _ in range(20)
        ]
    )
    away = (result.replicates - renewed).std(axis=0) / renewed.std(axis=0)
    assert (away < 0.5).all()
    assert result.values == pytest.approx(
        method.solve(rows_of(np.arange(ROWS), compensated=False)).solution.theta
    )


def test_the_seed_decides_and_is_told():
    problem = rows_of(np.arange(ROWS), compensated=True)
    make = partial(eivor.bootstrap, problem, methods.generalized_iv(), runs=30)
    item, same, other = make(seed=5), make(seed=5), make(seed=6)
    np.testing.assert_array_equal(item.replicates, same.replicates)
    assert not np.array_equal(item.replicates, other.replicates)
    assert (item.seed, other.seed) == (5, 6)
    given = make(seed=np.random.default_rng(5))
    np.testing.assert_array_equal(item.replicates, given.replicates)
    assert given.seed is None


def test_intervals_of_every_kind_are_their_formulas():
    result = bootstrap(rows_of(np.arange(ROWS), compensated=True), methods.generalized_iv(), runs=199, seed=2)
    value, column = result.values[0], result.replicates[:, 0]
    low, high = np.quantile(column, [0.05, 0.95], method="weibull")
    kinds = IntervalKind
    assert result.interval("theta_1", 0.9, kinds.PERCENTILE) == pytest.approx((low, high))
    assert result.interval("theta_1", 0.9, kinds.BASIC) == pytest.approx((2 * value - high, 2 * value - low))
    assert result.studentised is not None
    assert result.std_errors is not None
    t_low, t_high = np.quantile(result.studentised[:, 0], [0.05, 0.95], method="weibull")
    error = result.std_errors[0]
    wanted = (value - t_high * error, value - t_low * error)
    assert result.interval("theta_1", 0.9, kinds.STUDENTISED) == pytest.approx(wanted)
    wide = result.interval("theta_1", 0.9)
    assert wide[0] < low
    assert wide[1] > high


def autocorrelated(trial, rows, memory):
    """Regression with slope 1/2 on an AR(1) input, with AR(1) errors."""
    random = np.random.default_rng([trial, 77])
    x, e = (lfilter([1.0], [1.0, -m], random.normal(size=rows + 100))[100:] for m in (0.7, memory))
    return regression(response=0.5 * x + e, regressors=x[:, None])


@pytest.mark.calibration
def test_the_spread_tells_the_truth_about_autocorrelated_errors_and_rows_alone_do_not():
    """Variance of the slope over 150 data sets, against the mean of what the blocks say (no runs needed)."""
    trials, slopes, selected, alone = 150, [], [], []
    for trial in range(trials):
        problem = autocorrelated(trial, 1000, 0.9)
        result = bootstrap(problem, methods.least_squares(), runs=2, seed=trial)
        single = bootstrap(problem, methods.least_squares(), runs=2, block_length=1, seed=trial)
        assert result.std_errors is not None
        assert single.std_errors is not None
        slopes.append(result.values[0])
        selected.append(result.std_errors[0] ** 2)
        alone.append(single.std_errors[0] ** 2)
    ratio = np.mean(selected) / np.var(slopes)
    # a variance from 150 values is known to 12 %; blocks see 80 to 95 % of it
    assert 0.85 * 0.65 < ratio < 1.3
    assert np.mean(alone) / np.var(slopes) < 0.4


def test_what_cannot_be_resampled_is_refused():
    problem = rows_of(np.arange(ROWS), compensated=True)
    method = methods.least_squares()
    with pytest.raises(UsageError, match="two runs"):
        bootstrap(problem, method, runs=1)
    with pytest.raises(UsageError, match="block length from 1"):
        bootstrap(problem, method, block_length=0)
    with pytest.raises(UsageError, match="scheme out of circular"):
        bootstrap(problem, method, scheme="jackknife")
    result = bootstrap(problem, method, runs=5, scheme="stationary")
    with pytest.raises(UsageError, match="standard errors of their own"):
        result.interval("theta_1", kind=IntervalKind.STUDENTISED)
    with pytest.raises(UsageError, match="quantity out of theta_1"):
        result.std_error("theta_9")
    with pytest.raises(UsageError, match="between 0 and 1"):
        result.interval("theta_1", 95.0)
    flights = SampleRows(np.arange(ROWS) // 500)
    pool = Regression(problem.response, problem.regressors, problem.instruments, problem.parameters, flights)
    with pytest.raises(UsageError, match="bootstrap_flights"):
        bootstrap(pool, method)


def test_runs_without_an_estimate_are_counted():
    """One row in fifty moves the second regressor: a third of the replicates never see it."""
    random = np.random.default_rng(4)
    Phi = np.column_stack([random.normal(size=60), np.zeros(60)])
    Phi[30, 1] = 1.0
    y = Phi @ [1.0, 1.0] + 0.1 * random.normal(size=60)
    problem = regression(response=y, regressors=Phi, instruments=Phi)
    result = bootstrap(problem, methods.extended_iv(), runs=300, block_length=1, scheme="stationary", seed=1)
    assert 0.25 < result.failed / 300 < 0.5
    assert result.replicates.shape == (300 - result.failed, 2)


KNOWN_LAG, KNOWN_SHARE = lag(grid=np.array([LAG_S])), share(grid=np.array([SHARE]))


def pool(numbers, *nuisances, noise=0.02):
    """Flights of one vehicle, by the seed of each."""
    made = (replace(columns(seed, noise=noise), flight=k) for k, seed in enumerate(numbers))
    return LaggedRuns(tuple(made), PARAMETERS, nuisances)


def joint(estimate, replicate):
    """The joint vector of a replicate."""
    return np.array(
        [*replicate.theta, *(replicate.nuisances[name] for name in estimate.names[replicate.theta.size :])]
    )


def errors(estimate):
    return np.array([estimate.std_error(name) for name in estimate.names])


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_replicate_written_out():
    """Two-stage equations of the drawn rows, without the pool's own misfit."""
    problem = pool([0, 1, 2, 3], KNOWN_LAG, KNOWN_SHARE)
    estimate = ev.identify(problem, reference_iv())
    result, times = pool_flights(problem, estimate).replicate(np.random.default_rng(7))
    best = estimate
    rows = whitened_by_residuals(problem, best.theta, best.nuisances).rows(best.nuisances)
    misfit = rows.instruments.T @ (rows.response - rows.regressors @ best.theta)
    drawn = np.repeat(np.arange(rows.response.size), times[rows.layout.flight_of_row].astype(int))
    Q, Phi, y = rows.instruments[drawn], rows.regressors[drawn], rows.response[drawn]
    A, b = Q.T @ Phi, Q.T @ y - misfit
    W = np.linalg.inv(Q.T @ Q)
    theta = np.linalg.solve(A.T @ W @ A, A.T @ W @ b)
    np.testing.assert_allclose(result.theta, theta, rtol=1e-9)


@pytest.mark.usefixtures("unchecked_shapes")
def test_the_order_of_axes_and_flights_does_not_matter():
    """Rows of one flight need not follow each other."""
    parts = [replace(columns(10 * k + axis, axis=axis), flight=k) for k in range(3) for axis in range(2)]
    results = []
    for ordered in (parts, sorted(parts, key=lambda part: part.axis)):
        problem = LaggedRuns(tuple(ordered), PARAMETERS, (lag(), KNOWN_SHARE))
        estimate = ev.identify(problem, reference_iv())
        again, random = pool_flights(problem, estimate), np.random.default_rng(4)
        assert again.flights == (0, 1, 2)
        results.append([joint(estimate, again.replicate(random)[0]) / errors(estimate) for _ in range(5)])
    np.testing.assert_allclose(results[0], results[1], atol=0.01)


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_cannot_be_drawn_again_is_refused():
    problem = pool([0, 1], lag(), KNOWN_SHARE)
    with pytest.raises(UsageError, match="one by least_squares"):
        pool_flights(problem, ev.identify(problem, least_squares()))
    alone = pool([0], lag(), KNOWN_SHARE)
    with pytest.raises(UsageError, match="two flights or more with usable runs; received 1"):
        pool_flights(alone, ev.identify(alone, reference_iv()))
