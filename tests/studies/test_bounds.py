"""The Cramer-Rao bound against a closed form, and against what is known of the shipped scenarios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.errors import ParameterError
from eivor.signals.noise import WhiteNoise
from eivor.simulation.scenario_files.scenario_file import shipped_scenario

#: Bounds in per cent of the parameters, 4,000 samples, worked out by an independent program.
KNOWN = {
    "v": (0.674, 0.547),
    "p": (0.034, 0.027),
    "rich": (0.565, 0.150),
    "rich-high": (2.05, 0.750),
    "rich-dynamic": (1.58, 0.833),
    "white": (1.29, 0.246),
}


@pytest.mark.parametrize("name", KNOWN)
def test_shipped_scenarios_have_the_bounds_known_of_them(name: str) -> None:
    bound = ev.bounds.cramer_rao(shipped_scenario(name), runs=4)
    np.testing.assert_allclose(100.0 * np.array(list(bound.relative.values())), KNOWN[name], rtol=0.04)


def test_exact_regressors_give_the_bound_of_least_squares() -> None:
    """Without noise of input and velocity it is s_a^2 (X'X)^-1, once the velocity's own equation is left out.

    The velocity is then exact, and its equation tells the friction without error: noise of the velocity far
    above that of the input, and none to speak of beside the response's, keeps it out.
    """
    base = shipped_scenario("white")
    noise = {"input": WhiteNoise(1e-7), "velocity_z": WhiteNoise(1e3), "acceleration_z": WhiteNoise(1e-3)}
    scenario = replace(base, noise=noise, noise_to_signal={}, disturbance=None, disturbance_to_signal=None)
    bound = ev.bounds.cramer_rao(scenario, runs=1)
    truth = ev.simulate(scenario, np.random.default_rng([0, 0])).truth
    K, b, T = base.viscous_friction, base.input_gain, scenario.step_s
    u = truth.channel("input")
    # a = u b - K v of u alone: its derivatives by K and b, by recursion
    v, v_K = np.zeros(u.size), np.zeros(u.size)
    decay, held = np.exp(-K * T), (1.0 - np.exp(-K * T)) / K
    held_K = (T * decay - held) / K
    for k in range(u.size - 1):
        v[k + 1] = decay * v[k] + held * b * u[k]
        v_K[k + 1] = decay * v_K[k] - T * decay * v[k] + held_K * b * u[k]
    X = np.stack([-v - K * v_K, u - K * v / b], axis=1)
    X -= X.mean(axis=0)
    expected = 1e-3**2 * np.linalg.inv(X.T @ X)
    np.testing.assert_allclose(bound.covariance, expected, rtol=0.01)


def test_longer_records_tell_more() -> None:
    short, long = (
        ev.bounds.cramer_rao(replace(shipped_scenario("white"), samples=count), runs=2).std_errors[
            "input_gain"
        ]
        for count in (1000, 4000)
    )
    assert short / long == pytest.approx(2.0, rel=0.1)


def test_what_has_no_bound_is_refused() -> None:
    with pytest.raises(ParameterError, match="in open loop"):
        ev.bounds.cramer_rao(shipped_scenario("closed-loop"))
    with pytest.raises(ParameterError, match="noise of input"):
        ev.bounds.cramer_rao(ev.Scenario(0.3, 0.02))
    with pytest.raises(ParameterError, match="1 to 10000 records"):
        ev.bounds.cramer_rao(shipped_scenario("rich"), runs=0)
    with pytest.raises(ParameterError, match="a seed of zero or more"):
        ev.bounds.cramer_rao(shipped_scenario("rich"), seed=-1)
