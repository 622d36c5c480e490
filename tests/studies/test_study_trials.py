"""Studies, their trials and equations: what they refuse, what a trial depends on, shares of trials."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import binomtest

import eivor
import eivor as ev
from eivor.errors import ParameterError, UsageError
from eivor.lab.experiments import DifferenceEquation, VerticalExperiment
from eivor.lab.scenario_files import method_choice
from eivor.lab.study import (
    DIRECT,
    PARTS,
    TARGETS,
    MethodChoice,
    Regularisation,
    Share,
    failure,
    run_study,
    scores,
    trial,
)
from eivor.lab.study import METHODS as METHOD_NAMES
from eivor.simulation.excitation import WhiteDisturbance
from eivor.strict_toml import read_toml
from studies.study_parts import EQUATION, METHODS, Coin, small_study


def test_a_trial_depends_on_study_and_index_only():
    study = small_study()
    first = trial(study, 5)
    trial(study, 4)
    assert trial(study, 5) == first
    assert trial(replace(study, runs=1000), 5) == first
    assert trial(replace(study, seed=8), 5) != first
    assert trial(study, 6) | {"trial": 5} != first


@pytest.mark.parametrize("covariance", ["default", "classical"])
def test_a_trial_is_what_identify_says(covariance):
    study = small_study(intervals=True, methods=(*METHODS[:2], replace(METHODS[2], covariance=covariance)))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,))))
    signals = EQUATION.record(rng)
    fit = eivor.identify(EQUATION.problem(signals, eivor.lags("input", 0, 5)), eivor.methods.generalized_iv())
    if covariance == "classical":
        fit = fit.with_covariance(ev.covariances.Classical())
    row, label = trial(study, 3), study.methods[2].label
    assert row[f"{label}.status"] == fit.status.value
    for name in fit.names:
        low, high = fit.interval(name)
        numbers = [fit.parameters[name], fit.std_error(name), low, high]
        assert [row[f"{label}.{name}{part}"] for part in PARTS] == numbers


@pytest.mark.parametrize("name", METHOD_NAMES)
def test_every_method_on_the_vertical_experiment(name):
    """Without noise each finds the truth, except bias that there is none to compensate."""
    experiment = VerticalExperiment(ev.Scenario(0.293, 0.021, samples=500))
    lagged = None if name in DIRECT else (0, 10)
    study = small_study(experiment=experiment, methods=(MethodChoice(name, lagged),))
    row = trial(study, 0)
    failed = row[f"{name}.error"]
    if name in {"total_least_squares", "liml", "fuller", "generalized_liml", "generalized_fuller"}:
        # columns that are all exact leave them nothing to do
        assert failed in {None, "NoUniqueSolutionError"}
        return
    if name in {"generalized_iv_unknown_noise", "frisch_scheme"}:
        # without noise their equations are combinations of one another, and the weights have no inverse
        assert failed == "InstrumentError"
        return
    assert failed is None
    assert [row[f"{name}.{parameter}"] for parameter in study.parameters] == pytest.approx(
        [0.293, 0.021], rel=1e-8
    )


def test_noise_that_is_not_known_is_not_used():
    """Generalized IV raises without it, and the trial goes on."""
    giv = MethodChoice("generalized_iv", (0, 5), known_noise=(), label="blind")
    study = small_study(methods=(*METHODS, giv))
    row = trial(study, 0)
    blind = {name: value for name, value in row.items() if name.startswith("blind.") and value is not None}
    assert blind == {"blind.status": "failed", "blind.error": "MissingNoiseError"}
    others = {name: value for name, value in row.items() if not name.startswith("blind.")}
    assert others == trial(small_study(), 0)
    assert failure(study, 0, "blind").startswith(
        "MissingNoiseError: Expected a declared noise of channel 'input'"
    )
    assert failure(study, 0, "least_squares") == ""


@dataclass(frozen=True)
class Broken(DifferenceEquation):
    """Fails in some trials."""

    def record(self, rng):
        if rng.random() < 0.5:
            raise ZeroDivisionError("no record")
        return DifferenceEquation.record(self, rng)


def test_broken_records_in_the_middle_of_a_study_stop_nothing(tmp_path):
    """The table has every trial; what broke is counted, named, and told when it is asked for."""
    study = small_study(30, experiment=Broken((0.5,), (2.0,), Coin(), samples=100))
    result = run_study(study, tmp_path)
    label = study.methods[0].label
    broken = result.trials.filter(result.trials[f"{label}.error"] == "ZeroDivisionError")
    assert result.trials.height == 30
    assert 0 < broken.height < 30
    score = scores(result)[0]
    assert (score.failed, score.first_failure) == (broken.height, broken["trial"][0])
    assert failure(study, broken["trial"][0], label).startswith("ZeroDivisionError: ")


def test_identity():
    study = small_study()
    assert study.identity == replace(study, runs=1, name="other").identity
    others = [
        replace(study, seed=8),
        replace(study, methods=METHODS[:2]),
        replace(study, intervals=True),
        replace(study, experiment=replace(EQUATION, output_coefficients=(np.nextafter(0.5, 1.0),))),
        replace(study, experiment=replace(EQUATION, noise={})),
    ]
    assert len({item.identity for item in [study, *others]}) == 6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: small_study(0), "Expected runs from 1 to 10000000; received 0"),
        (lambda: small_study(seed=-1), "Expected a seed of zero or more; received -1"),
        (lambda: small_study(level=1.0), "Expected a level between 0 and 1; received 1.0"),
        (lambda: small_study(methods=(MethodChoice("least_squares", label="a.b"),)), "no dot"),
        (
            lambda: MethodChoice("generalized_iv"),
            r"lags = \[first, last\] for .* received 'generalized_iv' with none",
        ),
        (lambda: MethodChoice("extended_iv", (3, 1)), "Expected first <= last"),
        (lambda: MethodChoice("extended_iv", (-1, 1)), "a lag of zero or more samples"),
        (
            lambda: MethodChoice("extended_iv_tls", (1, 2), weighting="two_stage"),
            "for extended_iv or generalized_iv only",
        ),
        (
            lambda: small_study(methods=(MethodChoice("extended_iv", (1, 2), channel="inptu"),)),
            "Did you mean 'input'",
        ),
        (
            lambda: small_study(methods=(MethodChoice("least_squares", known_noise=("velocity_z",)),)),
            "a channel for 'least_squares' out of output, input; received 'velocity_z'",
        ),
    ],
)
def test_what_is_refused(make, message):
    with pytest.raises(UsageError, match=message):
        make()


def choice_of(tmp_path, line, name="generalized_iv"):
    path = tmp_path / "method.toml"
    lags = "" if "squares" in name else "lags = [0, 5]"
    path.write_text(f'name = "{name}"\n{lags}\n{line}\n', encoding="utf-8")
    return method_choice(read_toml(path, "a method"))


def test_every_word_of_a_file(tmp_path):
    for towards in TARGETS:
        made = choice_of(tmp_path, f'regularisation = {{ towards = "{towards}" }}')
        assert made.regularisation == Regularisation(None, towards)
        assert made.method.name == "generalized_iv_tikhonov"
    given = choice_of(tmp_path, "regularisation = { parameter = 0.5 }")
    assert given.regularisation == Regularisation(0.5)
    assert choice_of(tmp_path, "strength = 4.0", "fuller").method == ev.methods.fuller(4.0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Regularisation(towards="truth"), "a vector to be shrunk towards out of zero"),
        (lambda: Regularisation(-1.0), "a parameter of zero or more"),
        (lambda: MethodChoice("generalized_iv", (0, 5), strength=4.0), "a strength for fuller"),
        (lambda: MethodChoice("fuller", (1, 5), strength=-4.0), "strength between 0 and"),
        (
            lambda: MethodChoice("spectral_giv", (0, 5), regularisation=Regularisation()),
            "a regularisation of a linear method",
        ),
        (
            lambda: MethodChoice("fuller", (1, 5), regularisation=Regularisation()),
            "solved by least squares or total least squares",
        ),
    ],
)
def test_what_does_not_fit_is_refused(make, said):
    with pytest.raises(UsageError, match=f"Expected .*{said}"):
        make()


def test_a_disturbance_moves_the_machine():
    """Its effect on the output is the recursion of the disturbance itself."""
    parts = ((0.8,), (1.0,), Coin())
    disturbed = DifferenceEquation(*parts, disturbance=WhiteDisturbance(1.0)).record(np.random.default_rng(4))
    free = DifferenceEquation(*parts).record(np.random.default_rng(4))
    effect = disturbed.channel("output") - free.channel("output")
    series = effect - 0.8 * np.concatenate([[0.0], effect[:-1]])
    assert series.std() == pytest.approx(1.0, rel=0.1)
    assert abs(np.corrcoef(series[1:], series[:-1])[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output_coefficients": (1.0,)}, r"stable equation; received \[1.0\], with a root of modulus 1"),
        ({"input_coefficients": ()}, "at least one input coefficient; received none"),
        ({"input_coefficients": (float("nan"),)}, "finite coefficients; received nan"),
        ({"delay": -1}, "a delay of zero or more samples; received -1"),
        ({"noise_to_signal": {"input": -0.1}}, "noise_to_signal of zero or more for input; received -0.1"),
        (
            {"noise": {"velocity_z": ev.WhiteNoise(1.0)}},
            "noise of output, input; received noise of 'velocity_z'",
        ),
    ],
)
def test_equations_that_cannot_be_are_refused(changes, message):
    parts = {"output_coefficients": (0.5,), "input_coefficients": (2.0,), "excitation": Coin()}
    with pytest.raises(ParameterError, match=message):
        DifferenceEquation(**(parts | changes))


@pytest.mark.parametrize("level", [0.95, 0.99])
@pytest.mark.parametrize(
    ("hits", "count"), [(0, 5), (3, 7), (95, 100), (400, 400), (0, 10), (7, 10), (200, 200)]
)
def test_interval_is_that_of_scipy(hits, count, level):
    """Another implementation of Wilson's interval."""
    theirs = binomtest(hits, count).proportion_ci(level, method="wilson")
    np.testing.assert_allclose(Share(hits, count, level).interval, (theirs.low, theirs.high), atol=1e-12)
    assert Share(0, 0, level).interval == (0.0, 1.0)


def test_a_trial_is_that_of_the_method():
    study = small_study(methods=(MethodChoice("generalized_iv", (0, 5), regularisation=Regularisation(0.3)),))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,))))
    problem = EQUATION.problem(EQUATION.record(rng), ev.lags("input", 0, 5))
    fit = ev.identify(problem, ev.methods.regularised(ev.methods.generalized_iv(), 0.3))
    label, *_ = (choice.label for choice in study.methods)
    row = trial(study, 3)
    assert [row[f"{label}.{name}"] for name in study.parameters] == list(fit.parameters.values())
    assert row[f"{label}.status"] == "weak"
