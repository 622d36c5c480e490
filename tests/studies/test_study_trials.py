"""Studies and their trials: what they refuse, and what a trial depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import eivor
from eivor.errors import UsageError
from eivor.lab.experiments import DifferenceEquation, VerticalExperiment
from eivor.lab.records import Scenario
from eivor.lab.study import DIRECT, PARTS, MethodChoice, failure, run_study, scores, trial
from eivor.lab.study import METHODS as METHOD_NAMES
from eivor.signals.signals import Signals
from studies.study_parts import EQUATION, METHODS, Coin, small_study


def test_a_trial_depends_on_study_and_index_only():
    study = small_study()
    first = trial(study, 5)
    trial(study, 4)
    assert trial(study, 5) == first
    assert trial(replace(study, runs=1000), 5) == first
    assert trial(replace(study, seed=8), 5) != first
    assert trial(study, 6) | {"trial": 5} != first


def test_a_trial_is_what_identify_says():
    study = small_study(intervals=True)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,))))
    signals = EQUATION.record(rng)
    fit = eivor.identify(EQUATION.problem(signals, eivor.lags("input", 0, 5)), eivor.methods.generalized_iv())
    row, label = trial(study, 3), study.methods[2].label
    assert row[f"{label}.status"] == fit.status.value
    for name in fit.names:
        low, high = fit.interval(name)
        numbers = [fit.parameters[name], fit.std_error(name), low, high]
        assert [row[f"{label}.{name}{part}"] for part in PARTS] == numbers


@pytest.mark.parametrize("name", METHOD_NAMES)
def test_every_method_on_the_vertical_experiment(name):
    """Without noise each finds the truth, except bias that there is none to compensate."""
    experiment = VerticalExperiment(Scenario(0.293, 0.021, samples=500))
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

    def record(self, rng: np.random.Generator) -> Signals:
        if rng.random() < 0.5:
            raise ZeroDivisionError("no record")
        return DifferenceEquation.record(self, rng)


def test_a_broken_record_is_a_result():
    study = small_study(experiment=Broken((0.5,), (2.0,), Coin(), samples=100))
    rows = [trial(study, index) for index in range(20)]
    results = [{row[f"{choice.label}.error"] for choice in study.methods} for row in rows]
    assert {"ZeroDivisionError"} in results
    assert {None} in results


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


def test_weak_instruments_are_a_status():
    """Delayed white inputs do not move the input: no warning escapes, the status tells."""
    row = trial(small_study(methods=(MethodChoice("extended_iv", (2, 6)),)), 0)
    assert row["extended_iv.status"] == "weak"


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
        (lambda: small_study(methods=()), "received labels of no method"),
        (lambda: small_study(methods=METHODS[:1] * 2), "labels least_squares, least_squares"),
        (lambda: small_study(methods=(MethodChoice("least_squares", label="a.b"),)), "no dot"),
        (lambda: MethodChoice("generalised_iv", (0, 3)), "Did you mean 'generalized_iv'"),
        (
            lambda: MethodChoice("generalized_iv"),
            r"lags = \[first, last\] for .* received 'generalized_iv' with none",
        ),
        (lambda: MethodChoice("least_squares", (0, 1)), r"received 'least_squares' with \[0, 1\]"),
        (lambda: MethodChoice("extended_iv", (3, 1)), "Expected first <= last"),
        (lambda: MethodChoice("extended_iv", (-1, 1)), "a lag of zero or more samples"),
        (lambda: MethodChoice("extended_iv", (1, 2), weighting="two_step"), "Did you mean 'two_ste?p?_?.*'"),
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
