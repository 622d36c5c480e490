"""The Cramer-Rao bound against a closed form, and against what is known of the shipped scenarios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

import eivor as ev
from eivor.errors import ParameterError
from eivor.lab.cramer_rao import disturbance_power
from eivor.lab.disturbances import Arma, GivenDisturbance, SumOfDisturbances, Trend
from eivor.lab.records import Scenario
from eivor.lab.scenario_files import shipped_scenario
from eivor.signals.noise import WhiteNoise
from eivor.simulation.excitation import Disturbance, WhiteDisturbance
from eivor.tools import Float

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


def exact_regressors(disturbance: Disturbance | None, response_std: float) -> Scenario:
    """The velocity is exact, and its equation, which would tell the friction without error, is kept out.

    Noise of the velocity far above that of the input, and none to speak of beside the response's, does that.
    """
    noise = {"input": 1e-7, "velocity_z": 1e3, "acceleration_z": response_std}
    return replace(
        shipped_scenario("white"),
        noise={name: WhiteNoise(std) for name, std in noise.items()},
        noise_to_signal={},
        disturbance=disturbance,
        disturbance_to_signal=None,
    )


def regressors(scenario: Scenario) -> Float[np.ndarray, "n 2"]:
    """Derivatives of z'' by K and K_u over the first record of a scenario, without their means."""
    truth = ev.simulate(scenario, np.random.default_rng([0, 0])).truth
    K, b, T = scenario.viscous_friction, scenario.input_gain, scenario.step_s
    u = truth.channel("input")
    # a = u b - K v of u alone: its derivatives by K and b, by recursion
    v, v_K = np.zeros(u.size), np.zeros(u.size)
    decay, held = np.exp(-K * T), (1.0 - np.exp(-K * T)) / K
    held_K = (T * decay - held) / K
    for k in range(u.size - 1):
        v[k + 1] = decay * v[k] + held * b * u[k]
        v_K[k + 1] = decay * v_K[k] - T * decay * v[k] + held_K * b * u[k]
    X = np.stack([-v - K * v_K, u - K * v / b], axis=1)
    return np.asarray(X - X.mean(axis=0))


def test_exact_regressors_give_the_bound_of_least_squares() -> None:
    """It is s_a^2 (X'X)^-1."""
    scenario = exact_regressors(None, 1e-3)
    X = regressors(scenario)
    expected = 1e-3**2 * np.linalg.inv(X.T @ X)
    np.testing.assert_allclose(ev.bounds.cramer_rao(scenario, runs=1).covariance, expected, rtol=0.01)


def test_a_coloured_disturbance_gives_the_bound_of_generalized_least_squares() -> None:
    """An autoregression that shifts the response: (X' S^-1 X)^-1, with its covariance matrix S."""
    phi, std = 0.9, 1e-3
    scenario = replace(exact_regressors(Arma(std, (phi,)), 1e-7), samples=1000)
    X = regressors(scenario)
    S = std**2 / (1.0 - phi**2) * toeplitz(phi ** np.arange(1000.0))
    expected = np.linalg.inv(X.T @ np.linalg.solve(S, X))
    bound = ev.bounds.cramer_rao(scenario, runs=1).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(bound)), np.sqrt(np.diag(expected)), rtol=0.05)
    white = replace(scenario, disturbance=WhiteDisturbance(std / np.sqrt(1.0 - phi**2)))
    separated = np.diag(ev.bounds.cramer_rao(white, runs=1).covariance) / np.diag(expected)
    assert np.abs(np.log(separated)).max() > 1.0


def test_what_every_record_has_alike_is_no_noise() -> None:
    white = WhiteDisturbance(1e-3)
    alone, drifting = (
        ev.bounds.cramer_rao(replace(exact_regressors(item, 1e-5), samples=500), runs=2).covariance
        for item in (SumOfDisturbances((white,)), SumOfDisturbances((white, Trend((0.0, 5.0)))))
    )
    np.testing.assert_allclose(drifting, alone, rtol=1e-6)


def test_a_disturbance_that_is_given_counts_as_white() -> None:
    """It has no mean over records: a single record's power is zero in some bins."""
    series = np.random.default_rng(5).normal(0.0, 1e-3, 500)
    given = exact_regressors(GivenDisturbance(tuple(series.tolist())), 1e-7)
    power = disturbance_power(replace(given, samples=500))
    np.testing.assert_allclose(power, series.var())


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
