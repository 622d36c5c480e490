"""Strength of instruments against linearmodels, ivreg2 and published critical values; its calibration."""

from __future__ import annotations

import itertools

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.covariance import cosine_averages
from eivor.inference.diagnostics.instruments import critical_value, endogeneity, hansen_j, strength
from eivor.inference.diagnostics.record import (
    conditional_first_stage,
    covariance_of_total,
    equation_products,
    first_stage_of_products,
    hotelling_p_value,
    joint_averages,
    orthonormal_basis,
)
from eivor.inference.kernel import Bartlett, Parzen, QuadraticSpectral, kernel_sum_covariance
from eivor.inference.verdict import Reason, Status, verdict
from reference import constants as truth

linearmodels = pytest.importorskip("linearmodels")


def drawn(seed, count=600, memory=0.0, strength=0.2, columns=2, instruments=5):
    rng = np.random.default_rng(seed)
    Z = data.autoregression(rng, (count, instruments), memory)
    V = data.autoregression(rng, (count, columns), memory)
    pi = np.random.default_rng(1).standard_normal((instruments, columns))
    return Z, strength * Z @ pi + V


def strength_of(Z, X, blocks=100, **compensation):
    products = equation_products(
        instruments=Z, jacobian=X, residual=np.ones(X.shape[0]), blocks=blocks, **compensation
    )
    return strength(products)


def test_linearmodels_first_stage():
    y, endogenous, exogenous, excluded = data.housing()
    peer = linearmodels.IV2SLS(y, exogenous, endogenous, excluded).fit(cov_type="unadjusted", debiased=True)
    reported = peer.first_stage.diagnostics.iloc[0]
    result = strength(data.products_of(y, endogenous, exogenous, excluded))
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
    result = strength(data.products_of(y, X, exogenous, Z, 100))
    np.testing.assert_allclose(result.shea_r_squared[:2], peer["shea.rsquared"].to_numpy(), rtol=1e-6)


def test_published_cragg_donald_of_griliches():
    """ivreg2 prints 12.5516 and a coefficient of schooling of .17242531."""
    griliches = data.griliches()
    if griliches is None:
        pytest.skip("statsmodels, which ships griliches76.dta, is not installed")
    theta, *_ = data.two_stage(*griliches)
    assert theta[0] == pytest.approx(0.17242531, abs=5e-9)
    assert strength(data.products_of(*griliches, 379)).cragg_donald == pytest.approx(12.5516, abs=5e-5)


@pytest.mark.parametrize(("bias", "published"), [(0.05, 37.418), (0.1, 23.109), (0.2, 15.062)])
def test_published_critical_values(bias, published):
    """Montiel Olea and Pflueger's, one instrument, as their `weakivtest` prints them."""
    assert critical_value(np.array([[3.7]]), bias) == pytest.approx(published, abs=5e-4)


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
    np.testing.assert_allclose(
        first_stage_of_products(*moments)[1], conditional_first_stage(orthonormal_basis(Z), X)[1], rtol=1e-6
    )
    # what the noise itself contributes is no longer counted
    assert (compensated < 0.5 * first_stage_of_products(*moments)).all()


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


def two_stage_weights(products):
    return np.linalg.solve(products.instrument_mean, products.sensitivity)


def endogeneity_of(result, blocks=25):
    products = data.products_of(*result, blocks)
    return endogeneity(products, two_stage_weights(products))


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
            instruments=Psi,
            jacobian=X,
            residual=y - X[:, 0] * theta,
            blocks=128,
            shared=shared,
            constant=shared[:, 0] * theta,
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
    peer = linearmodels.IVGMM(
        y, exogenous, endogenous, excluded, weight_type="kernel", kernel=name, bandwidth=bandwidth
    ).fit(iter_limit=2)
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
    np.testing.assert_allclose(covariance_of_total(sums, 10), covariance_of_total(sums + 5.0, 10), rtol=1e-9)


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
    return equation_products(
        instruments=Z,
        jacobian=X,
        residual=y - X[:, 0] * theta,
        blocks=128,
        shared=shared,
        constant=shared[:, 0] * theta,
    )


def test_critical_values_of_products_beyond_all_numbers_are_unknown():
    """Noises that are estimated have columns of zeros, whose errors have no size: it overflowed."""
    assert np.isnan(critical_value(np.full((2, 2), np.inf)))
    assert critical_value(1e200 * np.eye(2)) == pytest.approx(critical_value(np.eye(2)))
