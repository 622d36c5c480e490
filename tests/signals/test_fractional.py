"""Fractional differences against direct summation and against their own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from cost import in_transforms
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import binom

from eivor.signals.noise import fractional_difference, fractional_weights


@given(order=st.floats(-2.0, 2.0), count=st.integers(1, 60), seed=st.integers(0, 1000))
def test_fft_is_the_direct_sum(order, count, seed):
    values = np.random.default_rng(seed).standard_normal((count, 2))
    weights = fractional_weights(order, count)
    direct = np.stack([np.convolve(weights, column)[:count] for column in values.T], axis=1)
    scale = 1.0 + np.abs(direct).max()
    np.testing.assert_allclose(
        fractional_difference(values, order), direct, rtol=0.0, atol=1e-13 * count * scale
    )


@pytest.mark.parametrize("order", [-1.3, -0.5, 0.25, 0.5, 1.7])
def test_weights_are_signed_binomials(order):
    lags = np.arange(20)
    np.testing.assert_allclose(fractional_weights(order, 20), (-1.0) ** lags * binom(order, lags), rtol=1e-10)


def test_integer_orders_are_differences_and_sums_with_zeros_before():
    values = np.random.default_rng(1).standard_normal(30)
    np.testing.assert_allclose(fractional_difference(values, 0.0), values, atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, 1.0), np.diff(values, prepend=0.0), atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, -1.0), np.cumsum(values), atol=1e-12)


@pytest.mark.thorough
def test_a_million_samples_take_as_long_as_a_few_transforms():
    """About four; direct summation takes as long as a hundred thousand. One is 0.04 s."""
    values = np.random.default_rng(3).standard_normal(999_983)  # a prime: the FFT's worst case
    difference = fractional_difference(values, -0.5)
    assert in_transforms(lambda: fractional_difference(values, -0.5), values.size) < 15.0
    # The last sample, by direct summation over the whole record.
    direct = fractional_weights(-0.5, values.size) @ values[::-1]
    assert difference[-1] == pytest.approx(direct, rel=1e-10)
