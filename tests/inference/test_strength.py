"""Strength of instruments against linearmodels, ivreg2 and published critical values; its calibration."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from eivor.inference.covariance import (
    Bartlett,
    Parzen,
    QuadraticSpectral,
    cosine_averages,
    cosine_covariance,
    kernel_sum_covariance,
)
from eivor.inference.diagnostics import excitation, residuals
from eivor.inference.diagnostics.instruments import critical_values, endogeneity, hansen_j, strength
from eivor.inference.diagnostics.record import (
    EquationProducts,
    Subject,
    conditional_first_stage,
    first_stage_of_products,
    hotelling_p_value,
    joint_averages,
    orthonormal_basis,
)
from eivor.inference.estimating_equation import block_edges, products_of_rows
from eivor.inference.verdict import Reason, Status, verdict
from eivor.signals.noise import fractional_difference
from inference import instrument_data as data
from reference import constants as truth

linearmodels = pytest.importorskip("linearmodels")


def equation_products(instruments, jacobian, residual, blocks, *, shared=None, constant=None):
    """Products of rows that are samples in time order."""
    p, n = instruments.shape[1], jacobian.shape[1]
    made = products_of_rows(instruments, jacobian, residual, edges=block_edges(residual.size, blocks))
    shared = np.zeros((p, n)) if shared is None else shared
    constant = np.zeros(p) if constant is None else constant
    return EquationProducts(made.counts, made.sums, made.tested, shared, constant, made.count)


def products_of(y, endogenous, exogenous, excluded, blocks=25):
    """Products at the two-stage estimate."""
    _, X, Z, residual = data.two_stage(y, endogenous, exogenous, excluded)
    return equation_products(Z, X, residual, blocks)


def drawn(seed, count=600, memory=0.0, strength=0.2, columns=2, instruments=5):
    rng = np.random.default_rng(seed)
    Z = data.autoregression(rng, (count, instruments), memory)
    V = data.autoregression(rng, (count, columns), memory)
    pi = np.random.default_rng(1).standard_normal((instruments, columns))
    return Z, strength * Z @ pi + V


def strength_of(Z, X, blocks=100, **compensation):
    return strength(equation_products(Z, X, np.ones(X.shape[0]), blocks, **compensation))


def test_linearmodels_first_stage():
    y, endogenous, exogenous, excluded = data.housing()
    peer = linearmodels.IV2SLS(y, exogenous, endogenous, excluded).fit(cov_type="unadjusted", debiased=True)
    reported = peer.first_stage.diagnostics.iloc[0]
    result = strength(products_of(y, endogenous, exogenous, excluded))
    assert result.conditional[0] == pytest.approx(reported["f.stat"], rel=1e-6)
    assert result.partial_r_squared[0] == pytest.approx(reported["partial.rsquared"], rel=1e-6)
    assert result.shea_r_squared[0] == pytest.approx(reported["shea.rsquared"], rel=1e-6)
    assert result.cragg_donald == pytest.approx(reported["f.stat"], rel=1e-6)
    # with one endogenous column the smallest eigenvalue is its effective F
    assert result.smallest_eigenvalue == pytest.approx(result.effective[0], rel=1e-6)
    assert result.smallest_critical == pytest.approx(result.critical[0], rel=1e-6)


def test_shea_r_squared_of_two_endogenous_columns():
    rng = np.random.default_rng(0)
    Z, X = drawn(3)
    exogenous = np.ones((600, 1))
    y = X @ [1.0, 2.0] + rng.standard_normal(600)
    peer = linearmodels.IV2SLS(y, exogenous, X, Z).fit(cov_type="unadjusted").first_stage.diagnostics
    result = strength(products_of(y, X, exogenous, Z, 100))
    np.testing.assert_allclose(result.shea_r_squared[:2], peer["shea.rsquared"].to_numpy(), rtol=1e-6)


def test_published_cragg_donald_of_griliches():
    """ivreg2 prints 12.5516 and a coefficient of schooling of .17242531."""
    griliches = data.griliches()
    if griliches is None:
        pytest.skip("statsmodels, which ships griliches76.dta, is not installed")
    theta, *_ = data.two_stage(*griliches)
    assert theta[0] == pytest.approx(0.17242531, abs=5e-9)
    assert strength(products_of(*griliches, 379)).cragg_donald == pytest.approx(12.5516, abs=5e-5)


@pytest.mark.parametrize(("bias", "published"), [(0.05, 37.418), (0.1, 23.109), (0.2, 15.062)])
def test_published_critical_values(bias, published):
    """Montiel Olea and Pflueger's, one instrument, as their `weakivtest` prints them."""
    assert critical_values(np.array([[[3.7]]]), bias)[1] == pytest.approx(published, abs=5e-4)


@pytest.mark.thorough
def test_effective_f_of_idle_instruments_is_one_in_autocorrelated_data():
    """The mean of F_eff is one when nothing is explained; the white F is several times that."""
    runs = 300
    results = [strength_of(*drawn(seed, 1000, 0.8, strength=0.0, columns=1)) for seed in range(runs)]
    effective = np.array([result.effective[0] for result in results])
    white = np.array([result.conditional[0] for result in results])
    # the ratio of two quadratic forms has a mean a little above one; 15 averages of 5 instruments
    assert effective.mean() == pytest.approx(1.0, abs=0.08 + 4.0 * effective.std() / np.sqrt(runs))
    assert white.mean() > 3.0 * effective.mean()


@pytest.mark.calibration
def test_critical_value_keeps_its_size():
    """Instruments as weak as the critical value is for exceed it in one record of twenty, not more."""
    runs, count, exceeded = 400, 400, 0
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        z = rng.standard_normal(count)
        x = np.sqrt(10.0 / count) * z + rng.standard_normal(count)
        result = strength_of(z[:, None], x[:, None], 100)
        exceeded += bool(result.effective[0] > result.critical[0])
    # eight averages in the denominator widen the tail that the critical value counts with
    assert stats.binom.ppf(1e-4, runs, 0.05) <= exceeded <= stats.binom.ppf(1.0 - 1e-4, runs, 0.16)


def test_shared_noise_is_not_strength():
    """A channel of noise alone, with itself as an instrument, moves itself: compensation sees through it."""
    rng = np.random.default_rng(4)
    noise = rng.standard_normal(5003)
    Z = np.column_stack([noise[3:], noise[2:-1], noise[1:-2], noise[:-3]])
    X = Z[:, :1]
    shared = np.array([[1.0], [0.0], [0.0], [0.0]])
    naive = strength_of(Z, np.column_stack([X[:, 0] + 1e-3 * rng.standard_normal(5000)]))
    result = strength_of(Z, X, shared=shared, constant=np.zeros(4))
    assert naive.effective[0] > 1e6
    assert result.effective[0] < 4.0
    # and with a signal below the noise, strength is that of the signal
    signal = data.autoregression(rng, (5003,), 0.9)
    seen = signal + noise
    Z = np.column_stack([seen[3:], seen[2:-1], seen[1:-2], seen[:-3]])
    kept = strength_of(Z, Z[:, :1], shared=shared, constant=np.zeros(4))
    assert kept.effective[0] > kept.critical[0]


def test_moments_are_compensated_alike():
    """Identify's own check, from moments: with C the same F as here, without it that of the rows."""
    rng = np.random.default_rng(9)
    seen = data.autoregression(rng, (2003,), 0.9) + rng.standard_normal(2003)
    Z = np.column_stack([seen[3:], seen[2:-1], seen[1:-2], seen[:-3]])
    X = np.column_stack([Z[:, 0], Z[:, 1] + data.autoregression(rng, (2000,), 0.5)])
    shared = np.zeros((4, 2))
    shared[0, 0] = shared[1, 1] = 1.0
    moments = (Z.T @ Z / 2000, Z.T @ X / 2000, X.T @ X / 2000, 2000)
    compensated = strength_of(Z, X, shared=shared, constant=np.zeros(4)).conditional
    np.testing.assert_allclose(first_stage_of_products(*moments, shared), compensated, rtol=1e-6)
    of_rows = conditional_first_stage(orthonormal_basis(Z), X)
    np.testing.assert_allclose(first_stage_of_products(*moments)[1], of_rows[1], rtol=1e-6)
    # what the noise itself contributes is no longer counted
    assert (compensated < 0.5 * first_stage_of_products(*moments)).all()


def test_noise_where_the_instruments_have_power_is_no_strength():
    """Of spectra both gather in some bins: by chance they agree there as by many more instruments."""
    rng, envelope = np.random.default_rng(11), np.exp(-(((np.arange(2000) - 300.0) / 30.0) ** 2))[:, None]
    both = []
    for _ in range(50):
        basis = orthonormal_basis(envelope * rng.standard_normal((2000, 4)))
        column = (envelope + 0.01) * rng.standard_normal((2000, 1))
        both.append([conditional_first_stage(basis, column, effective=item)[0] for item in (False, True)])
    plain, effective = np.mean(both, axis=0)
    assert plain > 10.0
    assert 0.7 < effective < 1.3


def test_column_that_is_its_own_instrument_is_not_weak():
    Z, _ = drawn(8)
    result = strength_of(Z, Z[:, :2].copy())
    assert np.isinf(result.effective).all()
    assert np.isinf(result.cragg_donald)
    assert np.isinf(result.smallest_eigenvalue)


def test_fewer_independent_instruments_than_columns_have_no_strength():
    Z, X = drawn(10)
    result = strength_of(np.column_stack([Z[:, 0], 2.0 * Z[:, 0]]), X)
    assert (result.effective == 0.0).all()
    assert result.smallest_eigenvalue == result.cragg_donald == 0.0


def problem(seed, rows=200, count=5):
    rng = np.random.default_rng(seed)
    Z = rng.standard_normal((rows, count))
    G = Z @ rng.standard_normal((count, 3)) + 2.0 * rng.standard_normal((rows, 3))
    return Z, G


def test_strength_of_too_few_or_perfect_instruments():
    Z, G = problem(2)
    basis = orthonormal_basis(Z[:, :2])
    np.testing.assert_array_equal(conditional_first_stage(basis, G), np.zeros(3))
    np.testing.assert_array_equal(conditional_first_stage(orthonormal_basis(Z[:5]), G[:5]), np.zeros(3))
    inside = orthonormal_basis(np.column_stack([Z, G]))
    assert np.all(conditional_first_stage(inside, G) > 1e12)


@pytest.mark.parametrize("order", list(itertools.permutations(Status)))
def test_the_worst_ground_decides_and_stands_first(order):
    reasons = [Reason(status, f"{status.value} because.", "Do.") for status in order]
    made = verdict(reasons)
    assert made.status is Status.REFUSED
    assert [reason.status for reason in made.reasons] == list(reversed(Status))
    assert made.sentences[0] == "refused because. Do."
    for worst, best in itertools.combinations(range(4), 2):
        kept = [reason for reason in reasons if list(Status).index(reason.status) in {worst, best}]
        assert list(Status).index(verdict(kept).status) == best


def endogeneity_of(result, blocks=25):
    products = products_of(*result, blocks)
    return endogeneity(products, np.linalg.solve(products.instrument_mean, products.sensitivity))


@pytest.mark.parametrize("case", ["housing", "griliches"])
def test_linearmodels_durbin_and_wu_hausman(case):
    result = data.housing() if case == "housing" else data.griliches()
    if result is None:
        pytest.skip("statsmodels, which ships griliches76.dta, is not installed")
    y, endogenous, exogenous, excluded = result
    peer = linearmodels.IV2SLS(y, exogenous, endogenous, excluded).fit(cov_type="unadjusted")
    test = endogeneity_of(result)
    assert test.degrees == endogenous.shape[1]
    assert test.durbin == pytest.approx(peer.durbin().stat, rel=1e-6)
    assert test.durbin_p_value == pytest.approx(peer.durbin().pval, rel=1e-6)
    assert test.wu == pytest.approx(peer.wu_hausman().stat, rel=1e-6)
    assert test.wu_p_value == pytest.approx(peer.wu_hausman().pval, rel=1e-6)


def drawn_endogeneity(seed, endogenous=0.0, count=800, memory=0.8):
    rng = np.random.default_rng(seed)
    e = data.autoregression(rng, (count,), memory)
    Z = data.autoregression(rng, (count, 3), memory)
    x = Z @ [0.5, 0.3, -0.4] + endogenous * e + data.autoregression(rng, (count,), memory)
    return x + e, x[:, None], np.ones((count, 1)), Z


@pytest.mark.calibration
def test_size_and_power_in_autocorrelated_data():
    runs = 600
    under = [endogeneity_of(drawn_endogeneity(seed), 128) for seed in range(runs)]
    robust = sum(test.p_value < 0.05 for test in under)
    white = sum(test.durbin_p_value < 0.05 for test in under)
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.065])
    assert low <= robust <= high
    assert white > 2 * high  # what the homoskedastic forms do here
    assert sum(endogeneity_of(drawn_endogeneity(seed, 0.8), 128).p_value < 0.05 for seed in range(100)) > 80


def test_noise_in_a_regressor_is_endogeneity_and_a_declared_zero_is_not():
    """Compensated equations whose noise is nil are ordinary ones."""
    rng = np.random.default_rng(1)
    count = 4000
    u = data.autoregression(rng, (count + 4,), 0.9)
    noisy = u + 0.5 * rng.standard_normal(count + 4)
    y = 2.0 * u[4:] + 0.1 * rng.standard_normal(count)
    Z = np.column_stack([noisy[4 - lag : count + 4 - lag] for lag in range(5)])
    for variance, endogenous in ((0.25, True), (0.0, False)):
        Psi = Z if variance else np.column_stack([u[4 - lag : count + 4 - lag] for lag in range(5)])
        X = Psi[:, :1]
        shared = np.zeros((5, 1))
        shared[0] = variance
        A = Psi.T @ X / count - shared
        theta = float(A[:, 0] @ (Psi.T @ y) / count / (A[:, 0] @ A[:, 0]))
        products = equation_products(
            Psi, X, y - X[:, 0] * theta, 128, shared=shared, constant=shared[:, 0] * theta
        )
        result = endogeneity(products, A)
        assert (result.p_value < 0.001) == endogenous
        slope = float(X[:, 0] @ y / (X[:, 0] @ X[:, 0]))
        assert result.difference[0] == pytest.approx(theta - slope, rel=1e-6)


def parts(result):
    theta, X, Z, residual = data.two_stage(*result)
    count = residual.size
    return Z * residual[:, None], Z.T @ X / count, count, theta


def test_stata_two_step_gmm():
    scores, A, count, _ = parts(data.housing())
    result = hansen_j(scores.mean(axis=0), A, scores.T @ scores / count, count)
    assert pytest.approx(truth.STATA_GMM_J, rel=1e-9) == result.J
    assert result.degrees == 3
    assert result.p_value == pytest.approx(stats.chi2(3).sf(truth.STATA_GMM_J), rel=1e-9)


@pytest.mark.parametrize(
    ("kernel", "name", "bandwidth"),
    [(Bartlett(), "bartlett", 3), (Parzen(), "parzen", 4), (QuadraticSpectral(), "qs", 2)],
)
def test_linearmodels_kernel_weights(kernel, name, bandwidth):
    y, endogenous, exogenous, excluded = data.housing()
    scores, A, count, _ = parts((y, endogenous, exogenous, excluded))
    S = kernel_sum_covariance([scores], count, kernel, float(bandwidth)) / count
    weights = {"weight_type": "kernel", "kernel": name, "bandwidth": bandwidth}
    peer = linearmodels.IVGMM(y, exogenous, endogenous, excluded, **weights).fit(iter_limit=2)
    result = hansen_j(scores.mean(axis=0), A, S, count)
    assert pytest.approx(peer.j_stat.stat, rel=1e-6) == result.J
    assert result.p_value == pytest.approx(peer.j_stat.pval, rel=1e-6)


def test_exactly_identified_equations_cannot_disagree():
    g, A = np.zeros(2), np.eye(2)
    result = hansen_j(g, A, np.eye(2), 10)
    assert (result.J, result.degrees, result.p_value) == (0.0, 0, 1.0)


def test_too_few_averages_are_told():
    assert np.isnan(hotelling_p_value(1.0, 9, 8))
    assert joint_averages(9, 128) == 27
    assert joint_averages(1, 128) == 8
    assert joint_averages(60, 100) == 50


def test_hotelling_is_its_f():
    assert hotelling_p_value(7.0, 3, 12) == pytest.approx(stats.f(3, 10).sf(7.0 * 10 / 36), rel=1e-9)
    assert hotelling_p_value(7.0, 3, None) == pytest.approx(stats.chi2(3).sf(7.0), rel=1e-9)


def test_block_cosines_are_orthonormal_and_leave_out_a_constant():
    C = cosine_averages(np.eye(40), 10)
    np.testing.assert_allclose(C @ C.T, 40 * np.eye(10), atol=1e-9)
    np.testing.assert_allclose(C.sum(axis=1), 0.0, atol=1e-9)
    rng = np.random.default_rng(0)
    sums = rng.standard_normal((40, 3))
    np.testing.assert_allclose(*(cosine_covariance([x], 40, 10) for x in (sums, sums + 5.0)), rtol=1e-9)


def compensated(seed, count=1000, memory=0.8, wrong=0.0):
    """Input with noise of variance .25 as its own instrument; `wrong` is added to the declared variance."""
    rng = np.random.default_rng(seed)
    u = data.autoregression(rng, (count + 5,), 0.9)
    noisy = u + 0.5 * rng.standard_normal(count + 5)
    y = 2.0 * u[5:] + data.autoregression(rng, (count,), memory)
    Z = np.column_stack([noisy[5 - lag : count + 5 - lag] for lag in range(6)])
    X = Z[:, :1]
    shared = np.zeros((6, 1))
    shared[0] = 0.25 + wrong
    A, b = Z.T @ X / count - shared, Z.T @ y / count
    theta = float(A[:, 0] @ b / (A[:, 0] @ A[:, 0]))
    residual = y - X[:, 0] * theta
    return equation_products(Z, X, residual, 128, shared=shared, constant=shared[:, 0] * theta)


def test_critical_values_of_products_beyond_all_numbers_are_unknown():
    """Noises that are estimated have columns of zeros, whose errors have no size: it overflowed."""
    critical = critical_values(np.stack([np.full((2, 2), np.inf), 1e200 * np.eye(2), np.eye(2)]))[1]
    np.testing.assert_allclose(critical, [np.nan, critical[2], critical[2]])


# Whiteness, memory and excitation: formulas written out, sizes, and known orders.


def test_whiteness_is_its_formulas():
    e = data.autoregression(np.random.default_rng(0), (70_000,), 0.3)  # longer than a block
    whiteness = residuals.residual_whiteness(e, 12)
    r = np.array([e[lag:] @ e[:-lag] for lag in range(1, 13)]) / (e @ e)
    np.testing.assert_allclose(whiteness.autocorrelation, r, rtol=1e-9)
    Q = e.size * (e.size + 2) * sum(r[lag - 1] ** 2 / (e.size - lag) for lag in range(1, 13))
    assert whiteness.ljung_box == pytest.approx(Q, rel=1e-9)
    assert whiteness.durbin_watson == pytest.approx(np.sum(np.diff(e) ** 2) / np.sum(e**2), rel=1e-9)
    assert whiteness.band == pytest.approx(stats.norm.ppf(0.975) / np.sqrt(e.size), rel=1e-9)
    assert whiteness.outside == int((np.abs(r) > whiteness.band).sum())


@pytest.mark.thorough
def test_statsmodels_ljung_box():
    diagnostic = pytest.importorskip("statsmodels.stats.diagnostic")
    e = data.autoregression(np.random.default_rng(1), (500,), 0.1)
    e -= e.mean()
    peer = diagnostic.acorr_ljungbox(e, lags=[20])
    whiteness = residuals.residual_whiteness(e)
    assert whiteness.ljung_box == pytest.approx(float(peer["lb_stat"].iloc[0]), rel=1e-6)
    assert whiteness.p_value == pytest.approx(float(peer["lb_pvalue"].iloc[0]), rel=1e-6)


def test_a_residual_of_zeros_or_of_few_samples_is_white():
    assert residuals.residual_whiteness(np.zeros(100)).p_value == 1.0
    assert residuals.residual_whiteness(np.zeros(100)).durbin_watson == 2.0
    assert residuals.residual_whiteness(np.array([1.0, -1.0, 1.0])).autocorrelation.size == 1


@pytest.mark.parametrize("memory", [0.0, 0.3, 0.45])
def test_memory_of_a_long_record_is_found_from_its_means(memory):
    """Fractional noises of 40,000 samples, averaged five to one: the error is the one that is told."""
    runs, z = 60, []
    for seed in range(runs):
        white = np.random.default_rng(seed).standard_normal(5 * residuals.LONGEST)
        result = residuals.residual_memory(np.asarray(fractional_difference(white, -memory)))
        z.append((result.memory - memory) / result.order_error)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(runs) + 0.3  # the noise starts with its record, hence the .3
    assert 0.6 < np.std(z) < 1.4


def test_memory_needs_a_record():
    assert residuals.residual_memory(np.zeros(1000)) is None
    assert residuals.residual_memory(np.ones(1000) * 3.3) is None
    assert residuals.residual_memory(np.arange(16.0)) is None


def test_where_the_input_is_below_the_residual():
    """A sine lifts its own band above the residual and no other."""
    count, rate = 8192, 10.0
    t = np.arange(count) / rate
    swing, residual = np.sin(2.0 * np.pi * 0.5 * t), np.random.default_rng(4).standard_normal(count)
    power = excitation.band_power([swing], [1.0], residual, rate, [float(swing @ swing)])
    inside = (power.low_hz <= 0.5) & (power.high_hz >= 0.5)
    np.testing.assert_array_equal(power.input_power[:, 0] > power.residual_power, inside)
    assert power.share_above[0] > 0.99


def tenths(count):
    """Stretches of ten rows each."""
    return tuple((10 * k, 10 * k + 10) for k in range(count))


def scores_of(seed, count=2560, memory=0.0, change=0.0, nuisances=0.6):
    """Least squares of y on two columns, the first one's parameter changing; scores, M, and the rows."""
    rng = np.random.default_rng(seed)
    X = data.autoregression(rng, (count, 2), memory)
    slope = np.where(np.arange(count) < nuisances * count, 1.0, 1.0 + change)
    y = slope * X[:, 0] - 0.5 * X[:, 1] + data.autoregression(rng, (count,), memory)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    return X * (y - X @ theta)[:, None], X.T @ X, X, y


def constancy_of(seed, **circumstances):
    scores, M, *_ = scores_of(seed, **circumstances)
    return residuals.constancy(residuals.influences(scores.reshape(128, -1, 2).sum(axis=1), M))


def test_wald_path_is_its_formula():
    groups = np.random.default_rng(0).standard_normal((residuals.GROUPS, 2)) @ [[1.0, 0.3], [0.0, 2.0]]
    path = residuals.wald_path(*residuals.sides(groups))
    assert path.size == residuals.GROUPS - 20 + 1
    for k in (10, 31, 54):
        S = np.zeros((2, 2))
        for side in (groups[:k], groups[k:]):
            size = len(side)
            L = (
                np.sqrt(2.0 / size)
                * np.cos(np.pi * np.outer(range(1, 7), np.arange(size) + 0.5) / size)
                @ side
            )
            S += L.T @ L / 12.0
        difference = groups[:k].mean(axis=0) - groups[k:].mean(axis=0)
        W = difference @ np.linalg.solve(S * (1.0 / k + 1.0 / (residuals.GROUPS - k)), difference)
        assert path[k - 10] == pytest.approx(W * (12 - 2 + 1) / (12 * 2), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("unknowns", [1, 2, 3, 6])
def test_table_is_what_the_simulation_draws(unknowns):
    """Shares of a fresh simulation beyond each quantile, within their binomial error."""
    runs = 3000
    rng = np.random.default_rng(100 + unknowns)
    drawn = rng.standard_normal((runs, residuals.GROUPS, unknowns))
    suprema = np.array([residuals.wald_path(*residuals.sides(groups)).max() for groups in drawn])
    for tail, quantile in zip(residuals.TAILS[:6], residuals.QUANTILES[unknowns], strict=False):
        low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, tail)
        assert low <= np.sum(suprema > quantile) <= high
        assert residuals.p_value(quantile, unknowns) == pytest.approx(tail)
    assert residuals.p_value(1e9, unknowns) == pytest.approx(0.001)
    assert residuals.p_value(0.0, unknowns) == pytest.approx(0.5)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_size_with_constant_parameters(memory):
    runs = 600
    results = [constancy_of(seed, memory=memory) for seed in range(runs)]
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.06])
    assert low <= sum(result.p_value < 0.05 for result in results) <= high
    for j in (0, 1):
        assert low <= sum(result.p_values[j] < 0.05 for result in results) <= high


def test_a_change_is_found_where_and_what_it_is():
    results = [constancy_of(seed, change=0.5, memory=0.5) for seed in range(60)]
    assert sum(result.p_value < 0.05 for result in results) > 50
    assert np.median([result.break_at for result in results]) == pytest.approx(0.6, abs=0.02)
    changes = np.array([result.change for result in results])
    error = changes.std(axis=0) / np.sqrt(len(results))
    np.testing.assert_array_less(np.abs(changes.mean(axis=0) - [0.5, 0.0]), 4.0 * error + 0.03)
    # power does not fall as the change grows: either side has a covariance of its own
    assert sum(constancy_of(seed, change=5.0, memory=0.5).p_value < 0.05 for seed in range(60)) == 60


def test_scores_of_zero_are_constant():
    assert residuals.constancy(np.zeros((64, 2))).p_value == pytest.approx(0.5)


def test_leverage_is_the_estimate_without_the_stretch():
    scores, _, X, y = scores_of(4)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    sums = scores.reshape(10, -1, 2).sum(axis=1)
    current = np.einsum("kti,ktj->kij", X.reshape(10, -1, 2), X.reshape(10, -1, 2))
    leverage = residuals.segment_leverage(sums, current, np.array([0.1, 0.2]), tenths(len(sums)))
    for k in range(10):
        rest = np.ones(len(y), dtype=bool)
        rest[k * 256 : (k + 1) * 256] = False
        again = np.linalg.lstsq(X[rest], y[rest], rcond=None)[0]
        np.testing.assert_allclose(leverage.shift[k], again - theta, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(leverage.in_std_errors, leverage.shift / [0.1, 0.2])
    most = np.argmax(np.abs(leverage.in_std_errors), axis=0)
    np.testing.assert_array_equal(leverage.most, most)
    np.testing.assert_allclose(leverage.largest, leverage.in_std_errors[most, [0, 1]])


STEP = 0.05
BLOCKS = 128
SUBJECT = Subject(("slope", "other"), np.ones(2), str, 2560)


def found_of(seed, *, slope=0.0, pushed=0.0, period=5.0, memory=0.5, count=2560, gap=False):
    """Least squares of y on two columns and a constant; the first one's parameter, or a push, swings."""
    rng = np.random.default_rng(seed)
    X = np.column_stack([data.autoregression(rng, (count, 2), 0.95), np.ones(count)])
    times = STEP * (np.arange(count) + (np.arange(count) > count // 3) * 333 * gap)
    swing = np.cos(2.0 * np.pi * times / period + 1.0)
    y = (1.0 + slope * swing) * X[:, 0] - 0.5 * X[:, 1] + pushed * swing
    y += data.autoregression(rng, (count,), memory)
    residual = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    sums = (X[:, :2] * residual[:, None]).reshape(BLOCKS, -1, 2).sum(axis=1)
    made = residuals.influences(sums, X[:, :2].T @ X[:, :2])
    counts = np.full(BLOCKS, count / BLOCKS)
    of_parameters = excitation.block_sums(made, counts, times, STEP)
    return excitation.Periodicity(
        excitation.strongest_swings(of_parameters, (("slope", "N/m"), ("other", ""))),
        excitation.strongest_swings(
            excitation.blocks_of(residual, times, STEP, BLOCKS), (("push", "N"),), 1.0 / count
        ),
        "s",
        1.0 / of_parameters.span,
    )


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize(("what", "of"), [("slope", "slope"), ("pushed", "push")])
def test_what_swings_is_named_with_period_and_amplitude(what, of, gap):
    for seed in range(5):
        result = found_of(seed, gap=gap, **{what: 0.8})
        assert result.speaks
        assert result.strongest.of == of
        assert result.strongest.period == pytest.approx(5.0, rel=0.03)
        assert result.strongest.amplitude == pytest.approx(0.8, rel=0.35)


def test_a_parameter_that_pushes_too_is_the_one_that_varies():
    result = found_of(1, slope=0.8, pushed=1.0)
    assert min(result.tested, key=lambda item: item.p_value).of == "push"
    assert result.strongest.of == "slope"


def test_sentences_have_number_unit_and_period():
    parameter, push = found_of(1, slope=0.8), found_of(1, pushed=0.8)
    (weak,), (reported,) = list(parameter.reasons(SUBJECT)), list(push.reasons(SUBJECT))
    assert weak.status is Status.WEAK
    assert weak.sentence.startswith(f"slope varies by {parameter.strongest.extent} with a period of ")
    assert parameter.strongest.extent.endswith(" N/m")
    assert reported.status is Status.IDENTIFIED
    assert f"swings by {push.strongest.extent} with a period of" in reported.sentence
    assert not list(found_of(1).reasons(SUBJECT))
    assert [row.of for row in push.rows(SUBJECT)] == ["", *2 * ["slope"], *2 * ["other"], *2 * ["push"]]
    assert "most likely push by" in next(iter(push.rows(SUBJECT))).line


def test_few_blocks_and_no_power_say_nothing():
    few = excitation.blocks_of(np.ones(31), STEP * np.arange(31), STEP, 31)
    assert excitation.strongest_swings(few, (("a", ""),)) == ()
    still = excitation.blocks_of(np.ones(640), STEP * np.arange(640), STEP, 64)
    assert excitation.strongest_swings(still, (("a", ""),))[0].p_value == 1.0
