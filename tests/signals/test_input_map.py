"""Input maps: inverse, slope and name each give back what the map says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eivor.errors import UsageError
from eivor.signals.thrust_map import InputMap, Mixed, Power, input_map

MAPS = st.one_of(
    st.floats(0.2, 5.0).map(Power),
    st.sampled_from([Power(1.0), Power(2.0), Power(1.5), Mixed(0.0), Mixed(1.0)]),
    st.floats(0.0, 1.0).map(Mixed),
)


def value(mapping: InputMap, state: float) -> float:
    return float(mapping(np.array([state]))[0])


@given(mapping=MAPS, state=st.floats(1e-3, 1e4))
def test_inverse_undoes_the_map(mapping, state):
    assert mapping.inverse(value(mapping, state)) == pytest.approx(state, rel=1e-9)


@given(mapping=MAPS, state=st.floats(1e-3, 1e4))
def test_slope_is_the_difference_quotient(mapping, state):
    step = 1e-5 * state
    quotient = (value(mapping, state + step) - value(mapping, state - step)) / (2.0 * step)
    assert mapping.slope(state) == pytest.approx(quotient, rel=1e-6)


@given(mapping=MAPS)
def test_name_gives_the_map_back(mapping):
    assert input_map(mapping.name) == mapping


@given(mapping=MAPS, low=st.floats(0.0, 100.0), more=st.floats(1e-3, 100.0))
def test_maps_rise_and_keep_the_sign(mapping, low, more):
    assert value(mapping, low + more) > value(mapping, low)
    assert value(mapping, -low) == pytest.approx(-value(mapping, low))
    assert value(mapping, 0.0) == 0.0
    assert mapping.inverse(0.0) == 0.0


def test_the_words_are_the_maps():
    state = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_array_equal(input_map("linear")(state), state)
    np.testing.assert_array_equal(input_map("square")(state), [-4.0, 0.0, 9.0])
    np.testing.assert_allclose(input_map("power:3")(state), [-8.0, 0.0, 27.0])
    np.testing.assert_allclose(input_map("mixed:0.3")(state), 0.7 * state + 0.3 * state * np.abs(state))
    assert np.isnan(Mixed(0.3).inverse(-0.1))
    assert Power(2.0).inverse(-4.0) == -2.0


@pytest.mark.parametrize(
    "name",
    [
        "",
        "cubic",
        "square:2",
        "power",
        "power:",
        "power:two",
        "power:0",
        "power:-1",
        "power:nan",
        "power:inf",
        "mixed",
        "mixed:1.01",
        "mixed:-0.1",
        "mixed:nan",
        "Square",
    ],
)
def test_names_of_no_map_are_refused(name):
    with pytest.raises(
        UsageError,
        match=r"Expected an? .*; received",
    ):
        input_map(name)
