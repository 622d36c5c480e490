"""LS against instruments: Durbin and Wu-Hausman of linearmodels; size and power of the robust test."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.diagnostics.instruments import endogeneity
from eivor.inference.diagnostics.record import EquationProducts, equation_products

linearmodels = pytest.importorskip("linearmodels")


def two_stage_weights(products: EquationProducts) -> np.ndarray:
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


def test_difference_is_that_of_the_two_estimates():
    housing = data.housing()
    theta, X, *_ = data.two_stage(*housing)
    least_squares = np.linalg.lstsq(X, housing[0], rcond=None)[0]
    np.testing.assert_allclose(endogeneity_of(housing).difference, theta - least_squares, rtol=1e-6)


def test_covariance_is_that_of_the_difference_of_influence_functions():
    """The statistic from the difference of both estimates and of their influence functions, row by row."""
    y, endogenous, exogenous, excluded = drawn(0, 0.3, 640)
    products = data.products_of(y, endogenous, exogenous, excluded, 128)
    result = endogeneity(products, two_stage_weights(products))
    theta, X, Z, _ = data.two_stage(y, endogenous, exogenous, excluded)
    least_squares = np.linalg.lstsq(X, y, rcond=None)[0]
    fitted = Z @ np.linalg.lstsq(Z, X, rcond=None)[0]
    e_ls = y - X @ least_squares
    # under the hypothesis both errors are one; least squares' own is what its influence is made of
    influence = np.linalg.solve(fitted.T @ X, (fitted * e_ls[:, None]).T) - np.linalg.solve(
        X.T @ X, (X * e_ls[:, None]).T
    )
    sums = influence.T.reshape(128, 5, -1).sum(axis=1)[:, :1]
    cosines = np.cos(np.pi / 128 * np.outer(np.arange(1, result.averages + 1), np.arange(128) + 0.5))
    variance = 2.0 * np.sum((cosines @ sums) ** 2) / result.averages
    assert result.statistic == pytest.approx((theta - least_squares)[0] ** 2 / variance, rel=1e-6)


def drawn(seed, endogenous=0.0, count=800, memory=0.8):
    rng = np.random.default_rng(seed)
    e = data.autoregression(rng, (count,), memory)
    Z = data.autoregression(rng, (count, 3), memory)
    x = Z @ [0.5, 0.3, -0.4] + endogenous * e + data.autoregression(rng, (count,), memory)
    return x + e, x[:, None], np.ones((count, 1)), Z


@pytest.mark.calibration
def test_size_and_power_in_autocorrelated_data():
    runs = 600
    under = [endogeneity_of(drawn(seed), 128) for seed in range(runs)]
    robust = sum(test.p_value < 0.05 for test in under)
    white = sum(test.durbin_p_value < 0.05 for test in under)
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.065])
    assert low <= robust <= high
    assert white > 2 * high  # what the homoskedastic forms do here
    assert sum(endogeneity_of(drawn(seed, 0.8), 128).p_value < 0.05 for seed in range(100)) > 80


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


def test_least_squares_is_not_compared_with_itself():
    X = np.random.default_rng(0).standard_normal((400, 2))
    products = equation_products(instruments=X, jacobian=X, residual=np.ones(400), blocks=50)
    assert endogeneity(products, np.eye(2)) is None


@pytest.mark.parametrize("units", [1e-6, 1e6])
def test_units_do_not_count(units):
    y, endogenous, exogenous, excluded = drawn(4)
    item = endogeneity_of((y, endogenous, exogenous, excluded))
    other = endogeneity_of((y / units, units * endogenous, exogenous, excluded))
    assert item.statistic == pytest.approx(other.statistic, rel=1e-6)
    assert item.durbin == pytest.approx(other.durbin, rel=1e-6)
