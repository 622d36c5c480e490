"""Covariances: their scale on white noise, their coverage on autocorrelated noise, and explicit formulas."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import linearmodels
import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linearmodels.shared.covariance import cov_kernel
from scipy import stats
from scipy.signal import lfilter

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.inference.covariance import (
    COSINE_AVERAGES,
    FLIGHT_DEFAULT,
    TABLE,
    CovariancePart,
    JointCovariance,
    cosine_covariance,
    fixed_b_reference,
    long_run_mean_variance,
    sandwich,
)
from eivor.inference.distributions import chi_square_quantile, chi_square_tail, normal_quantile, t_quantile
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation
from eivor.inference.kernel import (
    AndrewsRule,
    Bartlett,
    FixedBandwidth,
    NeweyWestRule,
    Parzen,
    QuadraticSpectral,
    SquareRootRule,
    bartlett_covariance,
    kernel_sum_covariance,
    newey_west_bandwidth,
)
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_scenario
from reference import constants as truth


def least_squares_equation(G, e, flight_of_row):
    rows = EquationRows(G, e, G * e[:, None], flight_of_row)
    return EstimatingEquation(np.eye(G.shape[1]), G.T @ G, e.size, lambda: [rows])


def test_cosine_averages_are_their_formula():
    scores = np.random.default_rng(0).standard_normal((50, 2))
    L = [
        np.sqrt(2.0 / 50) * sum(scores[t - 1] * np.cos(np.pi * j * (t - 0.5) / 50) for t in range(1, 51))
        for j in range(1, 9)
    ]
    wanted = 50.0 / 8.0 * sum(np.outer(l, l) for l in L)  # noqa: E741 - the equation's letter
    np.testing.assert_allclose(cosine_covariance([scores], scores.shape[0]), wanted, rtol=1e-10)
    # A constant is not in them: scores need not be centred.
    np.testing.assert_allclose(cosine_covariance([scores + 7.0], scores.shape[0]), wanted, rtol=1e-9)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_intervals_of_a_mean_cover_in_autocorrelated_noise(memory):
    runs, count, level = 2000, 2000, 0.95
    noise = lfilter(
        [1.0], [1.0, -memory], np.random.default_rng(3).standard_normal((count + 200, runs)), axis=0
    )
    noise = noise[200:]
    half = t_quantile(level, COSINE_AVERAGES) * np.sqrt(
        [long_run_mean_variance(noise[:, run].copy()) for run in range(runs)]
    )
    covered = int((np.abs(noise.mean(axis=0)) <= half).sum())
    low, high = stats.binom.ppf([5e-5, 1.0 - 5e-5], runs, level)
    assert low <= covered <= high
    # The white formula, which intervals must not rest on here, fails by far when there is memory.
    white = normal_quantile(level) * noise.std(axis=0) / np.sqrt(count)
    naive = int((np.abs(noise.mean(axis=0)) <= white).sum())
    assert (naive < low) == (memory > 0.0)


@given(seed=st.integers(0, 999), scale=st.sampled_from([1e-9, 1.0, 1e9]))
def test_sandwich_is_its_formula_in_any_units(seed, scale):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((3, 3)) + 3.0 * np.eye(3)
    root = rng.standard_normal((3, 5))
    inverse = np.linalg.inv(M)
    wanted = inverse @ (root @ root.T) @ inverse.T
    units = np.diag([1.0, scale, 1.0])
    result = sandwich(units @ M @ units, units @ root @ root.T @ units)
    np.testing.assert_allclose(units @ result @ units, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_array_equal(result, result.T)


@pytest.mark.parametrize("flights", [3, 9, 10, 15])
def test_clusters_count_from_ten_flights_on(flights):
    rng = np.random.default_rng(4)
    rows = 20 * flights
    G, flight_of_row = rng.standard_normal((rows, 2)), np.repeat(np.arange(flights), 20)
    # The whole of a flight shares its error: only the clustered covariance knows.
    e = np.repeat(rng.standard_normal(flights), 20) * G[:, 0] + 0.1 * rng.standard_normal(rows)
    made = FLIGHT_DEFAULT.joint(least_squares_equation(G, e, flight_of_row))
    if flights < 10:
        assert [part.name for part in made.parts] == ["equal_weighted_cosines", "classical"]
        return
    clustered = made.part("clustered")
    assert clustered.degrees == flights - 1
    sums = np.array([(G * e[:, None])[flight_of_row == f].sum(axis=0) for f in range(flights)])
    inverse = np.linalg.inv(G.T @ G)
    wanted = flights * inverse @ np.cov(sums.T) @ inverse
    np.testing.assert_allclose(clustered.matrix, wanted, rtol=1e-9)
    direction = np.array([1.0, 0.0])
    assert made.half_width(direction) >= stats.t(flights - 1).ppf(0.975) * np.sqrt(wanted[0, 0]) * (1 - 1e-12)


def test_widest_assumption_makes_the_interval():
    white, robust, clustered = np.diag([4.0, 1.0]), np.diag([1.0, 9.0]), np.diag([0.5, 0.1])
    parts = (
        CovariancePart("robust", robust, 8.0),
        CovariancePart("white", white),
        CovariancePart("clustered", clustered, 11.0),
    )
    made = JointCovariance(parts)
    first, second = np.eye(2)
    assert made.std_error(first) == 2.0
    assert made.std_error(second) == 3.0
    assert made.half_width(first) == pytest.approx(stats.norm.ppf(0.975) * 2.0)
    assert made.half_width(second) == pytest.approx(stats.t(8).ppf(0.975) * 3.0)
    assert made.half_width(second, 0.5) == pytest.approx(stats.t(8).ppf(0.75) * 3.0)
    assert made.half_width(first, extra_variance=5.0) == pytest.approx(
        max(stats.norm.ppf(0.975) * 3.0, stats.t(8).ppf(0.975) * np.sqrt(6.0))
    )
    np.testing.assert_allclose(np.diag(made.matrix), [4.0, 9.0])
    tilted = JointCovariance((CovariancePart("robust", np.array([[1.0, 0.6], [0.6, 9.0]])), parts[1]))
    with pytest.raises(UsageError, match="out of robust, white; received 'grey'"):
        tilted.part("grey")
    np.testing.assert_allclose(tilted.matrix[0, 1] / np.sqrt(4.0 * 9.0), 0.6 / 3.0)


@pytest.mark.thorough
@given(count=st.integers(1, 30), bandwidth=st.integers(0, 40), seed=st.integers(0, 99))
def test_bartlett_covariance_is_its_double_sum(count, bandwidth, seed):
    scores = np.random.default_rng(seed).standard_normal((count, 2))
    wanted = np.zeros((2, 2))
    for t in range(count):
        for s in range(count):
            weight = max(0.0, 1.0 - abs(t - s) / (bandwidth + 1.0))
            wanted += weight * np.outer(scores[t], scores[s]) / count
    covariance = bartlett_covariance(scores, bandwidth)
    np.testing.assert_allclose(covariance, wanted, atol=1e-12)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


def test_rule_of_thumb_and_quantiles_are_the_published_ones():
    assert [newey_west_bandwidth(n) for n in (100, 1000, 100_000)] == [4, 6, 18]
    assert normal_quantile(0.95) == pytest.approx(1.959963984540054)
    assert t_quantile(0.95, 8) == pytest.approx(2.306004135204166)
    assert t_quantile(0.95, 0) == float("inf")
    assert chi_square_quantile(0.95) == pytest.approx(3.841458820694124)
    # Tails are not one minus a distribution: this one is far below the rounding of one.
    assert chi_square_tail(400.0, 3) == pytest.approx(stats.chi2(3).sf(400.0), rel=1e-10)
    assert 0.0 < chi_square_tail(400.0, 3) < 1e-80


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
    equation, solved = fit.equation, fit
    scale = np.abs(equation.scores).sum(axis=0)
    # Total least squares of moment equations solves them to second order only.
    exact = 1e-3 if fit.method == "generalized_iv_tls" else 1e-9
    assert np.all(np.abs(equation.scores.sum(axis=0)) < exact * scale)
    if method.assembler.moment_equations:

        def total(theta):
            moved = replace(solved.solution, theta=theta)
            return replace(solved, solution=moved).equation.scores.sum(axis=0)

        step = 1e-3 * fit.values
        columns = [
            (total(fit.values - step * unit) - total(fit.values + step * unit)) / (2 * step[i])
            for i, unit in enumerate(np.eye(2))
        ]
        np.testing.assert_allclose(np.column_stack(columns), equation.sensitivity, rtol=1e-6)


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


def test_ellipses_are_no_narrower_than_what_intervals_allow_for(record):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    wide = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(900))
    for chosen in (wide, cov.Widest((cov.Classical(), cov.EqualWeightedCosines(3)))):
        covariance = fit.with_covariance(chosen)
        bounds = covariance.ellipse("viscous_friction", "input_gain").bounds
        low, high = covariance.interval("input_gain")
        assert bounds[1][0] < low < high < bounds[1][1]


KERNELS = (Bartlett(), Parzen(), QuadraticSpectral())
PEERS = {"bartlett": "bartlett", "parzen": "parzen", "quadratic_spectral": "qs"}


def peer_weights(kernel, bandwidth, count):
    from linearmodels.iv.covariance import KERNEL_LOOKUP

    return KERNEL_LOOKUP[PEERS[kernel.name]](bandwidth, count - 1)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
@given(
    count=st.integers(2, 40), bandwidth=st.integers(0, 50), cut=st.integers(1, 40), seed=st.integers(0, 99)
)
def test_covariance_is_its_double_sum_however_scores_are_cut(kernel, count, bandwidth, cut, seed):
    scores = np.random.default_rng(seed).standard_normal((count, 2)) + 0.3
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    span = kernel.span(float(bandwidth))
    weights = kernel.weights(lag / span) if span else np.eye(count)
    if kernel.ends:
        weights = np.where(lag <= bandwidth, weights, 0.0)
    blocks = [scores[:cut], scores[cut:]] if cut < count else [scores]
    covariance = kernel_sum_covariance(blocks, count, kernel, float(bandwidth))
    np.testing.assert_allclose(covariance, scores.T @ weights @ scores, atol=1e-10)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
@pytest.mark.parametrize("bandwidth", [0, 1, 7, 30])
def test_kernels_are_those_of_linearmodels(kernel, bandwidth):
    scores = lfilter([1.0], [1.0, -0.7], np.random.default_rng(5).standard_normal((300, 3)), axis=0)
    peer = cov_kernel(scores, peer_weights(kernel, bandwidth, 300))
    result = kernel_sum_covariance([scores[:100], scores[100:]], 300, kernel, float(bandwidth)) / 300
    np.testing.assert_allclose(result, peer, rtol=1e-10)


def test_bandwidths_are_their_formulas():
    rng = np.random.default_rng(7)
    shocks = rng.standard_normal((4000, 2))
    scores = np.column_stack(
        [lfilter([1.0], [1.0, -0.5], shocks[:, 0]), 40.0 * lfilter([1.0], [1.0, -0.8], shocks[:, 1])]
    )

    def blocks():
        return [scores[:1500], scores[1500:]]

    rho = (scores[1:] * scores[:-1]).sum(axis=0) / (scores**2).sum(axis=0)
    # Andrews (1991), (6.4): innovations of variance 1 - rho^2 once a column has variance one.
    power = (1.0 - rho**2) ** 2
    below = (power / (1.0 - rho) ** 4).sum()
    first = (4.0 * rho**2 * power / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)).sum() / below
    second = (4.0 * rho**2 * power / (1.0 - rho) ** 8).sum() / below
    spans = (
        1.1447 * (first * 4000) ** (1 / 3),
        2.6614 * (second * 4000) ** 0.2,
        1.3221 * (second * 4000) ** 0.2,
    )
    for kernel, span in zip(KERNELS, spans, strict=True):
        lags = AndrewsRule().lags(blocks, 4000, kernel)
        assert lags == np.ceil(span - (1.0 if kernel.ends else 0.0))
    assert NeweyWestRule().lags(blocks, 1000, Bartlett()) == 6.0
    assert SquareRootRule().lags(blocks, 400, Bartlett()) == pytest.approx(25.0)
    assert FixedBandwidth(3.0).lags(blocks, 400, Bartlett()) == 3.0
    with pytest.raises(UsageError, match="zero lags or more; received -1"):
        FixedBandwidth(-1.0)


@pytest.mark.parametrize(
    ("b", "share"), [(0.01, 0.002), (0.05, 0.01), (0.1, 0.015), (0.2, 0.015), (0.3, 0.06)]
)
def test_fixed_b_quantiles_are_near_the_published_ones(b, share):
    """Kiefer and Vogelsang (2005): 95 % two-sided, Bartlett kernel, a cubic in b."""
    published = 1.9600 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3
    degrees, seen = fixed_b_reference(Bartlett(), b)
    result = t_quantile(0.95, degrees) / np.sqrt(seen)
    assert result == pytest.approx(published, rel=share)
