"""The actuator's state against an independent integration and the exact solution between changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from eivor.signals.filters import actuator_state, delayed_by, first_order_lag

STEP_S = 0.01


def exact_state(command: np.ndarray, lag_s: float, delay_s: float) -> np.ndarray:
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
@given(
    lag_s=st.floats(1e-3, 0.5),
    delay_s=st.floats(0.0, 0.06),
    seed=st.integers(0, 10_000),
)
def test_state_is_exact_for_any_lag_and_any_fraction_of_a_delay(lag_s, delay_s, seed):
    command = np.random.default_rng(seed).standard_normal(25)
    result = actuator_state(command[:, None], step_s=STEP_S, lag_s=lag_s, delay_s=delay_s)[:, 0]
    np.testing.assert_allclose(result, exact_state(command, lag_s, delay_s), atol=1e-6)


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.05, 0.0), (0.004, 0.013), (0.12, 0.0379), (0.03, 0.02)])
def test_state_is_that_of_a_general_integrator(lag_s, delay_s):
    command = np.random.default_rng(3).standard_normal(30)

    def reaching(time: float) -> float:
        return command[max(int(np.floor((time - delay_s) / STEP_S + 1e-9)), 0)]

    state, states = command[0], [command[0]]
    fraction = delay_s % STEP_S
    for k in range(29):
        start = k * STEP_S
        for begin, end in ((start, start + fraction), (start + fraction, start + STEP_S)):
            if end - begin > 1e-9:
                held = reaching(0.5 * (begin + end))
                state = solve_ivp(
                    lambda _, w, held=held: (held - w) / lag_s, (begin, end), [state], rtol=1e-10, atol=1e-12
                ).y[0, -1]
        states.append(state)
    result = actuator_state(command[:, None], step_s=STEP_S, lag_s=lag_s, delay_s=delay_s)[:, 0]
    np.testing.assert_allclose(result, states, atol=1e-8)


@given(seed=st.integers(0, 1000), factor=st.floats(-5.0, 5.0), lag_s=st.floats(0.0, 0.3))
def test_state_is_linear_and_its_rotors_are_apart(seed, factor, lag_s):
    item, other = np.random.default_rng(seed).standard_normal((2, 40, 3))
    index = {"step_s": STEP_S, "lag_s": lag_s, "delay_s": 0.017}
    together = actuator_state(item + factor * other, **index)
    separated = actuator_state(item, **index) + factor * actuator_state(other, **index)
    np.testing.assert_allclose(together, separated, atol=1e-12)
    np.testing.assert_array_equal(
        actuator_state(item, **index)[:, [1]], actuator_state(item[:, [1]].copy(), **index)
    )


@pytest.mark.parametrize("samples", [0, 1, 3, 39, 40, 100])
def test_delay_of_whole_samples_is_a_shift(samples):
    command = np.random.default_rng(4).standard_normal((40, 2))
    prompt = actuator_state(command, step_s=STEP_S, lag_s=0.05, delay_s=0.0)
    late = actuator_state(command, step_s=STEP_S, lag_s=0.05, delay_s=samples * STEP_S)
    np.testing.assert_allclose(late[samples:], prompt[: 40 - min(samples, 40)], atol=1e-13)
    np.testing.assert_allclose(late[:samples], np.tile(command[0], (min(samples, 40), 1)), atol=1e-13)


def test_measured_actuators_are_left_alone_and_a_delay_alone_shifts():
    command = np.random.default_rng(5).standard_normal((20, 1))
    assert actuator_state(command, step_s=STEP_S, lag_s=0.0, delay_s=0.0) is command
    delayed = actuator_state(command, step_s=STEP_S, lag_s=0.0, delay_s=0.02)
    # A state answers the commands before it: one sample more than the delay.
    np.testing.assert_allclose(delayed[3:], command[:-3], atol=1e-15)


def test_state_starts_at_rest_and_a_step_rises_to_its_level_by_the_lag():
    steady = actuator_state(np.full((50, 1), 0.7), step_s=STEP_S, lag_s=0.08, delay_s=0.03)
    np.testing.assert_array_equal(steady, 0.7)
    step = np.zeros(101)
    step[1:] = 1.0
    risen = first_order_lag(step, step_s=STEP_S, lag_s=0.1)
    time = STEP_S * np.arange(101)
    np.testing.assert_allclose(risen[1:], 1.0 - np.exp(-(time[1:] - STEP_S) / 0.1), atol=1e-13)


def test_inputs_are_not_modified():
    command = np.random.default_rng(6).standard_normal((30, 2))
    before = command.copy()
    actuator_state(command, step_s=STEP_S, lag_s=0.02, delay_s=0.011)
    delayed_by(command, 3)
    np.testing.assert_array_equal(command, before)
