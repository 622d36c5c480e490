"""Tests of rotors that follow their commands at a limited rate."""

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.prepared import LEVEL, RATE
from eivor.motions.identify import identify_flight
from eivor.signals.filters import rate_limited
from validation.real_logs.flights import logged_flight
from validation.real_logs.trials import published_grid


def test_limited_values_follow_at_the_limit():
    """As a loop over the samples says, across gaps and blocks."""
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.002, 0.006, 3000))
    time_s[1200:] += 1.7
    values = 0.5 + 0.02 * rng.standard_normal(3000) + 0.1 * np.sin(3.0 * time_s)
    values[700:705] = np.nan
    expected, state = [], values[0]
    for value, step in zip(values, np.diff(time_s, prepend=time_s[0]), strict=True):
        known = value if np.isfinite(value) else known  # noqa: F821 - the first is finite
        state += np.clip(known - state, -0.4 * step, 0.4 * step)
        expected.append(state)
    both = rate_limited(values, time_s, np.array([0.4, 1e9]))
    np.testing.assert_allclose(both[0], expected, atol=1e-12)
    np.testing.assert_array_equal(both[1][900:], values[900:])


UNLOGGED = [(RATE, {"slew": 1.15}), (LEVEL, {"slew": 0.0, "ceiling": 1.1})]


@pytest.mark.parametrize(("kind", "unlogged"), UNLOGGED)
def test_a_limit_is_measured_and_commands_enter_within_it(kind, unlogged):
    """By a limit of their rate gains were a quarter too small, and lags four times too long."""
    spec = replace(published_grid().family("command limited in its rate").flight(42), duration=30.0)
    vehicle = replace(spec.vehicle, **unlogged)
    vehicle = replace(vehicle, ceiling=vehicle.ceiling * vehicle.hover_input)
    spec = replace(spec, vehicle=vehicle)
    flight = logged_flight(spec)
    result = identify_flight(flight.recording)
    assert kind in [item.name for item in result.findings]
    assert result.diagnostics[kind] == pytest.approx(vehicle.slew or vehicle.ceiling, rel=0.1)
    truth = flight.flown.effective(result.prepared[0].grid.time_s, result.prepared[0].used)
    for name in ("viscous_friction", "input_gain"):
        low, high = result.quantities[name].interval
        assert low < truth[name] < high
    assert result.quantities["input_gain"].value == pytest.approx(truth["input_gain"], rel=0.03)
    lag_s = spec.vehicle.actuator_lag + spec.vehicle.delay
    assert result.quantities["effective_lag"].value == pytest.approx(lag_s, abs=0.008)
