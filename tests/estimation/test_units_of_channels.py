"""What an estimate says of a vehicle does not depend on the units of its channels."""

from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.lab.scenario_files import shipped_scenario
from eivor.linalg import LeastSquares, LinearSystem

MODEL = ev.VerticalMotion(intercept=False)
m = ev.methods
DECLARED = (m.bias_compensated_least_squares(), m.spectral_giv(), m.whittle_ml())
SOUGHT = (
    m.generalized_iv_unknown_noise(),
    m.generalized_iv_unknown_noise(orders=("velocity_z",)),
    m.bias_eliminating_least_squares(),
    m.frisch_scheme(),
)


@pytest.fixture(scope="module")
def signals():
    scenario = replace(shipped_scenario("rich"), samples=400)
    return ev.simulate(scenario, np.random.default_rng(5)).signals


def in_units(signals, of_input, of_motion):
    units = {"input": of_input, "velocity_z": of_motion, "acceleration_z": of_motion}
    return replace(
        signals,
        channels={name: units[name] * signals.channels[name] for name in units},
        noise={name: replace(item, std=units[name] * item.std) for name, item in signals.noise.items()},
    )


def told(signals, method, of_input=1.0, of_motion=1.0):
    """K, K_u and the ends of their intervals, in units of the signals that are given."""
    scaled = in_units(signals, of_input, of_motion)
    scaled = replace(scaled, noise={}) if method in SOUGHT else scaled
    estimate = ev.identify(MODEL.regression(scaled, ev.lags("input", 0, 10)), method)
    gain = of_motion / of_input
    names = (("viscous_friction", 1.0), ("input_gain", gain))
    return np.array(
        [
            [estimate.parameters[name] / unit, *np.divide(estimate.interval(name), unit)]
            for name, unit in names
        ]
    )


@pytest.mark.parametrize("method", [*DECLARED, *SOUGHT], ids=lambda method: method.name)
@pytest.mark.parametrize(("of_input", "of_motion"), [(1e-9, 1e9), (1e9, 1e-9)])
def test_units_change_nothing(signals, method, of_input, of_motion):
    in_others = told(signals, method, of_input, of_motion)
    np.testing.assert_allclose(in_others, told(signals, method), rtol=1e-6 if method in SOUGHT else 1e-8)


def test_as_many_equations_as_unknowns_are_met_in_any_units():
    A, theta = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([0.5, -0.25])
    rows, columns = np.array([1e15, 1e-15]), np.array([1e-9, 1e9])
    scaled = rows[:, None] * A * columns
    solve = LeastSquares().solve(LinearSystem(scaled, rows * (A @ theta)))
    np.testing.assert_allclose(solve.theta * columns, theta, rtol=1e-13)
    assert solve.condition < 10.0
