"""Hansen's J against Stata and linearmodels, by the two-step route, and its size in autocorrelated data."""

from __future__ import annotations

from dataclasses import replace

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.covariance import cosine_averages
from eivor.inference.diagnostics.instruments import hansen_j, robust_over_identification
from eivor.inference.diagnostics.record import (
    covariance_of_total,
    equation_products,
    hotelling_p_value,
    joint_averages,
)
from eivor.inference.kernel import Bartlett, Parzen, QuadraticSpectral, kernel_sum_covariance
from reference import constants as truth

linearmodels = pytest.importorskip("linearmodels")


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


def test_it_is_the_minimum_whatever_the_estimate():
    """The least value of the weighted equations, found by solving for it; the same from any theta."""
    scores, A, count, _ = parts(data.housing())
    S = scores.T @ scores / count
    g = scores.mean(axis=0)
    for step in (np.zeros(3), np.array([1e-3, 0.2, -3.0])):
        here = g - A @ step
        weighted = np.linalg.solve(np.linalg.cholesky(S), np.column_stack([A, here]))
        left = np.linalg.lstsq(weighted[:, :-1], weighted[:, -1], rcond=None)[1]
        assert pytest.approx(count * float(left[0]), rel=1e-6) == hansen_j(here, A, S, count).J


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


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_size_of_compensated_equations(memory):
    runs = 800
    rejected = sum(
        robust_over_identification(compensated(s, memory=memory)).p_value < 0.05 for s in range(runs)
    )
    assert stats.binom.ppf(1e-4, runs, 0.05) <= rejected <= stats.binom.ppf(1.0 - 1e-4, runs, 0.065)


def test_wrong_noise_is_noticed():
    runs = 100
    rejected = sum(robust_over_identification(compensated(s, wrong=0.25)).p_value < 0.05 for s in range(runs))
    assert rejected > 80


def test_units_do_not_count():
    products = compensated(3)
    psi, G, e = np.array([1e-6, 1.0, 1e6, 3.0, 1.0, 0.1]), np.full(products.cross.shape[2], 1e4), 1e-3
    unit = np.concatenate([psi, G, [e]])
    sums, shared = products.sums * np.outer(unit, unit), products.shared * np.outer(psi, G)
    turned = replace(products, sums=sums, shared=shared, constant=products.constant * psi * e)
    assert (
        pytest.approx(robust_over_identification(products).J, rel=1e-6)
        == robust_over_identification(turned).J
    )
