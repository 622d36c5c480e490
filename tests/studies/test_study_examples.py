"""The studies in examples/ show what their comments say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from eivor.lab.scenario_files import read_study
from eivor.lab.study import MethodScore, run_study, scores
from eivor.process_pool import LocalProcesses

FOLDER = Path(__file__).parents[2] / "examples" / "studies"
#: Published runs of the dynamic errors-in-variables example.
PUBLISHED_RUNS = 200

Scored = Callable[[str, int], dict[str, MethodScore]]


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Scored:
    def run(name: str, runs: int) -> dict[str, MethodScore]:
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
