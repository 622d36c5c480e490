"""`eivor paper`: what it prints and writes; the studies of the examples; bounds of scenarios."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.errors import ParameterError
from eivor.lab.disturbances import Arma
from eivor.lab.scenario_files import read_study, shipped_scenario
from eivor.lab.study import run_study, scores
from eivor.process_pool import LocalProcesses
from eivor.simulation.excitation import WhiteDisturbance

SMALL = ("paper", "--runs", "3", "--workers", "1")


def eivor(*arguments):
    return CliRunner().invoke(app, list(arguments))


def test_tables_have_measured_beside_printed():
    run = eivor(*SMALL, "--readings", "two-lags,ratios-of-std")
    assert run.exit_code == 0, run.output
    assert run.output.count("187.2 ± 119.4") == 2
    assert run.output.count("5.739 ± 2.7") == 2
    assert "none" in run.output  # two delayed inputs have no total least squares solution
    assert "No reading gives the printed tables." in run.output
    assert max(map(len, run.output.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--runs", "1"), "two runs or more"),
        (("--readings", "none-such"), "readings out of"),
        (("--workers", "-1"), "workers of zero or more"),
        (("--json", "/nowhere/at/all.json"), "does not exist"),
    ],
)
def test_wrong_usage_is_told_before_anything_runs(arguments, message, monkeypatch):
    monkeypatch.setattr("eivor.lab.cli.run_paper", None)
    run = eivor("paper", *arguments)
    assert run.exit_code in (1, 2)
    assert message in run.output


FOLDER = Path(__file__).parents[2] / "examples" / "studies"


#: Published runs of the dynamic errors-in-variables example.
PUBLISHED_RUNS = 200


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    def run(name, runs):
        study = replace(read_study(FOLDER / name), runs=runs)
        result = run_study(study, tmp_path_factory.mktemp("study"), executor=LocalProcesses(2))
        return {score.label: score for score in scores(result)}

    return run


@pytest.mark.calibration
def test_dynamic_errors_in_variables(scored):
    """Within three standard errors of what another implementation found in 200 runs."""
    result = scored("dynamic-errors-in-variables.toml", 200)
    published = {
        ("least_squares", 0): (0.454, None),
        ("least_squares", 1): (1.819, None),
        ("generalized_iv", 0): (0.4994, 0.013),
        ("generalized_iv", 1): (2.0000, 0.037),
    }
    for (label, name), (mean, std) in published.items():
        score = result[label].parameters[name]
        runs = result[label].trials
        assert result[label].failed == 0
        current = score.estimate.std
        error = math.sqrt(current**2 / runs + (std or current) ** 2 / PUBLISHED_RUNS)
        assert abs(score.estimate.mean - mean) < 3.0 * error, (label, score)
        if std is not None:
            # Standard error of a standard deviation, of both, and half of the last digit that is printed.
            error = math.sqrt(current**2 / (2 * runs) + std**2 / (2 * PUBLISHED_RUNS))
            assert abs(current - std) < 3.0 * error + 0.0005, (label, score)


@pytest.mark.calibration
def test_white_input(scored):
    """Delayed white inputs are weak instruments, are called so, and cost more than a factor of ten."""
    result = scored("white-input.toml", 50)
    extended, generalized = result["extended_iv"], result["generalized_iv"]
    gains = [item.parameters[1] for item in (extended, generalized)]
    assert gains[0].name == "input_gain"
    assert gains[0].rmse > 10.0 * gains[1].rmse
    assert extended.weak == extended.trials
    assert generalized.weak == 0
    assert abs(gains[1].bias) < 4.0 * gains[1].estimate.std / math.sqrt(generalized.trials)


@pytest.mark.calibration
def test_altitude_control(scored):
    """Only the reference is an instrument that the controller's answers do not spoil."""
    result = scored("altitude-control.toml", 100)
    errors = {
        label: [
            (parameter.estimate.mean - truth) / (parameter.estimate.std / math.sqrt(score.trials))
            for parameter, truth in zip(score.parameters, (0.293, 0.021), strict=True)
        ]
        for label, score in result.items()
    }
    assert max(errors["least_squares"]) < -20.0
    assert errors["iv_of_input"][1] < -20.0
    assert max(map(abs, errors["iv_of_reference"])) < 4.0
    assert result["iv_of_reference"].weak == 0


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_every_example_can_be_read(path):
    study = read_study(path)
    assert study.runs >= 100


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
def test_shipped_scenarios_have_the_bounds_known_of_them(name):
    bound = ev.bounds.cramer_rao(shipped_scenario(name), runs=4)
    np.testing.assert_allclose(100.0 * np.array(list(bound.relative.values())), KNOWN[name], rtol=0.04)


def test_what_friction_does_to_a_disturbance_informs_of_it(monkeypatch):
    scenario = replace(shipped_scenario("rich-dynamic"), samples=500)
    bound = ev.bounds.cramer_rao(scenario, runs=2).covariance[0, 0]
    monkeypatch.setattr("eivor.lab.cramer_rao._shaped_noise_information", lambda *_: 0.0)
    assert bound < ev.bounds.cramer_rao(scenario, runs=2).covariance[0, 0]


def exact_regressors(disturbance, response_std):
    """The velocity is exact, and its equation, which would tell the friction without error, is kept out.

    Noise of the velocity far above that of the input, and none to speak of beside the response's, does that.
    """
    noise = {"input": 1e-7, "velocity_z": 1e3, "acceleration_z": response_std}
    return replace(
        shipped_scenario("white"),
        noise={name: ev.WhiteNoise(std) for name, std in noise.items()},
        noise_to_signal={},
        disturbance=disturbance,
        disturbance_to_signal=None,
    )


def regressors(scenario):
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


def test_a_coloured_disturbance_gives_the_bound_of_generalized_least_squares():
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


def test_what_has_no_bound_is_refused():
    with pytest.raises(ParameterError, match="in open loop"):
        ev.bounds.cramer_rao(shipped_scenario("closed-loop"))
    with pytest.raises(ParameterError, match="noise of input"):
        ev.bounds.cramer_rao(ev.Scenario(0.3, 0.02))
    with pytest.raises(ParameterError, match="1 to 10000 records"):
        ev.bounds.cramer_rao(shipped_scenario("rich"), runs=0)
    with pytest.raises(ParameterError, match="a seed of zero or more"):
        ev.bounds.cramer_rao(shipped_scenario("rich"), seed=-1)


def test_readings_are_listed():
    run = eivor("paper", "--list")
    assert run.exit_code == 0
    assert "central-10-lags" in run.output


def test_a_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    run = eivor(*SMALL, "--out", str(tmp_path / "file"))
    assert run.exit_code == 1
    assert "a folder for the figures" in run.output
