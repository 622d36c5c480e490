"""Sets for weak instruments on problems: generalized IV's coverage, outside truth, and what is refused."""

from __future__ import annotations

import dataclasses
import importlib.resources

import numpy as np
import polars as pl
import pytest
from scipy import stats

import eivor as ev
from eivor.errors import InstrumentError, ParameterError, TooFewSamplesError, UsageError
from eivor.estimation.weak_identification import (
    AutocorrelatedErrors,
    HomoskedasticErrors,
    anderson_rubin_set,
    moment_rows,
    sign_perturbed_set,
)
from eivor.lab.scenario_files import shipped_scenario

LEVEL = 0.95


def simulated(name: str, samples: int, seed: list[int]) -> ev.Signals:
    scenario = dataclasses.replace(shipped_scenario(name), samples=samples)
    return ev.simulate(scenario, np.random.default_rng(seed)).signals


def exact_input(signals: ev.Signals, truth: ev.Signals) -> ev.Signals:
    """The same record with an input that is known without noise."""
    channels = dict(signals.channels) | {"input": truth.channel("input")}
    return ev.Signals(signals.rate_hz, channels, noise=dict(signals.noise) | {"input": ev.WhiteNoise(0.0)})


@pytest.mark.calibration
@pytest.mark.parametrize("name", ["rich", "white"])
def test_generalized_iv_with_lag_zero_covers_at_500_samples(name):
    """Compensated equations, instruments that share noise with the input: at least 95 % but for chance."""
    runs, covered = 250, 0
    method, model = ev.methods.generalized_iv(), ev.VerticalMotion(intercept=False)
    for index in range(runs):
        problem = model.regression(simulated(name, 500, [31, index]), ev.lags("input", 0, 10))
        region = anderson_rubin_set(problem, method).region
        covered += region.contains(np.array([0.293, 0.021]))
    assert covered / runs > LEVEL - 3.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / runs), covered / runs


def test_compensation_is_in_the_statistic():
    """Second route: the scores psi e + C theta - c of each row, and their cosine covariance."""
    problem = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 500, [32]), ev.lags("input", 0, 3)
    )
    result = anderson_rubin_set(problem, ev.methods.generalized_iv(), errors=AutocorrelatedErrors(20))
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
    result = anderson_rubin_set(problem, ev.methods.extended_iv())
    assert not result.interval("input_gain").is_bounded
    assert result.interval("input_gain").contains(0.021)
    assert not result.is_empty
    strong = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 500, [33]), ev.lags("input", 0, 5)
    )
    known = anderson_rubin_set(strong, ev.methods.generalized_iv())
    assert all(interval.is_bounded for interval in known.intervals.values())
    text = known.summary()
    assert "viscous_friction" in text
    assert known.assumptions in text


@pytest.fixture(scope="module")
def housing() -> ev.Regression:
    """Median rents of the 50 states as shipped by linearmodels: the manual's example of Stata's ivregress."""
    pytest.importorskip("linearmodels")
    path = importlib.resources.files("linearmodels.tests.iv.results").joinpath("housing.csv")
    data = pl.read_csv(str(path))
    region = data["region"].to_numpy()
    dummies = [(region == name).astype(float) for name in sorted(set(region))[1:]]
    exogenous = [data["pcturban"].to_numpy().astype(float), np.ones(len(data))]
    return ev.regression(
        response=data["rent"].to_numpy().astype(float),
        regressors=np.column_stack([data["hsngval"].to_numpy().astype(float), *exogenous]),
        instruments=np.column_stack([data["faminc"].to_numpy().astype(float), *dummies, *exogenous]),
        names=("hsngval", "pcturban", "constant"),
    )


def test_housing_against_stata_and_textbook_regressions(housing):
    """The least AR is LIML's kappa less one (Stata: 1.256906483), and AR is the F of a plain regression."""
    result = anderson_rubin_set(housing, ev.methods.extended_iv(), errors=HomoskedasticErrors())
    assert result.partialled_out == ("pcturban", "constant")
    assert result.region.names == ("hsngval",)
    liml_estimate = np.array([0.00266862318])
    critical = 4 / 44 * stats.f(4, 44).ppf(LEVEL)
    assert result.region.excess(liml_estimate) * critical + 1.0 == pytest.approx(1.256906483, rel=1e-8)
    y, X, Z = housing.response, housing.regressors, housing.instruments
    for value in (0.001, 0.002, 0.004):
        e = y - value * X[:, 0]
        full, short = (float(np.linalg.lstsq(W, e, rcond=None)[1][0]) for W in (Z, X[:, 1:]))
        F = (short - full) / 4 / (full / 44)
        excess = result.region.excess(np.array([value]))
        assert excess * stats.f(4, 44).ppf(LEVEL) == pytest.approx(F, rel=1e-8)
    # At LIML the F is 2.83, above 2.58: at 95 % the instruments are rejected, at 99 % they are not.
    assert result.is_empty
    assert "the data reject the model" in result.summary()
    wide = anderson_rubin_set(housing, ev.methods.extended_iv(), errors=HomoskedasticErrors(), level=0.99)
    assert wide.interval("hsngval").contains(0.00266862318)


def test_partialling_out_equals_concentrating_out(housing):
    """Classical errors: the set of hsngval from all equations, its exogenous companions left open."""
    result = anderson_rubin_set(housing, ev.methods.extended_iv(), errors=HomoskedasticErrors(), level=0.99)
    rows = moment_rows(housing, ev.methods.extended_iv()).independent()
    whole = HomoskedasticErrors().region(rows, 0.99)
    assert whole.interval("hsngval").hull == pytest.approx(result.interval("hsngval").hull, rel=1e-9)
    # For an exogenous parameter the endogenous one is concentrated out, and its own column kept.
    assert whole.interval("pcturban").hull == pytest.approx(result.interval("pcturban").hull, rel=1e-9)


@pytest.mark.long
def test_an_intercept_costs_nothing():
    """With the intercept partialled out the response may be shifted as one likes."""
    signals = simulated("rich", 800, [34])
    shifted = ev.Signals(
        signals.rate_hz,
        dict(signals.channels) | {"acceleration_z": signals.channel("acceleration_z") + 9.8},
        noise=dict(signals.noise),
    )
    sets = [
        anderson_rubin_set(
            ev.VerticalMotion().regression(item, ev.lags("input", 0, 3)), ev.methods.generalized_iv()
        )
        for item in (signals, shifted)
    ]
    assert sets[0].partialled_out == ("intercept",)
    for name in ("viscous_friction", "input_gain"):
        assert sets[0].interval(name).hull == pytest.approx(sets[1].interval(name).hull, rel=1e-6)
    moved = [item.interval("intercept").hull for item in sets]
    assert moved[1] == pytest.approx(tuple(end + 9.8 for end in moved[0]), rel=1e-5)


@pytest.mark.thorough
def test_sign_perturbed_set_of_a_record_with_an_exact_input():
    scenario = dataclasses.replace(shipped_scenario("white"), samples=300)
    record = ev.simulate(scenario, np.random.default_rng(35))
    signals = exact_input(record.signals, record.truth)
    problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 3))
    result, again, other = (
        sign_perturbed_set(problem, ev.methods.extended_iv(), np.random.default_rng(seed))
        for seed in (0, 0, 1)
    )
    assert result.region.contains(np.array([0.293, 0.021]))
    assert result.intervals == again.intervals
    assert result.intervals != other.intervals
    assert not result.is_empty
    assert result.interval("input_gain").contains(0.021)
    assert "symmetric" in result.summary()


def test_sign_perturbation_refuses_what_would_break_its_exactness():
    problem = ev.VerticalMotion(intercept=False).regression(
        simulated("white", 300, [36]), ev.lags("input", 0, 3)
    )
    rng = np.random.default_rng(0)
    with pytest.raises(InstrumentError, match="independent of the errors, without compensation"):
        sign_perturbed_set(problem, ev.methods.generalized_iv(), rng)
    delayed = ev.VerticalMotion(intercept=False).regression(problem.signals, ev.lags("input", 1, 3))
    with pytest.raises(InstrumentError, match="noise is in the errors of other rows"):
        sign_perturbed_set(delayed, ev.methods.extended_iv(), rng)
    given = ev.regression(
        response=np.arange(30.0),
        regressors=np.ones((30, 1)),
        instruments=np.ones((30, 1)),
        instrument_noise_covariance=[[0.1, 0.0]],
    )
    with pytest.raises(InstrumentError, match="no regressor and no response shares"):
        sign_perturbed_set(given, ev.methods.extended_iv(), rng)
    plain = dataclasses.replace(given, instrument_noise=None)
    with pytest.raises(ParameterError, match="whole number"):
        sign_perturbed_set(plain, ev.methods.extended_iv(), rng, level=0.975)


def test_problems_that_no_set_can_be_made_of():
    signals = simulated("white", 300, [37])
    model = ev.VerticalMotion(intercept=False)
    problem = model.regression(signals, ev.lags("input", 0, 3))
    with pytest.raises(UsageError, match="a method with instruments; received least_squares"):
        anderson_rubin_set(problem, ev.methods.least_squares())
    with pytest.raises(UsageError, match="without compensation for the classical test"):
        anderson_rubin_set(problem, ev.methods.generalized_iv(), errors=HomoskedasticErrors())
    with pytest.raises(UsageError, match="between 0 and 1"):
        anderson_rubin_set(problem, ev.methods.generalized_iv(), level=1.0)
    with pytest.raises(TooFewSamplesError, match="as many cosine averages as equations"):
        anderson_rubin_set(problem, ev.methods.generalized_iv(), errors=AutocorrelatedErrors(3))
    with pytest.raises(InstrumentError, match="at least 2 independent instruments"):
        anderson_rubin_set(model.regression(signals, ev.lags("input", 0, 0)), ev.methods.generalized_iv())
    with pytest.raises(UsageError, match="out of viscous_friction, input_gain"):
        anderson_rubin_set(problem, ev.methods.generalized_iv()).interval("lag")


def test_regressors_that_are_all_their_own_instruments():
    rng = np.random.default_rng(38)
    Phi = np.column_stack([rng.standard_normal(200), np.ones(200)])
    problem = ev.regression(
        response=Phi @ [1.0, 2.0] + rng.standard_normal(200), regressors=Phi, instruments=Phi
    )
    result = anderson_rubin_set(problem, ev.methods.extended_iv(), errors=HomoskedasticErrors())
    assert result.partialled_out == ()
    fit = ev.identify(problem, ev.methods.least_squares())
    half = result.interval("theta_1").length / 2.0
    # One parameter among exogenous ones: the t interval of least squares.
    white = fit.residuals @ fit.residuals / 198
    error = np.sqrt(white * np.linalg.inv(Phi.T @ Phi)[0, 0])
    assert half == pytest.approx(stats.t(198).ppf(0.975) * error, rel=1e-6)
