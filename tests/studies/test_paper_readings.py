"""The paper's simulation: agreement with an independent prototype, and of each part with a second route."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.special import binom
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.estimation import methods
from eivor.estimation.methods import identify
from eivor.lab import paper
from eivor.lab.disturbances import Arma
from eivor.lab.scenario_files import read_study, shipped_scenario
from eivor.lab.study import run_study, scores
from eivor.models.regression import lags
from eivor.motions.vertical.model import VerticalMotion
from eivor.process_pool import LocalProcesses
from eivor.simulation.excitation import WhiteDisturbance

RUNS = 30
PROTOTYPE_RUNS = 100
#: NRMSE of (LS, K), (LS, K_u), (extended IV, K), (generalized IV, K) of a prototype, mean and SD of 100 runs.
PROTOTYPE = {
    ("ratios-of-std", 1): ((0.115, 0.084), (0.080, 0.062), (0.091, 0.082), (0.091, 0.082)),
    ("ratios-of-variances", 1): ((6.02, 1.45), (4.30, 1.07), (1.03, 0.88), (1.03, 0.87)),
    ("ratios-of-variances", 2): ((6.85, 1.63), (5.16, 1.19), (1.19, 0.95), (1.19, 0.95)),
}
POSITIONS = (("least_squares", 0), ("least_squares", 1), ("extended_iv", 0), ("generalized_iv", 0))


def reading(name, **changes):
    return replace(paper.named_readings((name,))[0], **changes)


@pytest.fixture(scope="module")
def results():
    return {
        (name, number): paper.run_together(((reading(name),), paper.EXAMPLES[number - 1]), RUNS)[0]
        for name, number in PROTOTYPE
    }


@pytest.mark.calibration
@pytest.mark.parametrize(("name", "number"), list(PROTOTYPE))
def test_the_prototype_is_met_within_three_standard_errors(results, name, number):
    result = results[name, number]
    for (method, score), (mean, std) in zip(POSITIONS, PROTOTYPE[name, number], strict=True):
        measured = result.spreads(method)[score]
        error = np.hypot(measured.std / np.sqrt(RUNS), std / np.sqrt(PROTOTYPE_RUNS))
        assert abs(measured.mean - mean) <= 3.0 * error, (method, score)


@pytest.mark.calibration
def test_no_method_but_least_squares_is_biased_by_ratios_of_variances(results):
    result = results["ratios-of-variances", 1]
    truth = np.array(list(paper.TRUTH.values()))
    for index, method in enumerate(paper.METHODS):
        errors = result.estimates[:, index] / truth - 1.0
        bias = np.abs(errors.mean(axis=0)) * np.sqrt(RUNS) / errors.std(axis=0, ddof=1)
        assert (bias > 10.0).all() if method == "least_squares" else (bias < 3.5).all(), method


@pytest.mark.thorough
def test_a_white_input_makes_extended_iv_ten_times_worse_than_generalized_iv():
    result = paper.run_together(((reading("white-input"),), paper.EXAMPLES[0]), 20)[0]
    assert result.spreads("extended_iv")[1].mean > 10.0 * result.spreads("generalized_iv")[1].mean
    assert [result.weak_runs(method) for method in paper.METHODS] == [0, 0, 20, 20, 0, 0]


@pytest.mark.parametrize("name", ["ratios-of-variances", "central-5-lags", "weights-as-printed"])
def test_shared_moments_give_what_identify_gives(name):
    chosen = reading(name)
    signals = paper.record(chosen, paper.EXAMPLES[0], paper.stream(paper.SEED, 3)).signals
    model = VerticalMotion(intercept=False)
    instruments = {"extended": lags("input", 1, chosen.lags), "generalized": lags("input", 0, chosen.lags)}
    for method, item in zip(paper.METHODS, paper.estimates(chosen, signals)[0], strict=True):
        columns = instruments.get(method.partition("_iv")[0], ())
        expected = identify(model.regression(signals, columns), getattr(methods, method)())
        assert item == pytest.approx(list(expected.parameters.values()), rel=1e-9), method


@pytest.mark.parametrize(
    ("compensation", "row", "counted"),
    [
        ("shared", 0, True),
        ("printed_row", 1, True),
        ("without_count", 0, False),
    ],
)
def test_compensation_is_where_the_reading_has_it(compensation, row, counted):
    """(29), (30) and (32) from sums over all rows, with the 1 of H in its row and N there or not."""
    chosen = reading("larger-on-input", compensation=compensation)
    signals = paper.record(chosen, paper.EXAMPLES[0], paper.stream(paper.SEED, 4)).signals
    velocity, drive, response = (signals.channels[n] for n in ("velocity_z", "input", "acceleration_z"))
    first, count = chosen.lags, signals.sample_count
    Psi = np.column_stack([drive[first - lag : count - lag] for lag in range(chosen.lags + 1)])
    Phi = np.column_stack([-velocity[first:], drive[first:]])
    H = np.zeros((chosen.lags + 1, 2))
    H[row, 1] = 1.0
    X = Psi.T @ Phi - (len(Phi) if counted else 1.0) * signals.noise["input"].variance * H
    b = Psi.T @ response[first:]
    smallest = np.linalg.svd(np.column_stack([X, b]), compute_uv=False)[-1]
    least = np.linalg.solve(X.T @ X, X.T @ b)
    total = np.linalg.solve(X.T @ X - smallest**2 * np.eye(2), X.T @ b)
    result = dict(zip(paper.METHODS, paper.estimates(chosen, signals)[0], strict=True))
    assert result["generalized_iv"] == pytest.approx(least, rel=1e-8)
    assert result["generalized_iv_tls"] == pytest.approx(total, rel=1e-8)
    # What rounding leaves is far below what the misprints do.
    shared = paper.estimates(replace(chosen, compensation="shared"), signals)[0][-2]
    far = np.abs(result["generalized_iv"] / shared - 1.0).max()
    assert far == 0.0 if compensation == "shared" else far > 1e-3


@pytest.mark.parametrize(
    ("motion", "velocity", "acceleration"),
    [
        ("velocity_central", 0.0, 0.0),
        ("velocity_forward", 0.0, 0.1),
        ("height_central", 0.0, 0.0),
        ("height_backward", -0.1, -0.2),
    ],
)
def test_differences_are_late_by_half_a_step_each(motion, velocity, acceleration):
    t = 0.2 * np.arange(400)
    z, v, a = np.sin(0.1 * t), 0.1 * np.cos(0.1 * t), -0.01 * np.sin(0.1 * t)
    found_v, found_a = paper._DIFFERENCES[motion](v, z)
    inner = slice(2, -2)
    assert found_v[inner] == pytest.approx(0.1 * np.cos(0.1 * (t + velocity))[inner], abs=1e-4)
    assert found_a[inner] == pytest.approx(-0.01 * np.sin(0.1 * (t + acceleration))[inner], abs=1e-5)
    assert np.abs(found_a[inner] - a[inner]).max() < 1.1e-3 * max(abs(acceleration), 0.01)


def test_input_noise_of_the_second_example_is_five_thousandths_of_its_signal():
    """The disturbance likewise: ratios of the paper to what is in a record."""
    made = paper.record(reading("ratios-of-std"), paper.EXAMPLES[1], paper.stream(paper.SEED, 2))
    noisy, exact = made.signals.channels["input"], made.truth.channels["input"]
    # 4000 samples tell a standard deviation to 1.1 %
    assert (noisy - exact).std() / exact.std() == pytest.approx(5e-3, rel=0.05)


def test_nrmse_is_the_papers():
    scores = paper.nrmse(np.array([[0.293 * 1.1, 0.021 * 0.8], [0.293, 0.021]]))
    together = 100.0 * np.hypot(0.0293, 0.0042) / np.hypot(0.293, 0.021)
    assert scores == pytest.approx(np.array([[10.0, 20.0, together], [0.0, 0.0, 0.0]]), abs=1e-9)


def test_names_are_different():
    names = [item.name for item in paper.READINGS]
    assert len(set(names)) == len(names)
    assert paper.named_readings(()) == paper.READINGS


def test_too_few_instruments_for_total_least_squares_are_no_estimate():
    result = paper.run_together(((reading("two-lags"),), paper.EXAMPLES[0]), 2)[0]
    assert (result.failed("extended_iv_tls"), result.failed("extended_iv")) == (2, 0)
    assert np.isnan(result.spreads("extended_iv_tls")[0].mean)


def test_alternating_noise_has_the_autocovariance_of_its_weights():
    weights = binom(-0.4, np.arange(40))
    autocovariance = paper.AlternatingNoise(1.5, -0.4).autocovariance(3, 10, 5)
    expected = [2.25 * weights[: m + 1] @ weights[3 : m + 4] for m in range(10, 15)]
    assert autocovariance == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("name", [item.name for item in paper.READINGS])
def test_every_reading_makes_records_of_the_papers_length(name):
    made = paper.record(reading(name), paper.EXAMPLES[1], paper.stream(paper.SEED, 0))
    assert made.signals.sample_count == made.truth.sample_count == 4000
    assert np.isfinite(list(made.signals.channels.values())).all()


def test_no_estimate_is_infinitely_far():
    result = paper.PaperResult(
        paper.READINGS[0],
        paper.EXAMPLES[0],
        np.full((3, len(paper.METHODS), 2), np.nan),
        np.zeros((3, len(paper.METHODS)), dtype=bool),
    )
    assert paper.nearness([result]).means == float("inf")
    assert np.isnan(result.spreads("least_squares")[0].std)


# `eivor paper`: what it prints and writes; the studies of the examples; bounds of scenarios.

SMALL = ("paper", "--runs", "3", "--workers", "1")


def eivor(*arguments):
    return CliRunner().invoke(app, list(arguments))


def test_tables_have_measured_beside_printed():
    run = eivor(*SMALL, "--readings", "two-lags,ratios-of-std")
    assert run.exit_code == 0, run.output
    assert (run.output.count("187.2 ± 119.4"), run.output.count("5.739 ± 2.7")) == (2, 2)
    assert "none" in run.output  # two delayed inputs have no total least squares solution
    assert "No reading gives the printed tables." in run.output
    assert max(map(len, run.output.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--runs", "1"), "two runs or more"),
        (("--readings", "none-such"), "readings out of"),
        (("--workers", "-1"), "workers of zero or more"),
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
    assert read_study(path).runs >= 100


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
