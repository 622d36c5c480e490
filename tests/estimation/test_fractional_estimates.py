"""Estimates of fractional difference equations: exact without noise, settled, and covered by intervals."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import eivor as ev
from eivor.errors import (
    CollinearError,
    ConvergenceError,
    InstrumentError,
    MissingNoiseError,
    TooFewSamplesError,
    UsageError,
)
from eivor.estimation import methods, unknown_noise
from eivor.estimation.linear import refined_nuisances
from eivor.estimation.unknown_noise import EquationChoice, SharedMoments, UnknownNoise, long_memory_covariance
from eivor.lab.scenario_files import shipped_scenario
from eivor.models.signal_regression import shared_noise

ORDER = ev.UnknownOrder("order", 0.3, 1.1)
MODEL = ev.FractionalDifferenceModel((0.0, ORDER), (0.0,))
TRUTH = {"output_coefficient_2": 8.0, "input_coefficient_1": 1.0, "order": 0.7}
REACH = (0, 1, 2, 4, 8, 16, 32)
LAGS = tuple(ev.Column("input", lag) for lag in REACH)
REFERENCE = tuple(ev.Column("reference", lag) for lag in REACH)
METHODS = {
    "least_squares": (methods.least_squares(), ()),
    "total_least_squares": (methods.total_least_squares(), ()),
    "bias_compensated_least_squares": (methods.bias_compensated_least_squares(), ()),
    "extended_iv": (methods.extended_iv(), REFERENCE),
    "extended_iv_tls": (methods.extended_iv_tls(), REFERENCE),
    "generalized_iv": (methods.generalized_iv(), LAGS),
    "generalized_iv_two_stage": (methods.generalized_iv(methods.TwoStage()), LAGS),
    "generalized_iv_tls": (methods.generalized_iv_tls(), LAGS),
}


def record(seed=0, count=1500, noise_ratio=0.01, model=MODEL, truth=TRUTH, shape=None):
    """Record of the equation, driven by an input with memory, with both its signals noisy."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(count)
    driven = np.convolve(white, 0.8 ** np.arange(60))[:count]
    true = {"output": model.simulate(truth, driven), "input": driven}
    noise = {
        name: (shape or ev.WhiteNoise(1.0)).with_std(noise_ratio * series.std())
        for name, series in true.items()
    }
    measured = {name: series + noise[name].sample(count, rng) for name, series in true.items()}
    return ev.Signals(1.0, measured | {"reference": driven}, noise=noise)


@pytest.mark.parametrize("name", METHODS)
def test_without_noise_every_method_finds_the_truth(name):
    method, instruments = METHODS[name]
    result = ev.identify(MODEL.problem(record(noise_ratio=0.0), instruments), method)
    assert result.parameters == pytest.approx(TRUTH, rel=1e-8)


@pytest.mark.parametrize("name", METHODS)
def test_known_orders_are_a_linear_problem(name):
    method, instruments = METHODS[name]
    model = ev.FractionalDifferenceModel((0.0, 0.7), (0.0,))
    result = ev.identify(model.problem(record(noise_ratio=0.0), instruments), method)
    assert result.parameters == pytest.approx({k: v for k, v in TRUTH.items() if k != "order"}, rel=1e-9)


def test_the_estimate_is_one_like_all_others():
    problem = MODEL.problem(record(noise_ratio=0.05), LAGS)
    result = ev.identify(problem, methods.generalized_iv())
    for name, value in TRUTH.items():
        low, high = result.interval(name, 0.999)
        assert low < value < high
    assert result.covariance.shape == (3, 3)
    time_constant = ev.derived(result, lambda item: item["output_coefficient_2"] ** (1.0 / item["order"]))
    assert time_constant.interval[0] < 8.0 ** (1.0 / 0.7) < time_constant.interval[1]
    assert "order" in result.summary()
    assert result.with_covariance(ev.covariances.Classical()).std_error("order") > 0.0


@pytest.mark.parametrize(
    ("method", "instruments", "error", "text"),
    [
        (methods.generalized_iv(), LAGS, MissingNoiseError, "a declared noise of channel 'input'"),
        (methods.bias_compensated_least_squares(), (), MissingNoiseError, "a declared noise of channel"),
        (
            methods.generalized_iv(),
            LAGS[:2],
            InstrumentError,
            "at least 3 independent instruments for 3 unknowns",
        ),
        (methods.whitened_least_squares(), (), UsageError, "a flight, whose runs have spectra"),
    ],
)
def test_what_a_method_lacks_is_told(method, instruments, error, text):
    known = record()
    bare = ev.Signals(1.0, known.channels)
    with pytest.raises(error, match=text):
        ev.identify(MODEL.problem(bare, instruments), method)


def test_instruments_that_share_noise_are_refused_by_methods_that_do_not_compensate():
    """Past inputs are no way out: a difference of the input has the noise of all of them in it."""
    model = ev.FractionalDifferenceModel((0.0, ORDER), (0.0, 0.5))
    with pytest.raises(InstrumentError, match="whose measurement noise no regressor"):
        ev.identify(model.problem(record(), ev.lags("input", 1, 10)), methods.extended_iv())


def test_too_short_a_record_is_refused():
    with pytest.raises(TooFewSamplesError, match="more rows than the 3 unknowns"):
        ev.identify(MODEL.problem(record(count=3)), methods.least_squares())
    with pytest.raises(TooFewSamplesError, match="Give a longer record"):
        ev.identify(MODEL.problem(record(count=8), LAGS), methods.generalized_iv())


def test_an_order_outside_its_range_is_told():
    model = ev.FractionalDifferenceModel((0.0, ev.UnknownOrder("order", 0.2, 0.5)), (0.0,))
    with pytest.raises(ConvergenceError, match=r"inside the range of order; received one at its end, 0\.5"):
        ev.identify(model.problem(record()), methods.total_least_squares())


def test_an_order_that_the_data_do_not_tell_is_told():
    """Without an output there is nothing that one order explains better than another."""
    signals = record()
    flat = ev.Signals(1.0, dict(signals.channels) | {"output": np.zeros(1500)})
    with pytest.raises(CollinearError, match="is zero"):
        ev.identify(MODEL.problem(flat), methods.least_squares())


def test_steps_that_never_end_are_told():
    problem = MODEL.problem(record(noise_ratio=0.0))

    class Wandering:
        """Asks for a change of the same size, forth and back."""

        calls = 0

        def __call__(self, linear):
            solved = methods.least_squares().solve(linear)
            if len(linear.parameters) == 3:
                type(self).calls += 1
                solved.solution.theta[-1] = 0.1 * (-1.0) ** self.calls
            return solved

    with pytest.raises(ConvergenceError, match="steps of order that end"):
        refined_nuisances(problem, Wandering(), {"order": 0.7})


INSTRUMENTS = ev.lags("input", 0, 10)
UNKNOWN_MODEL = ev.VerticalMotion(intercept=False)


def record_unknown(name="rich-high", order=0.0, samples=3000, seed=1, **changes):
    scenario = replace(shipped_scenario(name), samples=samples, **changes)
    noise = ev.FractionalNoise(1.0, order) if order else ev.WhiteNoise(1.0)
    scenario = replace(scenario, noise={**scenario.noise, "velocity_z": noise})
    return ev.simulate(scenario, np.random.default_rng(seed)).signals


def undeclared(signals, instruments=INSTRUMENTS):
    return UNKNOWN_MODEL.regression(replace(signals, noise={}), instruments)


def test_a_white_input_is_refused_with_the_reason():
    signals = record_unknown("white", samples=2000)
    estimate = ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise())
    assert estimate.status.value == "refused"
    assert any(
        "does not distinguish the input gain from the noises" in reason.sentence
        for reason in estimate.reasons
    )


def test_noise_of_any_order_adds_what_its_autocovariance_says():
    problem = undeclared(record_unknown(samples=400))
    psi = EquationChoice.GENERALIZED.columns(problem, ("velocity_z",))
    shared = SharedMoments(UNKNOWN_MODEL.regression(problem.signals, psi), ())
    order = -0.317
    signals = replace(
        problem.signals, noise={"velocity_z": ev.FractionalNoise(1.0, order), "input": ev.WhiteNoise(0.0)}
    )
    right = (*problem.regressor_columns, problem.equation.response)
    expected = shared_noise(psi, right[:2], signals, shared.problem.first)
    unit = shared.unit(UnknownNoise("velocity_z", fractional=True), order)
    np.testing.assert_allclose(unit[:, :2], expected, rtol=1e-6, atol=1e-9)


def test_what_it_cannot_use():
    method = ev.methods.generalized_iv_unknown_noise()
    with pytest.raises(UsageError, match="regression of signals"):
        ev.identify(ev.regression(response=np.arange(9.0), regressors=np.ones((9, 1))), method)
    signals = record_unknown(samples=200)
    with pytest.raises(UsageError, match="height"):
        ev.identify(undeclared(signals), ev.methods.generalized_iv_unknown_noise(orders=("height",)))
    with pytest.raises(InstrumentError, match="4 unknowns"):
        ev.identify(undeclared(signals, ()), ev.methods.bias_eliminating_least_squares())
    with pytest.raises(UsageError, match="zero lags"):
        ev.methods.generalized_iv_unknown_noise(lags=-1)


def test_errors_of_noises_add_up_those_of_all_lags():
    """Of independent white series the sum of products has the product of their powers as its variance."""
    rng = np.random.default_rng(4)
    count = 4000
    influence, error = rng.standard_normal((count, 2)), 3.0 * rng.standard_normal(count)
    covariance = long_memory_covariance(influence, error)
    np.testing.assert_allclose(np.diag(covariance) / count, [9.0, 9.0], rtol=0.2)
    assert abs(covariance[0, 1]) < 0.2 * covariance[0, 0]
    # of an instrument that is the error before and after, twice the powers, and as much again for the answers
    around = np.roll(error, 1) + np.roll(error, -1)
    assert long_memory_covariance(around[:, None], error)[0, 0] / count > 1.5 * 2.0 * 81.0


def weights_of(psi, error):
    """Soderstrom's covariance of sums of instruments times errors, over the root of their number."""
    rows = SimpleNamespace(instruments=psi, response=error, regressors=np.zeros((error.size, 0)))
    fit = SimpleNamespace(cross=np.zeros((psi.shape[1], 1)), rows=rows, _count=error.size)
    return unknown_noise._MomentSearch._covariance(fit, np.zeros(0))


def test_weights_of_unknown_noise_allow_for_memory_and_for_answers():
    rng = np.random.default_rng(8)
    white = rng.standard_normal((2, 20_000))
    slow = lfilter([0.6], [1.0, -0.8], white)  # of variance one
    # of independent series with memory the sum of products of their correlations, 1.64 / 0.36
    assert 3.0 < weights_of(slow[:1].T, slow[1])[0, 0] < 5.0
    # of an instrument that is the error before and after: two, and as much again for the answers
    error = white[0]
    around = np.roll(error, 1) + np.roll(error, -1)
    assert weights_of(around[:, None], error)[0, 0] == pytest.approx(4.0, rel=0.1)
