"""Rates of change of sampled series."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.signals.filters import time_derivative

STEP_S = 0.01


def test_polynomials_of_degree_six_are_exact_inside():
    time = STEP_S * np.arange(40)
    derivative = time_derivative(time**6 - 3.0 * time**5 + time, STEP_S)
    exact = 6.0 * time**5 - 15.0 * time**4 + 1.0
    np.testing.assert_allclose(derivative[3:-3], exact[3:-3], rtol=1e-9)
    np.testing.assert_allclose(derivative, exact, atol=0.05)


def test_amplitudes_hold_up_to_the_band_where_a_simple_difference_loses_four_percent():
    time, omega = STEP_S * np.arange(400), 2.0 * np.pi * 8.0
    result = time_derivative(np.sin(omega * time), STEP_S)[10:-10]
    exact = omega * np.cos(omega * time)[10:-10]
    assert float(result @ exact) / float(exact @ exact) == pytest.approx(1.0, abs=1e-3)


def test_short_series_have_a_derivative_too():
    np.testing.assert_allclose(time_derivative(np.array([1.0, 2.0, 3.0]), 0.5), [2.0, 2.0, 2.0])
