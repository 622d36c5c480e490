"""Covariance estimators against linearmodels and Stata, on the whole record and in chunks."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import linearmodels
import numpy as np
import polars as pl
import pytest

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.estimation.estimate import equation_of
from eivor.inference.covariance import TABLE
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_scenario
from eivor.models.regression import Parameter, Regression, SampleRows
from reference import constants as truth

cov = ev.covariances
METHODS = (
    (ev.methods.least_squares(), ()),
    (ev.methods.total_least_squares(), ()),
    (ev.methods.bias_compensated_least_squares(), ()),
    (ev.methods.extended_iv(), ev.lags("input", 1, 10)),
    (ev.methods.extended_iv(ev.methods.TwoStage()), ev.lags("input", 1, 10)),
    (ev.methods.generalized_iv(), ev.lags("input", 0, 10)),
    (ev.methods.generalized_iv_tls(), ev.lags("input", 0, 10)),
)
MOTION = ev.VerticalMotion(intercept=False)


@pytest.fixture(scope="module")
def housing():
    """Rents on house values (endogenous), share of city dwellers and a constant, in Stata's order."""
    path = resources.files("linearmodels.tests.iv.results").joinpath("housing.csv")
    table = pl.read_csv(path.read_bytes())
    regions = sorted(set(table["region"]))[1:]
    exogenous = np.column_stack([table["pcturban"], np.ones(table.height)]).astype(float)
    excluded = np.column_stack([table["faminc"], *[(table["region"] == r).cast(int) for r in regions]])
    y, endogenous = (table[name].to_numpy().astype(float) for name in ("rent", "hsngval"))
    problem = ev.regression(
        response=y,
        regressors=np.column_stack([endogenous, exogenous]),
        instruments=np.column_stack([exogenous, excluded]),
        names=["hsngval", "pcturban", "const"],
    )
    fit = ev.identify(problem, ev.methods.extended_iv(ev.methods.TwoStage()))
    peer = linearmodels.IV2SLS(y, exogenous, endogenous[:, None], excluded)
    return fit, peer


def in_our_order(covariance):
    order = [2, 0, 1]
    return covariance.to_numpy()[np.ix_(order, order)]


@pytest.mark.parametrize(
    ("estimator", "published"),
    [(cov.Classical(), truth.STATA_CLASSICAL), (cov.HeteroskedasticityRobust(), truth.STATA_ROBUST)],
    ids=["classical", "robust"],
)
def test_stata_s_printed_covariances(housing, estimator, published):
    covariance = housing[0].with_covariance(estimator).covariance
    np.testing.assert_allclose(covariance, published, rtol=2e-7)


def test_linearmodels_robust_covariance(housing):
    fit, peer = housing
    covariance = fit.with_covariance(cov.HeteroskedasticityRobust()).covariance
    np.testing.assert_allclose(covariance, in_our_order(peer.fit(cov_type="robust").cov), rtol=1e-8)


@pytest.mark.parametrize("bandwidth", [0, 1, 5, 20])
@pytest.mark.parametrize(
    ("kernel", "name"),
    [(cov.Bartlett(), "bartlett"), (cov.Parzen(), "parzen"), (cov.QuadraticSpectral(), "qs")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_linearmodels_kernel_covariances(housing, kernel, name, bandwidth):
    fit, peer = housing
    estimator = cov.KernelRobust(kernel, cov.FixedBandwidth(float(bandwidth)))
    wanted = peer.fit(cov_type="kernel", kernel=name, bandwidth=bandwidth).cov
    np.testing.assert_allclose(fit.with_covariance(estimator).covariance, in_our_order(wanted), rtol=1e-8)


def test_critical_values_follow_the_covariance(housing):
    fit, _ = housing
    widths = {}
    for fixed_b in (False, True):
        chosen = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(9.0), fixed_b=fixed_b)
        low, high = fit.with_covariance(chosen).interval("pcturban")
        widths[fixed_b] = 0.5 * (high - low) / fit.with_covariance(chosen).std_error("pcturban")
    assert widths[False] == pytest.approx(1.959964, rel=1e-6)
    # The record has 50 rows: b = 0.2.
    assert widths[True] == pytest.approx(2.6, rel=1e-3)


# -- signals, chunks -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def record():
    scenario = replace(shipped_scenario("rich-high"), samples=3000)
    return ev.simulate(scenario, np.random.default_rng(1)).signals


def chunks_of(record, size, last=None):
    def chunks():
        for start in range(0, last or record.sample_count, size):
            channels = {name: values[start : start + size] for name, values in record.channels.items()}
            yield ev.Signals(record.rate_hz, channels, noise=record.noise, offset=start)

    return chunks


@pytest.mark.thorough
@pytest.mark.parametrize(("method", "instruments"), METHODS, ids=lambda value: getattr(value, "name", ""))
def test_chunks_give_the_covariance_of_the_whole_record(record, method, instruments):
    whole = ev.identify(MOTION.regression(record, instruments), method)
    for name, make in TABLE.items():
        identify_chunks = ev.identify_chunks(
            chunks_of(record, 457), model=MOTION, method=method, instruments=instruments, covariance=make()
        )
        wanted = whole.with_covariance(make())
        np.testing.assert_allclose(identify_chunks.covariance, wanted.covariance, rtol=1e-6, err_msg=name)
        for parameter in whole.names:
            assert identify_chunks.interval(parameter) == pytest.approx(wanted.interval(parameter), rel=1e-7)
    assert "std. error" in identify_chunks.summary()


@pytest.mark.parametrize(("method", "instruments"), METHODS, ids=lambda value: getattr(value, "name", ""))
def test_scores_add_up_to_zero_and_sensitivity_is_their_derivative(record, method, instruments):
    """At the solution the scores sum to nothing, and M is minus the derivative of their sum."""
    problem = MOTION.regression(record, instruments)
    fit = ev.identify(problem, method)
    equation, solved = fit.best.equation, fit.best
    scale = np.abs(equation.scores).sum(axis=0)
    # Total least squares of moment equations solves them to second order only.
    exact = 1e-3 if fit.method == "generalized_iv_tls" else 1e-9
    assert np.all(np.abs(equation.scores.sum(axis=0)) < exact * scale)
    if method.assembler.moment_equations:

        def total(theta):
            moved = replace(solved.solution, theta=theta)
            return equation_of(replace(solved, solution=moved)).scores.sum(axis=0)

        step = 1e-3 * fit.best.values
        columns = [
            (total(fit.best.values - step * unit) - total(fit.best.values + step * unit)) / (2 * step[i])
            for i, unit in enumerate(np.eye(2))
        ]
        np.testing.assert_allclose(np.column_stack(columns), equation.sensitivity, rtol=1e-6)


def test_blocks_of_rows_are_the_rows(record):
    masked = replace(record, valid=np.random.default_rng(0).random(record.sample_count) > 0.02)
    for signals in (record, masked):
        problem = MOTION.regression(signals, ev.lags("input", 0, 4))
        rows = problem.rows()
        for made in (list(problem.blocks(700)), list(rows.blocks(700))):
            np.testing.assert_array_equal(np.concatenate([block.response for block in made]), rows.response)
            np.testing.assert_array_equal(
                np.concatenate([block.regressors for block in made]), rows.regressors
            )
            np.testing.assert_array_equal(
                np.concatenate([block.instruments for block in made]), rows.instruments
            )


def test_passes_over_other_chunks_are_refused(record):
    calls = []

    def chunks():
        calls.append(1)
        return chunks_of(record, 500, None if len(calls) == 1 else 2000)()

    with pytest.raises(UsageError, match="of 2990 rows in every pass; received 1990"):
        ev.identify_chunks(
            chunks, model=MOTION, method=ev.methods.generalized_iv(), instruments=ev.lags("input", 0, 10)
        )


def test_covariances_that_cannot_be_are_refused(record):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    with pytest.raises(UsageError, match="ClusteredByFlight can use; received too few flights"):
        fit.with_covariance(cov.ClusteredByFlight()).interval("input_gain")
    with pytest.raises(UsageError, match="one cosine average or more; received 0"):
        cov.EqualWeightedCosines(0)


def test_another_covariance_is_refused_where_rows_are_gone(record):
    identify_chunks = ev.identify_chunks(
        chunks_of(record, 500),
        model=MOTION,
        method=ev.methods.generalized_iv(),
        instruments=ev.lags("input", 0, 5),
    )
    with pytest.raises(EstimationError, match="for another covariance; received one from chunks"):
        identify_chunks.with_covariance(cov.Classical())


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_chunks_tell_weak_instruments_too():
    scenario = replace(shipped_scenario("white"), samples=2000)
    white = ev.simulate(scenario, np.random.default_rng(3)).signals
    method, instruments = ev.methods.extended_iv(), ev.lags("input", 1, 5)
    whole = ev.identify(MOTION.regression(white, instruments), method)
    chunked = ev.identify_chunks(chunks_of(white, 300), model=MOTION, method=method, instruments=instruments)
    assert whole.status == chunked.status == Status.WEAK


@pytest.mark.parametrize("kernel", [cov.Bartlett(), cov.Parzen(), cov.QuadraticSpectral()])
def test_no_bandwidth_beyond_the_record_makes_intervals_shorter(record, kernel):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    widths = []
    for lags in (record.sample_count - 1, 10 * record.sample_count):
        low, high = fit.with_covariance(cov.KernelRobust(kernel, cov.FixedBandwidth(lags))).interval(
            "input_gain"
        )
        widths.append(high - low)
    assert widths[1] == pytest.approx(widths[0])


def test_fractional_bandwidths_count_every_lag_within_their_span():
    """Alternating scores: leaving out the last lag would make the variance negative."""
    signs = (-1.0) ** np.arange(60)
    response = 1.0 + signs + 0.05 * np.random.default_rng(0).standard_normal(60)
    fit = ev.identify(
        ev.regression(response=response, regressors=np.ones((60, 1))), ev.methods.least_squares()
    )
    for lags in np.linspace(0.0, 6.0, 25):
        chosen = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(float(lags)), fixed_b=False)
        assert fit.with_covariance(chosen).covariance[0, 0] > 0.0


def test_clusters_of_compensated_equations_have_their_constant():
    """Flights of unequal length: what noise adds on average must not pass for a difference between them."""
    rng = np.random.default_rng(1)
    lengths = rng.integers(20, 400, 40)
    flights = np.repeat(np.arange(40), lengths)
    x, noise = rng.standard_normal((2, flights.size))
    noisy = x + 0.8 * noise
    response = 0.7 * x + 0.3 * rng.standard_normal(flights.size)
    problem = Regression(
        response,
        noisy[:, None],
        noisy[:, None],
        (Parameter("a"),),
        SampleRows(flights),
        instrument_noise=np.array([[0.64, 0.0]]),
    )
    fit = ev.identify(problem, ev.methods.generalized_iv())
    robust, clustered = (
        fit.with_covariance(item).std_error("a")
        for item in (cov.HeteroskedasticityRobust(), cov.ClusteredByFlight())
    )
    # Forty clusters tell a standard error to 11 %.
    assert clustered == pytest.approx(robust, rel=0.45)


def test_ellipses_are_no_narrower_than_what_intervals_allow_for(record):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    wide = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(900))
    for chosen in (wide, cov.Widest((cov.Classical(), cov.EqualWeightedCosines(3)))):
        covariance = fit.with_covariance(chosen)
        bounds = covariance.ellipse("viscous_friction", "input_gain").bounds
        low, high = covariance.interval("input_gain")
        assert bounds[1][0] < low < high < bounds[1][1]


def test_short_records_have_fewer_averages():
    rng = np.random.default_rng(2)
    for count in (4, 6, 40):
        problem = ev.regression(response=rng.standard_normal(count), regressors=np.ones((count, 1)))
        fit = ev.identify(problem, ev.methods.least_squares())
        assert fit.best.covariance.parts[0].degrees == min(8, count - 1)
