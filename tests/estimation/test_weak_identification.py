"""Sets for weak instruments on problems: generalized IV's coverage, outside truth, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

import eivor as ev
import shape_checks

LEVEL = 0.95


def simulated(name, samples, seed):
    scenario = dataclasses.replace(ev.shipped_scenario(name), samples=samples)
    return ev.simulate(scenario, np.random.default_rng(seed)).signals


@pytest.mark.calibration
@pytest.mark.parametrize("name", ["rich", "white"])
def test_generalized_iv_with_lag_zero_covers_at_500_samples(name):
    """Compensated equations, instruments that share noise with the input: at least 95 % but for chance."""
    runs, covered = 250, 0
    method, model = ev.methods.generalized_iv(), ev.VerticalMotion(intercept=False)
    for index in range(runs):
        problem = model.regression(simulated(name, 500, [31, index]), ev.lags("input", 0, 10))
        region = ev.anderson_rubin_set(problem, method).region
        covered += region.contains(np.array([0.293, 0.021]))
    assert covered / runs > LEVEL - 3.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / runs), covered / runs


def test_compensation_is_in_the_statistic():
    """Second route: the scores psi e + C theta - c of each row, and their cosine covariance."""
    problem = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 500, [32]), ev.lags("input", 0, 3)
    )
    result = ev.anderson_rubin_set(problem, ev.methods.generalized_iv(), averages=20)
    theta = np.array([0.25, 0.0211])
    rows, shared = problem.rows(), problem.instrument_noise_covariance()
    scores = rows.instruments * (rows.response - rows.regressors @ theta)[:, None]
    scores += shared[:, :-1] @ theta - shared[:, -1]
    time = (np.arange(len(scores)) + 0.5) / len(scores)
    L = np.sqrt(2.0) * np.cos(np.pi * np.outer(np.arange(1, 21), time)) @ scores
    total = scores.sum(axis=0)
    AR = total @ np.linalg.solve(L.T @ L / 20, total)
    bound = 4 * 20 / 17 * stats.f(4, 17).ppf(LEVEL)
    assert shared.any()
    assert result.region.excess(theta) == pytest.approx(AR / bound, rel=1e-8)


@pytest.mark.thorough
def test_white_input_strictly_delayed_instruments_say_nothing():
    """The intervals of extended IV are short and wrong here; the sets have no bound, as they must."""
    problem = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 500, [33]), ev.lags("input", 1, 5)
    )
    result = ev.anderson_rubin_set(problem, ev.methods.extended_iv())
    assert not result.interval("input_gain").is_bounded
    assert result.interval("input_gain").contains(0.021)
    assert not result.is_empty
    strong = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 500, [33]), ev.lags("input", 0, 5)
    )
    known = ev.anderson_rubin_set(strong, ev.methods.generalized_iv())
    assert all(interval.is_bounded for interval in known.intervals.values())
    text = known.summary()
    assert "viscous_friction" in text
    assert known.assumptions in text


def fit_of(noise, seed=1, count=400, truth=(0.3, 1.2)):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((count, 2))
    y = x @ truth + noise * rng.standard_normal(count)
    problem = ev.regression(response=y, regressors=x, names=["a", "b"])
    return ev.identify(problem, ev.methods.least_squares())


@pytest.mark.calibration
def test_ellipse_covers_jointly():
    """The truth lies in the joint region 95 times in 100, and in the box of the intervals less often."""
    with shape_checks.unchecked():
        rng, inside = np.random.default_rng(6), 0
        for _ in range(600):
            x = rng.standard_normal((300, 2)) @ np.array([[1.0, 0.8], [0.0, 0.6]])
            problem = ev.regression(response=x @ [1.0, -2.0] + rng.standard_normal(300), regressors=x)
            ellipse = ev.identify(problem, ev.methods.least_squares()).ellipse("theta_1", "theta_2")
            away = np.array([1.0, -2.0]) - ellipse.centre
            inside += bool(away @ np.linalg.solve(ellipse.covariance, away) <= ellipse.squared_radius)
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], 600, 0.95)
    assert low <= inside <= high


@pytest.mark.thorough
def test_bends_across_the_slope_are_seen():
    """A valley: along its bottom the function is straight, across it is not."""
    fit = fit_of(0.5)
    parameter = fit.parameters["b"]
    assert ev.derived(fit, lambda p: p["a"] + 500.0 * (p["b"] - parameter) ** 2).profiled
    flat = ev.derived(fit, lambda p: (p["b"] - parameter) ** 2)
    low, high = fit.interval("b")
    assert flat.profiled
    assert flat.interval == pytest.approx((0.0, (0.5 * (high - low)) ** 2), rel=1e-6)
