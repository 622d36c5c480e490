"""Strength of instruments against linearmodels, ivreg2 and published critical values; its calibration."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import optimize, stats

from eivor.inference.diagnostics.instruments import critical_value, strength
from eivor.inference.diagnostics.record import (
    conditional_first_stage,
    equation_products,
    first_stage_of_products,
    orthonormal_basis,
)

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


def test_critical_value_is_the_quantile_of_a_noncentral_chi_square():
    W = np.diag([1.0, 2.0, 5.0])
    x = 10.0
    K = 64.0 * 21.0 / (30.0 + 2.0 * x * 8.0 * 5.0)
    assert critical_value(W) == pytest.approx(stats.ncx2.ppf(0.95, K, x * K) / K, rel=1e-6)


def test_white_f_is_that_from_rows():
    Z, X = drawn(5)
    wanted = conditional_first_stage(orthonormal_basis(Z), X)
    np.testing.assert_allclose(strength_of(Z, X).conditional, wanted, rtol=1e-6)


def test_smallest_eigenvalue_is_the_least_f_of_a_combination():
    """Both forms are the minimum over directions of a ratio that is worked out here from rows."""
    Z, X = drawn(6, memory=0.7)
    result = strength_of(Z, X)
    Q = np.linalg.qr(Z)[0] * np.sqrt(len(Z))
    V = X - Q @ (Q.T @ X) / len(Z)
    edges = (np.arange(101) * 600) // 100
    cosines = np.sqrt(2.0) * np.cos(
        np.pi / 100 * np.outer(np.arange(1, result.averages + 1), np.arange(100) + 0.5)
    )

    def ratio(angle):
        d = np.array([np.cos(angle), np.sin(angle)])
        scores = np.add.reduceat(Q * (V @ d)[:, None], edges[:-1], axis=0)
        trace = np.sum((cosines @ scores) ** 2) / result.averages / len(Z)
        return np.sum((Q.T @ (X @ d)) ** 2) / len(Z) / trace

    def white(angle):
        d = np.array([np.cos(angle), np.sin(angle)])
        return np.sum((Q.T @ (X @ d)) ** 2) / len(Z) / 5 / (np.sum((V @ d) ** 2) / (len(Z) - 5))

    for statistic, function in ((result.smallest_eigenvalue, ratio), (result.cragg_donald, white)):
        grid = np.linspace(0.0, np.pi, 400)
        near = grid[np.argmin([function(angle) for angle in grid])]
        least = optimize.minimize_scalar(function, bounds=(near - 0.01, near + 0.01), method="bounded").fun
        assert statistic == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("units", [1e-6, 1e6])
def test_units_and_combinations_of_instruments_do_not_count(units):
    Z, X = drawn(7, memory=0.5)
    mix = np.random.default_rng(2).standard_normal((5, 5)) + 2.0 * np.eye(5)
    item, other = strength_of(Z, X), strength_of(units * Z @ mix, X * np.array([1.0, units]))
    for name in (
        "effective",
        "critical",
        "conditional",
        "shea_r_squared",
        "cragg_donald",
        "smallest_eigenvalue",
    ):
        np.testing.assert_allclose(getattr(item, name), getattr(other, name), rtol=1e-6)


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
