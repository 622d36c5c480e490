"""Covariances: their scale on white noise, their coverage on autocorrelated noise, and explicit formulas."""

from __future__ import annotations

from dataclasses import replace

import linearmodels
import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given
from hypothesis import strategies as st
from linearmodels.iv.covariance import KERNEL_LOOKUP
from linearmodels.shared.covariance import cov_kernel
from scipy import stats
from scipy.signal import lfilter
from statsmodels.stats.meta_analysis import combine_effects
from statsmodels.stats.outliers_influence import OLSInfluence

import eivor as ev
from eivor.errors import EstimationError, UsageError
from eivor.estimation.bootstrap import autocovariance, automatic_block_length
from eivor.fleet.change_points import Ordered, deviation_p_values, drifts, outlier_test, steps
from eivor.inference import covariance as kernels
from eivor.inference.distributions import chi_square_quantile, chi_square_tail, normal_quantile, t_quantile
from eivor.inference.estimating_equation import (
    EquationRows,
    EstimatingEquation,
    Products,
    block_edges,
    products_of_rows,
)
from eivor.inference.random_effects import Grouped, Groups, one_group
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_scenario
from inference import instrument_data as data
from reference import constants as truth

cov = ev.covariances


def least_squares_equation(G, e, flight_of_row=None):
    """Least squares in the coordinates of its columns, of one flight unless said otherwise."""
    rows = EquationRows(
        G, e, G * e[:, None], np.zeros(e.size, int) if flight_of_row is None else flight_of_row
    )
    return EstimatingEquation(np.eye(G.shape[1]), G.T @ G, e.size, lambda: [rows])


def test_cosine_averages_are_their_formula():
    scores = np.random.default_rng(0).standard_normal((50, 2))
    cosines = np.cos(np.pi * np.outer(np.arange(1, 9), np.arange(1, 51) - 0.5) / 50)
    L = np.sqrt(2.0 / 50) * cosines @ scores
    wanted = 50.0 / 8.0 * L.T @ L
    np.testing.assert_allclose(cov.cosine_covariance([scores], scores.shape[0]), wanted, rtol=1e-10)
    # A constant is not in them: scores need not be centred.
    np.testing.assert_allclose(cov.cosine_covariance([scores + 7.0], scores.shape[0]), wanted, rtol=1e-9)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_intervals_of_a_mean_cover_in_autocorrelated_noise(memory):
    runs, count, level = 2000, 2000, 0.95
    shocks = np.random.default_rng(3).standard_normal((count + 200, runs))
    noise = lfilter([1.0], [1.0, -memory], shocks, axis=0)[200:]
    variances = [cov.long_run_mean_variance(noise[:, run].copy()) for run in range(runs)]
    half = t_quantile(level, cov.COSINE_AVERAGES) * np.sqrt(variances)
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
    result = cov.sandwich(units @ M @ units, units @ root @ root.T @ units)
    np.testing.assert_allclose(units @ result @ units, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_array_equal(result, result.T)


@pytest.mark.parametrize("flights", [3, 9, 10, 15])
def test_clusters_count_from_ten_flights_on(flights):
    rng = np.random.default_rng(4)
    rows = 20 * flights
    G, flight_of_row = rng.standard_normal((rows, 2)), np.repeat(np.arange(flights), 20)
    # The whole of a flight shares its error: only the clustered covariance knows.
    e = np.repeat(rng.standard_normal(flights), 20) * G[:, 0] + 0.1 * rng.standard_normal(rows)
    made = cov.FLIGHT_DEFAULT.joint(least_squares_equation(G, e, flight_of_row))
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
        cov.CovariancePart("robust", robust, 8.0),
        cov.CovariancePart("white", white),
        cov.CovariancePart("clustered", clustered, 11.0),
    )
    made = cov.JointCovariance(parts)
    first, second = np.eye(2)
    assert (made.std_error(first), made.std_error(second)) == (2.0, 3.0)
    normal, t = stats.norm.ppf(0.975), stats.t(8).ppf(0.975)
    assert made.half_width(first) == pytest.approx(normal * 2.0)
    assert made.half_width(second) == pytest.approx(t * 3.0)
    assert made.half_width(second, 0.5) == pytest.approx(stats.t(8).ppf(0.75) * 3.0)
    widest = max(normal * 3.0, t * np.sqrt(6.0))
    assert made.half_width(first, extra_variance=5.0) == pytest.approx(widest)
    np.testing.assert_allclose(np.diag(made.matrix), [4.0, 9.0])
    tilted = cov.JointCovariance((cov.CovariancePart("robust", np.array([[1.0, 0.6], [0.6, 9.0]])), parts[1]))
    with pytest.raises(UsageError, match="out of robust, white; received 'grey'"):
        tilted.part("grey")
    np.testing.assert_allclose(tilted.matrix[0, 1] / np.sqrt(4.0 * 9.0), 0.6 / 3.0)


@pytest.mark.thorough
@given(count=st.integers(1, 30), bandwidth=st.integers(0, 40), seed=st.integers(0, 99))
def test_bartlett_covariance_is_its_double_sum(count, bandwidth, seed):
    scores = np.random.default_rng(seed).standard_normal((count, 2))
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    wanted = scores.T @ np.maximum(0.0, 1.0 - apart / (bandwidth + 1.0)) @ scores / count
    covariance = kernels.kernel_sum_covariance([scores], count, cov.Bartlett(), bandwidth) / count
    np.testing.assert_allclose(covariance, wanted, atol=1e-12)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


def test_rule_of_thumb_and_quantiles_are_the_published_ones():
    assert [kernels.newey_west_bandwidth(n) for n in (100, 1000, 100_000)] == [4, 6, 18]
    assert normal_quantile(0.95) == pytest.approx(1.959963984540054)
    assert (t_quantile(0.95, 8), t_quantile(0.95, 0)) == (pytest.approx(2.306004135204166), float("inf"))
    assert chi_square_quantile(0.95) == pytest.approx(3.841458820694124)
    # Tails are not one minus a distribution: this one is far below the rounding of one.
    assert chi_square_tail(400.0, 3) == pytest.approx(stats.chi2(3).sf(400.0), rel=1e-10)
    assert 0.0 < chi_square_tail(400.0, 3) < 1e-80


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
    y, endogenous, exogenous, excluded = data.housing()
    fit = ev.identify(data.housing_problem(), ev.methods.extended_iv(ev.methods.TwoStage()))
    return fit, linearmodels.IV2SLS(y, exogenous, endogenous, excluded)


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
    given = {"model": MOTION, "method": method, "instruments": instruments}
    for name, make in cov.TABLE.items():
        chunked = ev.identify_chunks(chunks_of(record, 457), **given, covariance=make())
        wanted = whole.with_covariance(make())
        np.testing.assert_allclose(chunked.covariance, wanted.covariance, rtol=1e-6, err_msg=name)
        for parameter in whole.names:
            assert chunked.interval(parameter) == pytest.approx(wanted.interval(parameter), rel=1e-7)
    assert "std. error" in chunked.summary()


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


def test_passes_over_other_chunks_and_covariances_of_rows_that_are_gone_are_refused(record):
    given = {"model": MOTION, "method": ev.methods.generalized_iv(), "instruments": ev.lags("input", 0, 10)}
    passes = iter([None, 2000])

    def shorter():
        yield from chunks_of(record, 500, next(passes))()

    with pytest.raises(UsageError, match="of 2990 rows in every pass; received 1990"):
        ev.identify_chunks(shorter, **given)
    chunked = ev.identify_chunks(chunks_of(record, 500), **given)
    with pytest.raises(EstimationError, match="for another covariance; received one from chunks"):
        chunked.with_covariance(cov.Classical())


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
    rows = ev.regression(response=response, regressors=np.ones((60, 1)))
    fit = ev.identify(rows, ev.methods.least_squares())
    for lags in np.linspace(0.0, 6.0, 25):
        chosen = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(float(lags)), fixed_b=False)
        assert fit.with_covariance(chosen).covariance[0, 0] > 0.0


def test_ellipses_are_no_narrower_than_what_intervals_allow_for(record):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    wide = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(900))
    for chosen in (wide, cov.Widest((cov.Classical(), cov.EqualWeightedCosines(3)))):
        covariance = fit.with_covariance(chosen)
        gains = covariance.ellipse("viscous_friction", "input_gain").outline(721)[:, 1]
        low, high = covariance.interval("input_gain")
        assert gains.min() < low < high < gains.max()


KERNELS = (cov.Bartlett(), cov.Parzen(), cov.QuadraticSpectral())
PEERS = {"bartlett": "bartlett", "parzen": "parzen", "quadratic_spectral": "qs"}


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
    covariance = kernels.kernel_sum_covariance(blocks, count, kernel, float(bandwidth))
    np.testing.assert_allclose(covariance, scores.T @ weights @ scores, atol=1e-10)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
@pytest.mark.parametrize("bandwidth", [0, 1, 7, 30])
def test_kernels_are_those_of_linearmodels(kernel, bandwidth):
    scores = lfilter([1.0], [1.0, -0.7], np.random.default_rng(5).standard_normal((300, 3)), axis=0)
    peer = cov_kernel(scores, KERNEL_LOOKUP[PEERS[kernel.name]](bandwidth, 299))
    result = kernels.kernel_sum_covariance([scores[:100], scores[100:]], 300, kernel, float(bandwidth)) / 300
    np.testing.assert_allclose(result, peer, rtol=1e-10)


def test_bandwidths_are_their_formulas():
    rng = np.random.default_rng(7)
    shocks = rng.standard_normal((4000, 2))
    memories = lfilter([1.0], [1.0, -0.5], shocks[:, 0]), 40.0 * lfilter([1.0], [1.0, -0.8], shocks[:, 1])
    scores = np.column_stack(memories)

    def blocks():
        return [scores[:1500], scores[1500:]]

    rho = (scores[1:] * scores[:-1]).sum(axis=0) / (scores**2).sum(axis=0)
    # Andrews (1991), (6.4): innovations of variance 1 - rho^2 once a column has variance one.
    power = (1.0 - rho**2) ** 2
    below = (power / (1.0 - rho) ** 4).sum()
    first = (4.0 * rho**2 * power / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)).sum() / below
    second = (4.0 * rho**2 * power / (1.0 - rho) ** 8).sum() / below
    spans = 1.1447 * (first * 4000) ** (1 / 3), *(c * (second * 4000) ** 0.2 for c in (2.6614, 1.3221))
    for kernel, span in zip(KERNELS, spans, strict=True):
        lags = cov.AndrewsRule().lags(blocks, 4000, kernel)
        assert lags == np.ceil(span - (1.0 if kernel.ends else 0.0))
    assert cov.NeweyWestRule().lags(blocks, 1000, cov.Bartlett()) == 6.0
    assert cov.SquareRootRule().lags(blocks, 400, cov.Bartlett()) == pytest.approx(25.0)
    assert cov.FixedBandwidth(3.0).lags(blocks, 400, cov.Bartlett()) == 3.0


@pytest.mark.parametrize(
    ("b", "share"), [(0.01, 0.002), (0.05, 0.01), (0.1, 0.015), (0.2, 0.015), (0.3, 0.06)]
)
def test_fixed_b_quantiles_are_near_the_published_ones(b, share):
    """Kiefer and Vogelsang (2005): 95 % two-sided, Bartlett kernel, a cubic in b."""
    published = 1.9600 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3
    degrees, seen = cov.fixed_b_reference(cov.Bartlett(), b)
    result = t_quantile(0.95, degrees) / np.sqrt(seen)
    assert result == pytest.approx(published, rel=share)


# The table of products: its parts, totals and replicates against the rows themselves.

ROWS, P, N = 97, 3, 2


def rows() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.standard_normal((ROWS, P)), rng.standard_normal((ROWS, N)), rng.standard_normal(ROWS)


def table(blocks: int = 4) -> Products:
    return products_of_rows(*rows(), edges=block_edges(ROWS, blocks))


@pytest.mark.parametrize("blocks", [1, 4, ROWS])
def test_blocks_are_the_products_of_their_rows(blocks):
    """Long blocks by matrix products, short ones many at once."""
    psi, phi, y = rows()
    edges = block_edges(ROWS, blocks)
    result = table(blocks)
    for k in range(blocks):
        here = slice(edges[k], edges[k + 1])
        assert result.counts[k] == edges[k + 1] - edges[k]
        pairs = {"cross": (psi, phi), "instrument_response": (psi, y), "instruments": (psi, psi)}
        pairs |= {"columns": 2 * (np.column_stack([phi, y]),), "power": (y, y)}
        for name, (left, right) in pairs.items():
            np.testing.assert_allclose(getattr(result, name)[k], left[here].T @ right[here], atol=1e-12)


def test_residual_in_the_responses_place():
    psi, phi, y = rows()
    theta = np.array([0.7, -1.3])
    expected = products_of_rows(psi, phi, y - phi @ theta, edges=block_edges(ROWS, 4))
    np.testing.assert_allclose(table().with_residual(theta).sums, expected.sums, atol=1e-12)


def test_totals_and_sums():
    result = table(6)
    np.testing.assert_allclose(result.total.sums, table(1).sums, atol=1e-12)
    assert result.total.count == result.count == ROWS
    np.testing.assert_allclose((result.total + result).total.sums, 2.0 * result.total.sums, atol=1e-12)


def test_autocovariance_is_its_formula() -> None:
    x = np.random.default_rng(8).normal(size=101)
    x -= x.mean()
    wanted = [float(x[k:] @ x[: x.size - k]) / x.size for k in range(20)]
    np.testing.assert_allclose(autocovariance(x, 19), wanted, atol=1e-14)


def test_automatic_length_of_white_noise_is_short_and_that_of_a_trend_long() -> None:
    random = np.random.default_rng(10)
    white = [automatic_block_length(random.normal(size=(1000, 1))) for _ in range(40)]
    assert float(np.median(white)) < 4.0
    assert automatic_block_length(np.arange(1000.0)[:, None]) > 60.0
    assert automatic_block_length(np.ones((100, 1))) == 1.0


def test_it_is_hc3_with_t_of_each_parameters_own_rows():
    rng = np.random.default_rng(0)
    P, e = rng.standard_normal((40, 2)) * [1.0, 3.0], rng.standard_normal(40)
    P[5:, 1] *= 0.1
    (part,) = cov.ByRow().parts(least_squares_equation(P, e))
    inverse = np.linalg.inv(P.T @ P)
    influence = P @ inverse
    leverage = np.einsum("ti,ij,tj->t", P, inverse, P)
    plain = influence.T * (e / (1.0 - leverage)) ** 2 @ influence
    nu = (influence**2).sum(axis=0) ** 2 / (influence**4).sum(axis=0)
    assert nu[1] < 8.0 < nu[0]
    wider = stats.t(nu).ppf(0.975) / stats.norm.ppf(0.975)
    np.testing.assert_allclose(part.matrix, plain * np.outer(wider, wider), rtol=1e-9)
    assert part.name == "by_row"
    assert np.isinf(part.degrees)


def test_a_column_in_a_single_row_is_no_error():
    columns = np.column_stack([np.ones(8), np.eye(8)[0]])
    (part,) = cov.ByRow().parts(least_squares_equation(columns, np.arange(8.0)))
    assert np.isfinite(part.matrix).all()


# Means of estimates that differ: against other people's programs, by hand, and by draws.


def drawn(seed, sizes, between):
    rng = np.random.default_rng(seed)
    rows = sum(sizes)
    errors = rng.uniform(0.01, 0.05, rows)
    y = 0.3 + np.hypot(between, errors) * rng.standard_normal(rows)
    return Grouped(Groups(np.array(sizes)), y, errors**2)


@pytest.mark.parametrize("between", [0.1, 0.2, 0.4])
def test_statsmodels_gives_the_same_variances_between_and_means(between):
    made = drawn(3, [4, 9, 20], between)  # of two estimates its iteration does not converge
    groups, y, v = made.groups, made.y, made.v
    means, moments = made.means(made.paule_mandel()), made.moment_between()
    for number, start in enumerate(groups.starts):
        rows = slice(start, start + groups.sizes[number])
        iterated = combine_effects(y[rows], v[rows], method_re="iterated", use_t=True, atol=1e-12)
        assert means.between[number] == pytest.approx(max(iterated.tau2, 0.0), abs=1e-6)
        assert means.value[number] == pytest.approx(iterated.mean_effect_re, abs=1e-6)
        plain = iterated.sd_eff_w_re_hksj if iterated.scale_hksj_re >= 1.0 else iterated.sd_eff_w_re
        assert np.sqrt(means.variance[number]) == pytest.approx(plain, abs=1e-6)
        by_moments = max(combine_effects(y[rows], v[rows], method_re="dl").tau2, 0.0)
        assert moments[number] == pytest.approx(by_moments, abs=1e-9)


def test_pymare_gives_the_same_of_flights_as_they_are():
    """The same of nine logarithms of a gain whose errors are unlike."""
    y = np.array([3.61, 3.64, 3.58, 3.70, 3.55, 3.66, 3.49, 3.63, 3.60])
    v = np.array([0.02, 0.03, 0.01, 0.05, 0.02, 0.04, 0.03, 0.015, 0.025]) ** 2
    made = Grouped(one_group(9), y, v)
    low, high = made.q_profile(near=np.array([1.0]))
    assert (low[0], high[0]) == pytest.approx((0.0006566118607090315, 0.012827818979102555), abs=1e-6)
    moments = made.moment_between()
    assert moments[0] == pytest.approx(0.00144084, abs=1e-8)
    means = made.means(moments)
    assert means.value[0] == pytest.approx(3.59964825, abs=1e-6)


def ordered(y, sizes, *, weights=None):
    """Rows whose own variances are next to nothing."""
    y = np.asarray(y, dtype=float)
    weights = np.ones(y.size) if weights is None else weights
    nuisances = np.concatenate([np.arange(size, dtype=float) for size in sizes])
    none = np.zeros((0, y.size)), np.zeros((len(sizes), 0, 0))
    return Ordered(Groups(np.array(sizes)), y, np.full(y.size, 1e-12), weights, weights, nuisances, *none)


def drawn_courses(seed, rows):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(rows), rng.uniform(0.5, 2.0, rows)


def test_a_step_is_the_best_of_all_pairs_of_means():
    y, weights = drawn_courses(2, 25)
    y[6:15] += 5.0  # the first group, of 15, after its sixth
    result = steps(ordered(y, [15, 10], weights=weights))
    for number, rows in enumerate((slice(0, 15), slice(15, 25))):
        current, w = y[rows], weights[rows]
        after = [np.arange(current.size) >= item for item in range(3, current.size - 2)]
        fits = [sm.WLS(current, sm.add_constant(item.astype(float)), weights=w).fit() for item in after]
        best = max(fits, key=lambda fit: abs(fit.tvalues[1]))
        assert result.index[number] == 3 + fits.index(best)
        assert result.size[number] == pytest.approx(best.params[1])
        assert result.half_width[number] == pytest.approx(np.diff(best.conf_int()[1])[0] / 2)
        assert result.squares[number] == pytest.approx(best.ssr)
        line = ordered(current, [current.size], weights=w)
        assert steps(line).after == pytest.approx(after[fits.index(best)])
        # between what one test and all of them would say
        assert best.pvalues[1] <= result.p_values[number] <= min(1.0, len(fits) * best.pvalues[1])
        assert result.first[number] <= result.index[number] <= result.last[number]
    assert result.index[0] == 6
    assert result.p_values[0] < 0.01 < result.p_values[1]


def test_deviations_are_externally_studentized_residuals():
    y, _ = drawn_courses(4, 12)
    y[5] += 6.0
    made = ordered(y, [12])
    result = drifts(made)
    p_values = deviation_p_values(made, result.line, result.leverage, np.array([2.0]))
    truth = OLSInfluence(sm.OLS(y, sm.add_constant(np.arange(12.0))).fit())
    far = np.abs(truth.resid_studentized_external) > 2.0
    assert far[5]
    expected = 2 * stats.t.sf(np.abs(truth.resid_studentized_external), 9)
    assert p_values[far] == pytest.approx(expected[far])
    assert (p_values[~far] == 1.0).all()


def added(y, sizes, sets=None):
    """What is added to variances of 1e-4, the groups a set unless said otherwise."""
    v = np.full(y.size, 1e-4)
    return outlier_test(Groups(np.array(sizes)), sets or one_group(len(sizes)), v)(y)


def noise(seed, rows):
    return 0.004 * np.random.default_rng(seed).standard_normal(rows)


@pytest.mark.parametrize("place", [3, 4, 10, 16, 17])
@pytest.mark.parametrize("size", [0.05, 0.5, -5.0])
def test_steps_and_drifts_are_courses(place, size):
    y = noise(2, 20)
    y[place:] += size
    assert not added(y, [20]).any()
    assert not added(noise(2, 20) + np.linspace(0.0, size, 20), [20]).any()


def test_few_of_normal_estimates_are_isolated():
    sizes = [40] * 250
    assert 0.0 < np.mean(added(2.5 * noise(8, 10_000), sizes) > 0.0) < 0.006


def test_different_degrees_keep_their_correlation():
    matrix = np.array([[1.0, 0.8], [0.8, 1.0]])
    wide = cov.CovariancePart("robust", matrix * [[1.0, 0.1], [0.1, 0.01]], 5.0)
    plain = cov.CovariancePart("classical", matrix * [[0.01, 0.1], [0.1, 1.0]], share=0.81)
    draws = cov.joint_draws(
        np.zeros(2), cov.JointCovariance((wide, plain)), 100_000, np.random.default_rng(1)
    )
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(0.8, abs=0.01)
    edges = [stats.t.ppf(0.975, 5.0), stats.norm.ppf(0.975) / 0.9]
    assert np.quantile(draws, 0.975, axis=0) == pytest.approx(edges, abs=0.005)
