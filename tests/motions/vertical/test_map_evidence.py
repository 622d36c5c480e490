"""Intercept and bend of the thrust curve together say whether the input map fits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from eivor.flights.prepared import Difference
from eivor.motions.vertical.motion import beyond, fitting_p_value, least_in_set


def bend(value: float) -> Difference:
    """So many standard errors of a bend."""
    return Difference(value, 1.0)


def test_without_an_intercept_beyond_the_bound_the_map_fits():
    assert fitting_p_value(0.0, 0.3, bend(-20.0)) == 1.0


def test_the_intercept_alone_is_held_against_one_side_and_the_bend_that_is_not_there():
    index = 4.2306  # where half of chi-square with one degree and a quarter of that with two leave .05
    assert fitting_p_value(index, 1.0, None) == pytest.approx(0.05, abs=1e-4)
    assert fitting_p_value(index, 1.0, bend(5.0)) == fitting_p_value(index, 1.0, None)
    assert fitting_p_value(index, -1.0, bend(-5.0)) == fitting_p_value(index, 1.0, None)


def test_a_bend_to_the_side_of_the_intercept_counts_as_much_as_its_p_value_says():
    half = bend(-2.0)
    z = stats.norm.isf(0.5 * half.p_value)
    assert fitting_p_value(1.0, 1.0, half) == pytest.approx(fitting_p_value(1.0 + z**2, 1.0, None))
    assert fitting_p_value(1.0, -1.0, bend(2.0)) == pytest.approx(fitting_p_value(1.0, 1.0, half))
    assert fitting_p_value(1.0, 1.0, bend(-1e9)) == 0.0


def test_delays_that_fit_less_well_count_as_far_as_their_criterion_is_above_the_least():
    values, halves, excesses = np.array([0.9, 0.3, 0.7]), np.full(3, 0.1), np.array([0.0, 12.0, 1.0])
    assert beyond(values, halves, excesses) == pytest.approx(12.0)  # the second leaves what a map may
    assert fitting_p_value(12.0, 0.9, None) < 0.01
    assert beyond(values[[0, 2]], halves[:2], excesses[[0, 2]]) == pytest.approx(1.0 + 9.0 * 3.8415, rel=1e-4)
    assert least_in_set(values, halves, excesses) == pytest.approx(0.7 - 0.1 * np.sqrt(1.0 - 1.0 / 3.8415))
    assert least_in_set(-values, halves, excesses) == least_in_set(values, halves, excesses)


def test_what_is_known_without_noise_is_held_against_the_bound_and_what_is_not_known_says_nothing():
    exact = np.array([0.0])
    assert fitting_p_value(beyond(np.array([0.5]), exact, exact), 0.5, None) == 0.0
    assert fitting_p_value(beyond(np.array([np.nan]), exact, exact), np.nan, None) == 1.0


def test_at_the_edge_of_what_fits_one_map_in_twenty_is_called_wrong():
    """Both distances are normal; the bend's is that of a t with its degrees of freedom."""
    rng = np.random.default_rng(3)
    intercepts, bends = rng.standard_normal(4000), rng.standard_t(16, 4000)
    called = [
        fitting_p_value(max(b, 0.0) ** 2, 0.4 + b, bend(c)) < 0.05
        for b, c in zip(intercepts.tolist(), bends.tolist(), strict=True)
    ]
    assert np.mean(called) <= 0.055
