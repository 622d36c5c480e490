"""Kernels, bandwidths and fixed-b critical values: explicit sums, published formulas, simulations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linearmodels.shared.covariance import cov_kernel
from scipy.signal import lfilter

from eivor.errors import UsageError
from eivor.inference.covariance import fixed_b_reference
from eivor.inference.distributions import t_quantile
from eivor.inference.kernel import (
    AndrewsRule,
    Bartlett,
    FixedBandwidth,
    NeweyWestRule,
    Parzen,
    QuadraticSpectral,
    SquareRootRule,
    kernel_sum_covariance,
)

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


def test_quadratic_spectral_kernel_is_smooth_at_zero():
    x = np.array([0.0, 1e-9, 2.6e-4, 2.7e-4])
    weights = QuadraticSpectral().weights(x)
    np.testing.assert_allclose(weights, 1.0 - (1.2 * np.pi * x) ** 2 / 10.0, atol=1e-9)


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


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
@pytest.mark.parametrize("b", [0.05, 0.2])
def test_fixed_b_moments_are_those_of_the_kernel_on_a_bridge(kernel, b):
    """Share and degrees follow from the mean and variance of Q over simulated bridges."""
    runs, count = 4000, 400
    steps = np.random.default_rng(3).standard_normal((runs, count))
    centred = steps - steps.mean(axis=1, keepdims=True)
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    Q = np.einsum("ri,ij,rj->r", centred, kernel.weights(lag / (b * count)), centred, optimize=True) / count
    expected_degrees, share = fixed_b_reference(kernel, b)
    assert abs(Q.mean() - share) < 4.0 * Q.std() / np.sqrt(runs) + 1.0 / count
    degrees = 2.0 * Q.mean() ** 2 / Q.var()
    # The variance of a skewed variable: allow four standard errors of a generous kurtosis.
    assert degrees == pytest.approx(expected_degrees, rel=4.0 * np.sqrt(8.0 / runs))
