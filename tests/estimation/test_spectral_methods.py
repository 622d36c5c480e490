"""Spectral methods as users call them: better than generalized IV, honest, and never lost."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import eivor as ev
from eivor.errors import EstimationError, FallbackWarning
from eivor.estimation import sampled_motion, spectral_iv
from eivor.estimation.pair_whitening import (
    PairWhitening,
    corrected_spectrum,
    power_around,
    responses,
    signal_weights,
)
from eivor.estimation.spectral_equations import (
    SpectralSolution,
    _meat,
    consistent_estimate,
    pilot_at,
    shifted,
    solved_equations,
    spectral_covariance,
)
from eivor.estimation.spectral_iv import spectral_giv_of_flights
from eivor.flights.prepare import prepare
from eivor.inference.verdict import Status
from eivor.lab.records import Intersample
from eivor.lab.scenario_files import shipped_scenario
from eivor.models.separable import LaggedReferences
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun
from eivor.motions.vertical.motion import Vertical
from eivor.simulation.excitation import GivenSeries
from tests.flights.flight_logs import FRICTION, GAIN, LAG_S, STEP_S, flown

SPECTRAL = [ev.methods.spectral_giv, ev.methods.spectral_giv_combined, ev.methods.whittle_ml]
TRUTH = (0.293, 0.021)
ON_A_FLIGHT = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def problem_of(name, samples, seed):
    """Problem of a shipped scenario's record."""
    scenario = replace(shipped_scenario(name), samples=samples)
    signals = ev.simulate(scenario, np.random.default_rng(seed)).signals
    channel = scenario.references[0] if scenario.references else "input"
    instruments = ev.lags(channel, 0, 10 if channel == "input" else 20)
    return ev.VerticalMotion(intercept=False).regression(signals, instruments)


def assert_told(result):
    """Both intervals hold the truth."""
    for name, true in zip(result.names[:2], TRUTH, strict=True):
        low, high = result.interval(name)
        assert low < true < high


@pytest.mark.parametrize("method", SPECTRAL)
def test_a_record_is_told_with_shorter_intervals(method):
    problem = problem_of("rich", 2000, 21)
    spectral, plain = ev.identify(problem, method()), ev.identify(problem, ev.methods.generalized_iv())
    # by chance the share between samples is more than three standard errors from zero in this record
    held = "intersample_share" not in ev.identify(problem, ev.methods.spectral_giv()).names
    assert (spectral.status is Status.IDENTIFIED) == (held or spectral.method != "whittle_ml")
    assert spectral.names[:2] == ("viscous_friction", "input_gain")
    assert_told(spectral)
    for name in spectral.names[:2]:
        assert np.ptp(spectral.interval(name)) < 0.9 * np.ptp(plain.interval(name))


@pytest.mark.thorough
def test_errors_are_smaller_than_generalized_ivs():
    errors: dict[str, list[np.ndarray]] = {"spectral": [], "plain": []}
    for seed in range(24):
        problem = problem_of("white", 1000, seed)
        for name, method in (("spectral", ev.methods.spectral_giv), ("plain", ev.methods.generalized_iv)):
            errors[name].append(ev.identify(problem, method()).values[:2] / TRUTH - 1.0)
    rmse = {name: np.sqrt(np.mean(np.square(error), axis=0)) for name, error in errors.items()}
    assert rmse["spectral"][0] < 0.4 * rmse["plain"][0]
    assert rmse["spectral"][1] < rmse["plain"][1]


@pytest.mark.thorough
def test_a_sparse_multisine_is_estimated_near_the_bound():
    """The neighbours of a line hold noise only: a line counts its own power, whatever else a weight reads."""
    samples, records = 4000, 20
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 8)
    cycles = np.round(np.linspace(6.0, 400.0, 8))
    series = 0.5 * np.cos(np.outer(2.0 * np.pi * np.arange(samples) / samples, cycles) + phases).sum(axis=1)
    scenario = replace(
        shipped_scenario("rich"), samples=samples, excitation=GivenSeries(tuple(series.tolist()))
    )
    errors = []
    for seed in range(records):
        signals = ev.simulate(scenario, np.random.default_rng(seed)).signals
        problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 10))
        errors.append(ev.identify(problem, ev.methods.spectral_giv()).values[:2] - TRUTH)
    bound = np.array(list(ev.bounds.cramer_rao(scenario).std_errors.values()))
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    # 1.2, enlarged by what chance does to the RMSE of so few records once in a hundred times
    assert (ratio <= 1.2 * (1.0 + 2.33 / np.sqrt(2.0 * records))).all()


def test_weights_read_their_own_bin_at_lines_only():
    bins = np.random.default_rng(0).normal(size=(2, 300)).T @ [1.0, 1.0j]
    before, around = signal_weights(bins, 0.5), power_around(bins)[100]
    for factor, line in ((11.0, False), (13.0, True)):
        bins[100] = np.sqrt(factor * around)
        expected = (1.0 - 0.5 / (factor * around)) ** 2 if line else before[100]
        assert signal_weights(bins, 0.5)[100] == pytest.approx(expected, rel=1e-9)


def without_noise(problem, *names):
    kept = {name: noise for name, noise in problem.signals.noise.items() if name not in names}
    return replace(problem, signals=replace(problem.signals, noise=kept))


@pytest.mark.parametrize("unknown", [(), ("input",)])
def test_under_control_the_reference_is_the_instrument_whatever_the_noise_of_the_input(unknown):
    problem = without_noise(problem_of("closed-loop", 2000, 5), *unknown)
    assert_told(ev.identify(problem, ev.methods.spectral_giv()))


@pytest.mark.thorough
def test_an_input_that_moves_between_samples_is_found_out():
    scenario = replace(shipped_scenario("rich"), intersample=Intersample.LINEAR, samples=4000)
    doubted = 0
    for seed in range(2, 6):
        signals = ev.simulate(scenario, np.random.default_rng(seed)).signals
        problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 10))
        result = ev.identify(problem, ev.methods.spectral_giv())
        assert result.status is Status.IDENTIFIED
        assert abs(result.parameters["input_gain"] - TRUTH[1]) < 3.0 * result.std_error("input_gain")
        # a likelihood that takes the input as held is 3 % off, which generalized IV tells where it is sharp
        likelihood = ev.identify(problem, ev.methods.whittle_ml())
        assert likelihood.parameters["input_gain"] < 0.98 * TRUTH[1]
        doubted += any("contradicts generalized IV" in reason.sentence for reason in likelihood.reasons)
        assert likelihood.status is Status.WEAK
    assert doubted >= 3


def test_a_likelihood_says_weak_of_an_input_that_is_not_held():
    for seed in range(3):
        result = ev.identify(problem_of("rich-linear", 500, seed), ev.methods.whittle_ml())
        low, high = result.interval("input_gain")
        assert not low <= TRUTH[1] <= high
        assert result.status is Status.WEAK
        assert any("The input is not held between samples" in reason.sentence for reason in result.reasons)
        assert ev.identify(problem_of("rich", 500, seed), ev.methods.whittle_ml()).status is Status.IDENTIFIED


def test_an_unknown_noise_of_a_white_input_is_refused():
    result = ev.identify(without_noise(problem_of("white", 1000, 1), "input"), ev.methods.spectral_giv())
    assert result.status is Status.REFUSED
    assert result.method == "spectral_giv"


@pytest.mark.parametrize("method", SPECTRAL)
def test_where_there_is_no_spectral_answer_generalized_ivs_is_given(method):
    rng = np.random.default_rng(5)  # of nothing but noise generalized IV makes a negative friction
    noise = {name: rng.standard_normal(300) for name in ("velocity_z", "acceleration_z", "input")}
    signals = ev.Signals(5.0, noise, noise={"input": ev.WhiteNoise(0.1)})
    problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 10))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = ev.identify(problem, ev.methods.generalized_iv())
    with pytest.warns(FallbackWarning, match="generalized IV's numbers"):
        result = ev.identify(problem, method())
    np.testing.assert_array_equal(result.values, plain.values)
    assert result.status is Status.WEAK
    assert any("The spectral estimate is not given" in reason.sentence for reason in result.reasons)
    assert np.isfinite(result.interval("input_gain")).all()


@pytest.mark.parametrize("method", SPECTRAL)
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_a_record_without_spectra_gets_generalized_ivs_answer(method):
    whole = problem_of("rich", 500, 1)
    valid = (np.arange(500) < 100) | (np.arange(500) >= 120)
    gap = replace(whole, signals=replace(whole.signals, valid=valid))
    for problem, why, remedy in (
        (problem_of("rich", 50, 1), "there are 50 samples, and it needs 64", "Give a longer record."),
        (gap, "20 of 500 samples are not valid", "stretch between gaps"),
    ):
        with pytest.warns(FallbackWarning, match=why):
            result = ev.identify(problem, method())
        plain = ev.identify(problem, ev.methods.generalized_iv())
        np.testing.assert_array_equal(result.values, plain.values)
        assert result.status is Status.WEAK
        assert why in result.summary()
        assert remedy in result.reasons[-1].remedy


@pytest.mark.parametrize(
    ("part", "why"), [("_doubt", "they differ"), ("_with_blend", "its equations have no solution near")]
)
def test_doubts_and_equations_without_a_solution_leave_generalized_iv_weak(monkeypatch, part, why):
    def made(*_):
        if part == "_doubt":
            return why
        raise EstimationError("a solution", "none", "")

    monkeypatch.setattr(spectral_iv, part, made)
    problem = problem_of("rich", 500, 1)
    with pytest.warns(FallbackWarning, match=why):
        result = ev.identify(problem, ev.methods.spectral_giv())
    np.testing.assert_array_equal(result.values, ev.identify(problem, ev.methods.generalized_iv()).values)
    assert result.status is Status.WEAK


def test_a_short_record_says_what_it_gets():
    result, combined = (ev.identify(problem_of("rich", 300, 1), method()) for method in SPECTRAL[:2])
    np.testing.assert_array_equal(result.values, combined.values)
    assert result.status is Status.IDENTIFIED
    assert "300 samples are fewer than 400: this is the combination" in result.summary()
    assert "fewer than" not in combined.summary()


def test_answers_that_differ_by_chance_are_no_contradiction():
    """Generalized IV's covariance is told by eight averages: the limit is that of Hotelling's T^2."""
    farthest = spectral_iv.FARTHEST
    quantile = spectral_iv.hotelling_quantile(0.999, 2, spectral_iv.COSINE_AVERAGES)
    assert quantile == pytest.approx(farthest, rel=1e-12)
    ratios = np.random.default_rng(2).standard_normal((4000, 10, 2))
    spread = np.einsum("ikj,ikl->ijl", ratios[:, :8], ratios[:, :8]) / 8.0
    separated = np.einsum("ij,ij->i", ratios[:, 9], np.linalg.solve(spread, ratios[:, 9][..., None])[..., 0])
    assert (separated > farthest).mean() < 0.004 < (separated > 13.8).mean()


def complex_normal(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def test_solutions_are_those_of_the_matrices():
    root, pair = (
        complex_normal(np.random.default_rng(0), 5, 2, 2),
        complex_normal(np.random.default_rng(2), 2, 5),
    )
    dense = root @ root.conj().swapaxes(1, 2) + 0.1 * np.eye(2)
    spectrum = sampled_motion.PairSpectrum(dense[:, 0, 0].real, dense[:, 1, 1].real, dense[:, 0, 1])
    expected = np.linalg.solve(dense, pair.T[:, :, None])[:, :, 0].T
    np.testing.assert_allclose(spectrum.solved(pair), expected, rtol=1e-12)


@pytest.fixture
def sampled():
    return sampled_motion.sampled_problem(problem_of("rich", 1001, 11), "spectral_giv")


@pytest.fixture(params=[False, True], ids=["held", "free rho"])
def solution(sampled, request):
    start = sampled_motion.SampledMotion(
        sampled.record, *consistent_estimate(sampled.problem).values[:2].tolist()
    )
    pilot = pilot_at(start, sampled.input_variance)
    return solved_equations(pilot, sampled.input_variance, free_blend=request.param)


def test_the_sensitivity_is_the_derivative_of_the_equations(solution):
    """By the gain, of which no test function is made: what is taken off for the input's noise counts."""
    step = np.array([0.0, 1e-4 * solution.motion.gain, 0.0])
    ends = [replace(solution, motion=shifted(solution.motion, sign * step)).scores() for sign in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / (2.0 * step[1])
    np.testing.assert_allclose(slope[:2], solution.sensitivity[:2, 1], rtol=1e-6)


def test_noise_of_the_input_and_leverage_enlarge_the_covariance(solution, monkeypatch):
    inverse = np.linalg.inv(solution.sensitivity)[: solution.parameters]
    answered = np.tensordot(inverse, solution.tests, axes=1)
    silent = replace(solution, input_variance=0.0)
    by_noise = _meat(solution, inverse, answered) - _meat(silent, inverse, answered)
    assert np.diag(by_noise.sum(axis=2)).min() > 0.0
    enlarged = np.diag(spectral_covariance(solution).model)
    monkeypatch.setattr(SpectralSolution, "leverage", lambda *_: np.zeros(solution.weights.size))
    assert np.all(enlarged > np.diag(spectral_covariance(solution).model))


def test_a_wrong_model_is_corrected_by_the_residuals(solution):
    """Residuals four times as strong as the model has them: most of it is found."""
    C = solution.spectrum
    white = complex_normal(np.random.default_rng(1), 2, C.first.size) / np.sqrt(2)
    top, below, bottom = C.root
    residual = 2.0 * np.stack([top * white[0], below * white[0] + bottom * white[1]])
    spectrum = corrected_spectrum(C, residual, np.zeros(C.first.size))
    ratio = np.median(spectrum.first / C.first), np.median(spectrum.second / C.second)
    np.testing.assert_allclose(ratio, 4.0, rtol=0.12)


# What the motion does between samples, in frequency, against records and finite differences.


def motion_of(intersample, blend, samples=801):
    """Motion at the truth of a record without any noise."""
    silent = {"noise": {}, "noise_to_signal": {}, "disturbance": None, "disturbance_to_signal": None}
    scenario = replace(shipped_scenario("rich"), samples=samples, intersample=intersample, **silent)
    signals = ev.simulate(scenario, np.random.default_rng(3)).signals
    names = ("acceleration_z", "velocity_z", "input")
    bins = (sampled_motion.unitary_bins(signals.channel(name)) for name in names)
    record = sampled_motion.SampledRecord(signals.step_s, samples, *bins)
    return sampled_motion.SampledMotion(record, scenario.viscous_friction, scenario.input_gain, blend)


def test_the_noise_model_is_the_covariance_of_what_noises_leave():
    """Residuals of simulated noises have the spectrum of the model, within chance."""
    motion, count = motion_of(Intersample.HOLD, 0.0, 4001), 4001
    noise = sampled_motion.NoiseModel(0.3, np.array([0.2, 0.4, 0.5]), np.zeros(3))
    C = noise.spectrum(motion)
    rng = np.random.default_rng(7)

    def series(variance):
        return sampled_motion.unitary_bins(np.sqrt(variance) * rng.standard_normal(count))

    ratios: list[float] = []
    for _ in range(10):
        u, v, a, e = (series(item) for item in (0.3, 0.2, 0.4, 0.5))
        first = a + motion.friction * v - motion.gain * u + e
        second = v - motion.response * u + motion.pushed * e
        pair = np.stack([first, second])
        ratios.append(float((pair.conj() * C.solved(pair)).real.sum() / (2 * pair.shape[1])))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


FLIGHT_TRUTH = {"viscous_friction": FRICTION, "input_gain": GAIN, "effective_lag": LAG_S}


@cache
def log_of(gust=0.4):
    return flown(seconds=30.0, gust=gust, seed=3)[0]


def identified(method, noise=None):
    return ev.identify_flight(log_of(), method=method, input_map="square", noise=noise)


@ON_A_FLIGHT
@pytest.mark.thorough
def test_a_flight_is_told_with_its_lag_and_its_noises():
    result = identified("spectral_giv")
    assert result.verdict.status is Status.IDENTIFIED
    for name, true in FLIGHT_TRUTH.items():
        low, high = result.quantities[name].interval
        assert low < true < high
    assert result.fit is not None
    velocity, acceleration, _ = result.fit.estimate.noises
    for noise, std in ((velocity, 0.03), (acceleration, 0.3)):
        at_low_order = std * np.sqrt(2.0 * STEP_S)
        assert noise.strength == pytest.approx(at_low_order, abs=4.0 * noise.strength_error)
        assert abs(noise.order) < 4.0 * noise.order_error
        assert 0.0 < noise.strength_error < 0.5 * at_low_order
    messages = [finding.message for finding in result.findings if finding.name == "fitted_noise"]
    assert len(messages) == 1
    assert "per root of Hz, at 1 Hz" in messages[0]


@ON_A_FLIGHT
@pytest.mark.thorough
def test_where_generalized_iv_contradicts_it_its_numbers_are_given(monkeypatch):
    monkeypatch.setattr(spectral_iv, "_squared_distance", lambda *_: 100.0)
    result, plain = identified("spectral_giv"), identified("generalized_iv")
    assert result.verdict.status is Status.WEAK
    assert any("generalized IV's numbers" in sentence for sentence in result.verdict.sentences)
    assert result.fit is not None
    assert result.fit.estimate.method == "spectral_giv"
    assert result.quantities["viscous_friction"].value == plain.quantities["viscous_friction"].value


@ON_A_FLIGHT
@pytest.mark.thorough
def test_equations_without_a_solution_leave_generalized_iv(monkeypatch):
    def fails(*_):
        raise EstimationError("a solution", "none", "Fly more.")

    monkeypatch.setattr(PairWhitening, "first_pass", fails)
    result = identified("spectral_giv")
    assert result.verdict.status is Status.WEAK
    assert any("its equations have no solution" in sentence for sentence in result.verdict.sentences)


@ON_A_FLIGHT
@pytest.mark.parametrize("method", ["spectral_giv", "whittle_ml"])
def test_without_an_accelerometer_it_is_refused(method):
    log = log_of()
    channels = {name: channel for name, channel in log.channels.items() if name != "specific_force_z"}
    result = ev.identify_flight(replace(log, channels=channels), method=method, input_map="square")
    assert result.verdict.status is Status.REFUSED
    assert "accelerometer" in result.verdict.sentences[0]


@ON_A_FLIGHT
@pytest.mark.thorough
def test_answers_that_are_apart_are_told_and_those_at_another_delay_are_not(monkeypatch):
    flight = prepare(log_of(), Vertical(), ev.FlightOptions(input_map="square"))
    problem = Vertical().problem((flight,), LaggedReferences(flight.usable_references))
    spectral_giv = spectral_giv_of_flights("spectral_giv", problem)
    size = spectral_giv.theta.size
    farthest = spectral_iv.hotelling_quantile(spectral_iv.ALLOWED, size, spectral_iv.COSINE_AVERAGES)
    assert spectral_iv._squared_distance(spectral_giv, spectral_giv) == 0.0
    theta = spectral_giv.theta * np.array([1.0, 2.0])
    moved = replace(spectral_giv, solution=replace(spectral_giv.solution, theta=theta))
    assert spectral_iv._squared_distance(spectral_giv, moved) > farthest


def test_the_second_equation_is_exact_for_an_input_that_is_linear_between_samples():
    K, b, step_s, count = 0.4, 3.0, 0.1, 4000
    time = step_s * np.arange(count)
    u = sum(np.sin(2.0 * np.pi * hertz * time + hertz) for hertz in (0.3, 1.1, 2.3))
    decay = np.exp(-K * step_s)
    prediction = (step_s - (1.0 - decay) / K) / (K * step_s)
    v = np.zeros(count)
    for k in range(count - 1):
        v[k + 1] = decay * v[k] + b * (((1.0 - decay) / K - prediction) * u[k] + prediction * u[k + 1])
    run = SpectralRun(0, count, step_s, (0.04, 4.0))
    columns = run.spectrum(np.column_stack([np.gradient(v, step_s), -v, u]))
    none = np.empty((run.count, 0), dtype=complex)
    bins = SpectralRegression(columns[:, :1], columns[:, 1:], none, (), BinRows((run,)))
    left = responses(bins)[:, 1] - bins.regressors @ np.array([K, b])
    plain = bins.responses[:, 0] - bins.regressors @ np.array([K, b])
    at_a_line = np.abs(columns[:, 2]) > 0.5 * np.abs(columns[:, 2]).max()
    assert np.abs(left[at_a_line]).max() < 8e-3 * np.abs(b * columns[at_a_line, 2]).max()
    assert np.abs(plain[at_a_line]).max() > 0.1 * np.abs(b * columns[at_a_line, 2]).max()
