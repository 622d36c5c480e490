"""Regularisation and strengths in studies."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.errors import UsageError
from eivor.lab.scenario_files import method_choice
from eivor.lab.study import TARGETS, MethodChoice, Regularisation, trial
from eivor.strict_toml import read_toml
from studies.study_parts import EQUATION, small_study


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


def test_a_trial_is_that_of_the_method():
    study = small_study(methods=(MethodChoice("generalized_iv", (0, 5), regularisation=Regularisation(0.3)),))
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(3,))))
    problem = EQUATION.problem(EQUATION.record(rng), ev.lags("input", 0, 5))
    fit = ev.identify(problem, ev.methods.regularised(ev.methods.generalized_iv(), 0.3))
    label, *_ = (choice.label for choice in study.methods)
    row = trial(study, 3)
    assert [row[f"{label}.{name}"] for name in study.parameters] == list(fit.parameters.values())
    assert row[f"{label}.status"] == "weak"


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
