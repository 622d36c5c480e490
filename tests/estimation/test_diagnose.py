"""Diagnostics of estimates: folded products against rows, every method, sizes, and what is said."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

import eivor as ev
import shape_checks
from eivor.estimation import methods
from eivor.estimation.diagnose import record_of
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import FOLDED_FROM
from eivor.inference.diagnostics.instruments import endogeneity, strength
from eivor.inference.verdict import Status
from flights.flight_logs import Noise, flights
from flights.flight_logs import problem as flight_problem
from inference.test_strength import equation_products

NOISE = 0.3
"""Standard deviation of the input's noise."""


def autoregression(rng, count, memory):
    shocks = rng.standard_normal(count + 300)
    return np.sqrt(1.0 - memory**2) * lfilter([1.0], [1.0, -memory], shocks)[300:]


def signals(seed, count=2000, *, memory=0.8, noise=NOISE, gain=None, valid=None):
    """Vertical motion with an autocorrelated disturbance and a noisy input; `gain` may vary in time."""
    rng = np.random.default_rng(seed)
    u = autoregression(rng, count, 0.9)
    v = lfilter([0.3], [1.0, -0.7], u)
    s = (0.5 if gain is None else gain) * u - 0.8 * v + 0.3 * autoregression(rng, count, memory)
    channels = {"velocity_z": v, "specific_force_z": s, "input": u + noise * rng.standard_normal(count)}
    stds = {"input": noise, "velocity_z": 0.0, "specific_force_z": 0.3}
    noises = {name: ev.WhiteNoise(std) for name, std in stds.items()}
    return ev.Signals(rate_hz=5.0, channels=channels, noise=noises, valid=valid)


def problem(made, first=0, last=5):
    return ev.VerticalMotion(intercept=False).regression(made, instruments=ev.lags("input", first, last))


def diagnosed(made, method=None):
    return ev.diagnose(ev.identify(problem(made), method or ev.methods.generalized_iv()))


@pytest.mark.parametrize(("period_s", "status"), [(20.3, Status.WEAK), (13.0, Status.IDENTIFIED)])
def test_what_swings_as_the_input_does_leaves_the_estimate_weak(period_s, status):
    """A push beside the line of a square wave is not resolved within the record; one elsewhere is noise."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        times = 0.2 * np.arange(2000)
        u = np.sign(np.sin(2.0 * np.pi * times / 20.0)) + 0.3 * rng.standard_normal(times.size)
        v = lfilter([0.3], [1.0, -0.7], u)
        push = 0.3 * np.sin(2.0 * np.pi * times / period_s + rng.uniform(0.0, 6.0))
        s = 0.5 * u - 0.8 * v + push + 0.1 * autoregression(rng, times.size, 0.8)
        channels = {"velocity_z": v, "specific_force_z": s, "input": u}
        noise = {name: ev.WhiteNoise(0.0) for name in channels}
        made = ev.Signals(rate_hz=5.0, channels=channels, noise=noise)
        fit = ev.identify(problem(made), methods.generalized_iv())
        assert fit.status is status
        assert ("cannot be distinguished from it" in fit.summary()) is (status is Status.WEAK)


@pytest.mark.parametrize("lags", [(0, 10), (2, 5)])
def test_folded_products_are_those_of_rows(lags):
    made = signals(0, FOLDED_FROM + 1237)
    cut = problem(made, *lags)
    rows, noise = cut.rows(), cut.instrument_noise_covariance()
    method = ev.methods.generalized_iv(methods.TwoStage())
    columns = {name: getattr(rows, name) for name in ("response", "regressors", "instruments")}
    arrays = ev.regression(**columns, instrument_noise_covariance=noise)
    folded, plain = (record_of(ev.identify(each, method)) for each in (cut, arrays))
    assert folded.products.counts.size == plain.products.counts.size == 128
    assert folded.products.count == plain.products.count == rows.response.size
    np.testing.assert_allclose(folded.residual, plain.residual, atol=1e-10)
    # blocks differ by a few samples: their sums agree, and so does everything said of the whole
    scale = np.abs(folded.products.instruments.sum(axis=0)).max()
    for name in ("instruments", "cross", "instrument_response", "columns", "power"):
        item, other = (np.sum(getattr(each.products, name), axis=0) for each in (folded, plain))
        np.testing.assert_allclose(item, other, atol=1e-9 * scale)
    np.testing.assert_allclose(folded.products.shared, noise[:, :-1], atol=1e-9)
    np.testing.assert_allclose(plain.products.shared, noise[:, :-1], atol=1e-9)
    np.testing.assert_allclose(folded.weights, plain.weights, rtol=1e-6)


def test_blocks_of_folded_products_are_their_rows():
    made = signals(1, FOLDED_FROM + 1237)
    cut = problem(made)
    solved = ev.identify(cut, ev.methods.generalized_iv())
    record = record_of(solved)
    rows = cut.rows()
    residual = rows.response - rows.regressors @ solved.solution.theta
    Z = np.column_stack([rows.instruments, rows.regressors, residual])
    edges = np.concatenate([[0], np.cumsum(record.products.counts)]).astype(int)
    tested, moving = slice(0, 6), slice(6, 8)
    parts = {"instruments": (tested, tested), "cross": (tested, moving), "instrument_response": (tested, 8)}
    parts |= {"columns": (slice(6, 9), slice(6, 9)), "power": (8, 8)}
    for k in (0, 1, 77, 127):
        current = Z[edges[k] : edges[k + 1]].T @ Z[edges[k] : edges[k + 1]]
        for name, place in parts.items():
            result, near = getattr(record.products, name)[k], 1e-10 * np.abs(current).max()
            np.testing.assert_allclose(result, current[place], atol=near, err_msg=name)


METHODS = {
    "least_squares": ev.methods.least_squares(),
    "total_least_squares": ev.methods.total_least_squares(),
    "bias_compensated_least_squares": ev.methods.bias_compensated_least_squares(),
    "generalized_iv": ev.methods.generalized_iv(),
    "generalized_iv_tls": ev.methods.generalized_iv_tls(),
    "two_step": ev.methods.generalized_iv(methods.TwoStepRobust(bandwidth=5)),
    "extended_iv": ev.methods.extended_iv(),
}


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_diagnosed(method):
    made = problem(signals(3), first=1 if method == "extended_iv" else 0)
    diagnose = ev.diagnose(ev.identify(made, METHODS[method]))
    instrumental = METHODS[method].assembler.needs_instruments
    assert (diagnose.first_stage is not None) == instrumental
    assert (diagnose.over_identification is not None) == instrumental
    assert (diagnose.endogeneity is not None) == instrumental
    assert diagnose.constancy is not None
    assert diagnose.leverage is not None
    assert diagnose.whiteness.durbin_watson < 1.0
    assert diagnose.information.matrix.shape == (2, 2)
    table = diagnose.to_frame()
    assert table.columns == ["diagnostic", "of", "value", "compare"]
    assert ("effective_F" in set(table["diagnostic"])) == instrumental
    text = diagnose.summary()
    assert ("Hansen's J on" in text) == instrumental
    assert all(f"- {reason.sentence}" in text for reason in diagnose.reasons)


def test_samples_without_history_are_left_out():
    valid = np.ones(3000, dtype=bool)
    valid[1000:1100] = False
    result = diagnosed(signals(5, 3000, valid=valid))
    assert result.leverage.segments[-1][1] == result.estimate.rows.response.size
    assert result.over_identification.p_value > 1e-4


@pytest.mark.thorough
def test_frequency_rows_have_their_own_degrees_of_freedom():
    """Not those of the samples, of which there are ten times as many in a band of 5 Hz at 100 Hz."""
    fit = ev.identify(flight_problem(*flights(2, seconds=40.0, noise=Noise())), ev.methods.reference_iv())
    diagnose, rows = ev.diagnose(fit), fit.rows
    weights = record_of(fit).weights
    jacobian = np.column_stack([rows.regressors, fit.nuisance_columns])
    products = equation_products(rows.instruments, jacobian, fit.residuals, 100)
    np.testing.assert_allclose(diagnose.first_stage.conditional, fit.first_stage, rtol=1e-6)
    direct = strength(products)
    assert diagnose.first_stage.cragg_donald == pytest.approx(direct.cragg_donald, rel=1e-6)
    np.testing.assert_allclose(diagnose.first_stage.shea_r_squared, direct.shea_r_squared, rtol=1e-6)
    against = endogeneity(products, weights)
    for name in ("durbin", "durbin_p_value", "wu", "wu_p_value"):
        assert getattr(diagnose.endogeneity, name) == pytest.approx(getattr(against, name), rel=1e-6)


@pytest.mark.calibration
def test_sizes_of_generalized_iv_in_autocorrelated_disturbances():
    """J and constancy with compensated equations: shares of 5 % tests that reject a good estimate."""
    runs = 300
    results = [diagnosed(signals(seed, 1500)) for seed in range(runs)]
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.065])
    assert low <= sum(result.over_identification.p_value < 0.05 for result in results) <= high
    assert low <= sum(result.constancy.p_value < 0.05 for result in results) <= high
    reported = sum(any(reason.status is Status.WEAK for reason in result.reasons) for result in results)
    assert reported <= stats.binom.ppf(1.0 - 1e-4, runs, 0.06)


def test_a_gain_that_changes_is_told_with_its_time():
    count = 4000
    gain = np.where(np.arange(count) < 0.6 * count, 0.5, 1.0)
    result = diagnosed(signals(6, count, gain=gain, memory=0.3))
    sentence = next(r.sentence for r in result.reasons if "change during" in r.sentence)
    assert "input_gain by +0.4" in sentence or "input_gain by +0.5" in sentence
    assert result.constancy.break_at == pytest.approx(0.6, abs=0.05)


def test_a_wrong_declared_noise_is_told():
    made = signals(7, 20_000)
    wrong = replace(made, noise={**made.noise, "input": ev.WhiteNoise(std=0.0)})
    assert any("disagree" in reason.sentence for reason in diagnosed(wrong).reasons)
    assert not any("disagree" in reason.sentence for reason in diagnosed(made).reasons)


DIRECT = [ev.methods.least_squares, ev.methods.total_least_squares, ev.methods.bias_compensated_least_squares]


def arrays(seed, *, shared=0.0, noise=0.5, declared=0.5, instruments=3):
    """Slope 2: `shared` is in regressor and error alike, `noise` is measured with the regressor."""
    rng = np.random.default_rng(seed)
    Z, common, current = rng.standard_normal((400, 3)), *rng.standard_normal((2, 400))
    x = Z.sum(axis=1) + common + current
    y = 2.0 * x + 1.0 + autoregression(rng, 400, 0.5) + shared * common
    return ev.regression(
        response=y,
        regressors=np.column_stack([x + noise * rng.standard_normal(400), np.ones(400)]),
        instruments=np.column_stack([Z[:, :instruments], np.ones(400)]),
        noise_covariance=np.diag([declared**2, 0.0, 1.0]),
        names=("slope", "level"),
    )


@pytest.mark.parametrize("method", DIRECT)
def test_direct_estimates_that_instruments_contradict_are_weak(method):
    made = arrays(1, shared=3.0)
    result = ev.identify(made, method())
    assert result.parameters["slope"] > 2.3
    assert result.status is Status.WEAK
    assert "Use extended_iv" in result.summary()
    instrumental = ev.identify(made, ev.methods.extended_iv(ev.methods.TwoStage()))
    assert instrumental.status is Status.IDENTIFIED
    given = f"they give slope {instrumental.parameters['slope']:.4g}"
    assert f"The instruments contradict it: {given}" in result.reasons[0].sentence
    alone = ev.identify(replace(made, instruments=np.empty((400, 0))), method())
    assert alone.status is Status.IDENTIFIED
    np.testing.assert_array_equal(alone.covariance, result.covariance)


@pytest.mark.parametrize("method", DIRECT[1:])
def test_a_declared_noise_that_instruments_contradict_makes_a_direct_estimate_weak(method):
    assert ev.identify(arrays(2, noise=0.1, declared=1.0), method()).status is Status.WEAK
    assert ev.identify(arrays(2, noise=0.1, declared=0.1), method()).status is Status.IDENTIFIED


def test_instruments_that_say_nothing_contradict_nothing():
    item = ev.identify(arrays(1, shared=3.0, instruments=0), ev.methods.least_squares())
    assert item.status is Status.IDENTIFIED
    made = arrays(1, noise=0.0)
    exact = replace(made, response=made.regressors @ [2.0, 1.0])
    assert ev.identify(exact, ev.methods.least_squares()).status is Status.IDENTIFIED


def test_one_bad_stretch_is_told():
    count = 4000
    gain = np.full(count, 0.5)
    gain[2000:2300] = 8.0
    result = diagnosed(signals(9, count, gain=gain, memory=0.0))
    assert result.leverage.most[1] == 5
    assert result.leverage.segments[5][0] <= 2000 < result.leverage.segments[5][1]


def test_a_drifting_residual_is_told():
    made = signals(10, 4000)
    drift = np.cumsum(np.random.default_rng(0).standard_normal(4000))
    force = {"specific_force_z": made.channels["specific_force_z"] + drift}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = diagnosed(replace(made, channels={**made.channels, **force}))
    assert result.memory.memory > 0.7
    assert any("drifts" in reason.sentence for reason in result.reasons)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_weak_instruments_are_told():
    rng = np.random.default_rng(11)
    u = rng.standard_normal(3000)
    channels = {"velocity_z": rng.standard_normal(3000), "specific_force_z": 0.5 * u, "input": u}
    made = ev.Signals(rate_hz=5.0, channels=channels)
    diagnose = ev.diagnose(ev.identify(problem(made, 1, 5), ev.methods.extended_iv()))
    assert any("hardly move" in r.sentence and r.status is Status.WEAK and r.remedy for r in diagnose.reasons)


def test_short_records_say_less():
    result = diagnosed(signals(13, 26, memory=0.0))
    assert result.constancy is None
    assert result.first_stage is None
    assert result.over_identification is None
    assert "whiteness" in result.summary()


RUNS, COUNT = 250, 600
TRUTH = np.array([0.8, -0.5])
INTERVALS_NOISE = 0.4
CHANCE = 1e-4

least_squares, total = ev.methods.least_squares(), ev.methods.total_least_squares()
compensated = ev.methods.bias_compensated_least_squares()
INTERVALS_METHODS: dict[str, tuple[LinearMethod, str]] = {
    "least squares": (least_squares, "exact"),
    "total least squares": (total, "errors in all"),
    "bias-compensated least squares": (compensated, "errors in regressors"),
    "extended IV": (ev.methods.extended_iv(), "errors in regressors"),
    "extended IV, TLS": (ev.methods.extended_iv_tls(), "errors in regressors"),
    "two-stage": (ev.methods.extended_iv(ev.methods.TwoStage()), "errors in regressors"),
    "two-step GMM": (ev.methods.extended_iv(ev.methods.TwoStepRobust()), "errors in regressors"),
    "generalized IV": (ev.methods.generalized_iv(), "shared"),
    "generalized IV, TLS": (ev.methods.generalized_iv_tls(), "shared"),
    "generalized IV, two-stage": (ev.methods.generalized_iv(ev.methods.TwoStage()), "shared"),
}


def autocorrelated(rng, memory, std, columns):
    shocks = rng.standard_normal((COUNT + 50, columns))
    series = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], shocks, axis=0)
    return np.asarray(std * series[50:])


def problem_intervals(rng, kind):
    """Two slow regressors, an autocorrelated disturbance, and white errors where the kind has them."""
    x = autocorrelated(rng, 0.7, 1.0, 2)
    # Total least squares is told white errors of known covariance; the others allow for any disturbance.
    memory = 0.0 if kind == "errors in all" else 0.6
    y = x @ TRUTH + autocorrelated(rng, memory, INTERVALS_NOISE, 1)[:, 0]
    errors = np.zeros((COUNT, 2)) if kind == "exact" else INTERVALS_NOISE * rng.standard_normal((COUNT, 2))
    noisy = x + errors
    current = INTERVALS_NOISE**2 * np.diag([1.0, 1.0, float(kind == "errors in all")])
    other = x + autocorrelated(rng, 0.3, 0.5, 2)
    instruments, shared = [other, other**3], np.zeros((4, 3))
    if kind == "shared":
        # The noisy regressors are instruments themselves: their noise is known, and taken out.
        instruments.append(noisy)
        shared = np.vstack([shared, current[:2]])
    return ev.regression(
        response=y,
        regressors=noisy,
        instruments=np.column_stack(instruments),
        names=["a", "b"],
        noise_covariance=current,
        instrument_noise_covariance=shared,
    )


def coverage(draw, seed):
    with shape_checks.unchecked():
        hits = np.zeros(2, dtype=int)
        with threadpool_limits(limits=1):  # the matrices are small: threads would wait for each other
            for run in range(RUNS):
                fit = draw(np.random.default_rng([seed, run]))
                ends = [fit.interval(name) for name in fit.names]
                hits += [low <= true <= high for (low, high), true in zip(ends, TRUTH, strict=True)]
    return hits


@pytest.mark.calibration
@pytest.mark.parametrize("name", INTERVALS_METHODS)
def test_default_intervals_cover(name):
    (method, kind), seed = INTERVALS_METHODS[name], list(INTERVALS_METHODS).index(name)
    hits = coverage(lambda rng: ev.identify(problem_intervals(rng, kind), method), seed)
    low, high = stats.binom.ppf(CHANCE, RUNS, 0.92), stats.binom.ppf(1.0 - CHANCE, RUNS, 0.98)
    assert np.all((low <= hits) & (hits <= high)), hits / RUNS
