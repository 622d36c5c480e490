"""Covariance of sums whose series remember long, against the sum over all pairs of rows."""

from dataclasses import replace

import numpy as np

import eivor as ev
from eivor.estimation.unknown_noise import RECORD_OVER_LAG, long_memory_covariance
from eivor.lab.scenario_files import shipped_scenario


def test_it_is_the_sum_over_lags():
    rng = np.random.default_rng(1)
    g, e = rng.standard_normal((40, 2)), rng.standard_normal(40)
    most = 40 // RECORD_OVER_LAG
    naive = np.zeros((2, 2))
    for lag in range(-most, most + 1):
        both = [(t + lag, t) for t in range(40) if 0 <= t + lag < 40]
        of_g = sum(np.outer(g[t], g[s]) for t, s in both)
        of_e = sum(e[t] * e[s] for t, s in both)
        prediction = sum(g[t] * e[s] for t, s in both)
        behind = sum(g[s] * e[t] for t, s in both)
        naive += (1.0 - abs(lag) / (most + 1.0)) * (of_g * of_e + np.outer(prediction, behind)) / 40
    np.testing.assert_allclose(long_memory_covariance(g, e), naive, rtol=1e-12)


def test_it_widens_the_interval_of_an_order():
    scenario = replace(shipped_scenario("rich-high"), samples=3000)
    scenario = replace(scenario, noise={**scenario.noise, "velocity_z": ev.FractionalNoise(1.0, -0.4)})
    signals = replace(ev.simulate(scenario, np.random.default_rng(1)).signals, noise={})
    problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 10))
    reported = ev.identify(problem, ev.methods.generalized_iv_unknown_noise(orders=("velocity_z",)))
    index = reported.names.index("noise_order_velocity_z")
    errors = {part.name: part.matrix[index, index] ** 0.5 for part in reported.best.covariance.parts}
    assert errors["of_long_memory"] > 1.2 * errors["of_normal_series"]
    assert reported.std_error("noise_order_velocity_z") >= errors["of_long_memory"]
    white = ev.identify(problem, ev.methods.generalized_iv_unknown_noise())
    assert "of_long_memory" not in {part.name for part in white.best.covariance.parts}
