"""The actuator's state against an independent integration and the exact solution between changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim
from scipy.spatial.transform import Rotation

from eivor.signals.channels import roll_pitch_yaw
from eivor.signals.filters import actuator_state, low_passed, reciprocal, time_derivative
from eivor.signals.noise import fractional_weights

STEP_S = 0.01


def exact_state(command, lag_s, delay_s):
    """State at the samples, by the exponential between the times at which the delayed command changes."""
    state = command[0]
    states = [state]
    for k in range(1, command.size):
        start, end = (k - 1) * STEP_S, k * STEP_S
        changes = np.arange(command.size) * STEP_S + delay_s
        inside = changes[(changes > start + 1e-12) & (changes < end - 1e-12)]
        edges = np.concatenate([[start], inside, [end]])
        for begin, finish in pairwise(edges):
            index = int(np.floor((0.5 * (begin + finish) - delay_s) / STEP_S))
            held = command[max(index, 0)]
            state = held + (state - held) * np.exp(-(finish - begin) / lag_s)
        states.append(state)
    return np.array(states)


@settings(max_examples=60)
@given(lag_s=st.floats(1e-3, 0.5), delay_s=st.floats(0.0, 0.06), seed=st.integers(0, 10_000))
def test_state_is_exact_for_any_lag_and_any_fraction_of_a_delay(lag_s, delay_s, seed):
    command = np.random.default_rng(seed).standard_normal(25)
    result = actuator_state(command[:, None], step_s=STEP_S, lag_s=lag_s, delay_s=delay_s)[:, 0]
    np.testing.assert_allclose(result, exact_state(command, lag_s, delay_s), atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 64, 500])
def test_an_inverse_filter_solves_the_recursion(count):
    weights = 5.0 * fractional_weights(0.7, count)
    weights[0] += 1.0
    solved = np.zeros(count)
    for k in range(count):
        solved[k] = ((k == 0) - weights[1 : k + 1] @ solved[:k][::-1]) / weights[0]
    assert reciprocal(weights) == pytest.approx(solved, abs=1e-15)


def test_polynomials_of_degree_six_are_exact_inside():
    time = STEP_S * np.arange(40)
    derivative = time_derivative(time**6 - 3.0 * time**5 + time, STEP_S)
    exact = 6.0 * time**5 - 15.0 * time**4 + 1.0
    np.testing.assert_allclose(derivative[3:-3], exact[3:-3], rtol=1e-9)
    np.testing.assert_allclose(derivative, exact, atol=0.05)


def test_short_series_have_a_derivative_too():
    np.testing.assert_allclose(time_derivative(np.array([1.0, 2.0, 3.0]), 0.5), [2.0, 2.0, 2.0])


@pytest.mark.parametrize(("step_s", "cutoff_hz"), [(0.002, 80.0), (0.01, 80.0), (0.005, 30.0)])
def test_lines_between_samples_are_filtered_exactly_also_beyond_half_the_grids_rate(step_s, cutoff_hz):
    time = step_s * np.arange(300)
    series = np.cos(2.0 * np.pi * 3.0 * time) + time
    omega = 2.0 * np.pi * cutoff_hz
    # from rest, so that the constant that the filter has seen for ever is taken off
    _, expected, _ = lsim(([omega**2], [1.0, np.sqrt(2.0) * omega, omega**2]), series - series[0], time)
    result = low_passed(series[:, None], step_s=step_s, cutoff_hz=cutoff_hz)[:, 0]
    np.testing.assert_allclose(result, expected + series[0], atol=1e-12)


def test_angles_are_those_of_successive_turns_and_yaw_goes_on():
    count = 50
    angles = np.stack(
        [np.linspace(-1.0, 1.2, count), np.linspace(0.8, -1.1, count), np.linspace(-2.0, 9.0, count)]
    )
    quaternions = Rotation.from_euler("ZYX", angles[::-1].T).as_quat(scalar_first=True).T
    quaternions[:, ::7] *= -1.0  # the same attitudes
    np.testing.assert_allclose(roll_pitch_yaw(quaternions), angles, atol=1e-12)


def test_what_is_missing_stays_missing():
    quaternions = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), 3)
    quaternions[2, 1] = np.nan
    np.testing.assert_array_equal(np.isnan(roll_pitch_yaw(quaternions)), [[False, True, False]] * 3)
