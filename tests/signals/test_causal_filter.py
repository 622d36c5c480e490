"""Causal filters by FFT against sums term by term."""

import numpy as np
import pytest
from cost import in_transforms

from eivor.signals.filters import filtered, in_a_row, reciprocal
from eivor.signals.noise import fractional_weights, order_slope


@pytest.mark.parametrize("length", [1, 3, 40, 90])
def test_a_filter_is_its_sum(length):
    rng = np.random.default_rng(0)
    weights, values = rng.standard_normal(length), rng.standard_normal(60)
    direct = np.convolve(weights, values)[:60]
    assert filtered(weights, values) == pytest.approx(direct, abs=1e-12)
    assert in_a_row(values, weights[:40]) == pytest.approx(np.convolve(weights[:40], values)[:60], abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 64, 500])
def test_an_inverse_filter_solves_the_recursion(count):
    weights = 5.0 * fractional_weights(0.7, count)
    weights[0] += 1.0
    solved = np.zeros(count)
    for k in range(count):
        solved[k] = ((k == 0) - weights[1 : k + 1] @ solved[:k][::-1]) / weights[0]
    assert reciprocal(weights) == pytest.approx(solved, abs=1e-15)


def test_the_inverse_of_a_difference_is_the_sum():
    assert reciprocal(fractional_weights(0.4, 3000)) == pytest.approx(
        fractional_weights(-0.4, 3000), abs=1e-13
    )


def test_an_inverse_filter_costs_a_few_transforms_more_for_twice_the_record():
    costs = []
    for size in (1 << 14, 1 << 17):
        weights = fractional_weights(0.7, size)
        weights[0] += 1.0
        costs.append(in_transforms(lambda weights=weights: reciprocal(weights), size))
    assert (
        costs[1] < 3.0 * costs[0]
    )  # eight times the record: a quadratic one would cost 8 times more of them


@pytest.mark.parametrize("order", [-0.5, 0.0, 0.3, 1.0, 2.0, 1.7])
def test_slopes_of_weights_are_their_derivatives(order):
    step = 1e-6
    numeric = (fractional_weights(order + step, 200) - fractional_weights(order - step, 200)) / (2.0 * step)
    assert order_slope(order, 200) == pytest.approx(numeric, abs=1e-8)
