"""Parameters estimated together with noises that nobody declared."""

from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InstrumentError, UsageError
from eivor.estimation.unknown_noise import (
    EquationChoice,
    SharedMoments,
    UnknownNoise,
)
from eivor.lab.scenario_files import shipped_scenario
from eivor.models.signal_regression import shared_noise

INSTRUMENTS = ev.lags("input", 0, 10)
MODEL = ev.VerticalMotion(intercept=False)


def record(name="rich-high", order=0.0, samples=3000, seed=1, **changes):
    scenario = replace(shipped_scenario(name), samples=samples, **changes)
    noise = ev.FractionalNoise(1.0, order) if order else ev.WhiteNoise(1.0)
    scenario = replace(scenario, noise={**scenario.noise, "velocity_z": noise})
    return ev.simulate(scenario, np.random.default_rng(seed)).signals


def undeclared(signals, instruments=INSTRUMENTS):
    return MODEL.regression(replace(signals, noise={}), instruments)


def far(estimate, name, truth):
    return abs(estimate.parameters[name] - truth) / estimate.std_error(name)


@pytest.mark.parametrize(
    ("method", "order"),
    [
        (ev.methods.generalized_iv_unknown_noise(), 0.0),
        (ev.methods.generalized_iv_unknown_noise(orders=("velocity_z",)), -0.4),
        (ev.methods.bias_eliminating_least_squares(), 0.0),
        (ev.methods.frisch_scheme(), 0.0),
    ],
)
def test_parameters_and_noises_are_told(method, order):
    signals = record(order=order)
    estimate = ev.identify(undeclared(signals), method)
    truth = {"viscous_friction": 0.293, "input_gain": 0.021, "noise_order_velocity_z": order}
    for channel in ("input", "velocity_z"):
        truth[f"noise_variance_{channel}"] = signals.noise[channel].std ** 2
    for name in estimate.names:
        if name in truth:
            assert far(estimate, name, truth[name]) < 3.5, name
    assert estimate.std_error("noise_variance_velocity_z") < 0.25 * truth["noise_variance_velocity_z"]
    assert ("noise_order_velocity_z" in estimate.names) == bool(order)
    assert estimate.units[estimate.names.index("noise_variance_velocity_z")] == "(m/s)^2"
    least_squares = ev.identify(undeclared(signals), ev.methods.least_squares())
    assert abs(least_squares.parameters["input_gain"] - 0.021) > 3.0 * estimate.std_error("input_gain")


def test_what_is_declared_is_not_estimated():
    signals = record(samples=1500)
    known = {"input": signals.noise["input"]}
    problem = MODEL.regression(replace(signals, noise=known), INSTRUMENTS)
    estimate = ev.identify(problem, ev.methods.generalized_iv_unknown_noise())
    assert "noise_variance_input" not in estimate.names
    assert "noise_variance_velocity_z" in estimate.names
    exact = ev.identify(MODEL.regression(signals, INSTRUMENTS), ev.methods.generalized_iv_unknown_noise())
    assert exact.names == ("viscous_friction", "input_gain")


def test_a_white_input_is_refused_with_the_reason():
    signals = record("white", samples=2000)
    estimate = ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise())
    assert estimate.status.value == "refused"
    assert any(
        "does not distinguish the input gain from the noises" in reason.sentence
        for reason in estimate.reasons
    )


def test_a_noise_that_is_none_cannot_be_told_from_none():
    signals = record(samples=1500, noise_to_signal={"velocity_z": 0.3, "acceleration_z": 0.2, "input": 0.0})
    estimate = ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise())
    assert estimate.status.value == "weak"
    assert any("input cannot be distinguished from none" in reason.sentence for reason in estimate.reasons)


def test_slopes_are_those_of_what_is_added():
    problem = undeclared(record(samples=400))
    psi = EquationChoice.GENERALIZED.columns(problem, ("velocity_z",))
    whole = MODEL.regression(problem.signals, psi)
    shared = SharedMoments(whole, (UnknownNoise("velocity_z", fractional=True), UnknownNoise("input")))
    known, beta = shared.known(), np.array([0.3, 0.02, 0.04, -0.23, 0.5])
    slopes = shared.added(beta, known)[1]
    for index in range(beta.size):
        step = 1e-6 * np.eye(beta.size)[index]
        prediction, behind = (shared.added(beta + sign * step, known)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, index], (prediction - behind) / 2e-6, rtol=1e-6, atol=1e-8)


def test_noise_of_any_order_adds_what_its_autocovariance_says():
    problem = undeclared(record(samples=400))
    psi = EquationChoice.GENERALIZED.columns(problem, ("velocity_z",))
    shared = SharedMoments(MODEL.regression(problem.signals, psi), ())
    order = -0.317
    signals = replace(
        problem.signals,
        noise={"velocity_z": ev.FractionalNoise(1.0, order), "input": ev.WhiteNoise(0.0)},
    )
    right = (*problem.regressor_columns, problem.equation.response)
    expected = shared_noise(psi, right[:2], signals, shared.problem.first)
    unit = shared.unit(UnknownNoise("velocity_z", fractional=True), order)
    np.testing.assert_allclose(unit[:, :2], expected, rtol=1e-6, atol=1e-9)


def test_schemes_are_choices_of_equations():
    problem = undeclared(record(samples=100))
    names = {choice: [column.name for column in choice.columns(problem, ())] for choice in EquationChoice}
    assert names[EquationChoice.GENERALIZED][-2:] == ["velocity_z(k-1)", "velocity_z(k-2)"]
    assert names[EquationChoice.BIAS_ELIMINATING] == [
        "velocity_z",
        "input",
        *(f"input(k-{lag})" for lag in range(1, 11)),
    ]
    assert "acceleration_z" in names[EquationChoice.FRISCH]


def test_what_it_cannot_use():
    method = ev.methods.generalized_iv_unknown_noise()
    with pytest.raises(UsageError, match="regression of signals"):
        ev.identify(ev.regression(response=np.arange(9.0), regressors=np.ones((9, 1))), method)
    signals = record(samples=200)
    with pytest.raises(UsageError, match="height"):
        ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise(orders=("height",)))
    with pytest.raises(InstrumentError, match="4 unknowns"):
        ev.identify(undeclared(signals, ()), ev.methods.bias_eliminating_least_squares())
    with pytest.raises(UsageError, match="zero lags"):
        ev.methods.generalized_iv_unknown_noise(lags=-1)
