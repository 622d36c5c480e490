"""What the motion does between samples, in frequency, against records and finite differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import eivor as ev
from eivor.errors import EstimationError
from eivor.estimation import spectral_iv
from eivor.estimation.pair_whitening import PairWhitening, responses
from eivor.estimation.sampled_motion import NoiseModel, SampledMotion, SampledRecord, unitary_bins
from eivor.estimation.spectral_iv import spectral_giv_of_flights
from eivor.flights.prepare import prepare
from eivor.inference.verdict import Status
from eivor.lab.records import Intersample
from eivor.lab.scenario_files import shipped_scenario
from eivor.models.separable import LaggedReferences
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun
from eivor.motions.vertical.motion import Vertical
from tests.flights.flight_logs import FRICTION, GAIN, LAG_S, STEP_S, flown


def motion_of(intersample, blend, samples=801):
    """Motion at the truth of a record without any noise."""
    scenario = replace(
        shipped_scenario("rich"),
        samples=samples,
        noise={},
        noise_to_signal={},
        disturbance=None,
        disturbance_to_signal=None,
        intersample=intersample,
    )
    signals = ev.simulate(scenario, np.random.default_rng(3)).signals
    names = ("acceleration_z", "velocity_z", "input")
    bins = (unitary_bins(signals.channel(name)) for name in names)
    record = SampledRecord(signals.step_s, samples, *bins)
    return SampledMotion(record, scenario.viscous_friction, scenario.input_gain, blend)


def test_the_noise_model_is_the_covariance_of_what_noises_leave():
    """Residuals of simulated noises have the spectrum of the model, within chance."""
    motion, count = motion_of(Intersample.HOLD, 0.0, 4001), 4001
    noise = NoiseModel(0.3, 0.2, 0.4, 0.5, 0.0, 0.0)
    C = noise.spectrum(motion)
    rng = np.random.default_rng(7)

    def series(variance):
        return unitary_bins(np.sqrt(variance) * rng.standard_normal(count))

    ratios: list[float] = []
    for _ in range(10):
        u, v, a, e = (series(item) for item in (0.3, 0.2, 0.4, 0.5))
        first = a + motion.friction * v - motion.gain * u + e
        second = v - motion.response * u + motion.pushed * e
        pair = np.stack([first, second])
        ratios.append(float((pair.conj() * C.solved(pair)).real.sum() / (2 * pair.shape[1])))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


TRUTH = {"viscous_friction": FRICTION, "input_gain": GAIN, "effective_lag": LAG_S}


@cache
def log_of(gust=0.4):
    return flown(seconds=30.0, gust=gust, seed=3)[0]


def identified(method, noise=None):
    return ev.identify_flight(log_of(), method=method, input_map="square", noise=noise)


def problem_of_flight():
    flight = prepare(log_of(), Vertical(), ev.FlightOptions(input_map="square"))
    return Vertical().problem((flight,), LaggedReferences(flight.usable_references))


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_flight_is_told_with_its_lag_and_its_noises():
    result = identified("spectral_giv")
    assert result.verdict.status is Status.IDENTIFIED
    for name, true in TRUTH.items():
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


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_where_generalized_iv_contradicts_it_its_numbers_are_given(monkeypatch):
    monkeypatch.setattr(spectral_iv, "_squared_distance", lambda *_: 100.0)
    result, plain = identified("spectral_giv"), identified("generalized_iv")
    assert result.verdict.status is Status.WEAK
    assert any("generalized IV's numbers" in sentence for sentence in result.verdict.sentences)
    assert result.fit is not None
    assert result.fit.estimate.method == "spectral_giv"
    assert result.quantities["viscous_friction"].value == plain.quantities["viscous_friction"].value


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_equations_without_a_solution_leave_generalized_iv(monkeypatch):
    def fails(*_):
        raise EstimationError("a solution", "none", "Fly more.")

    monkeypatch.setattr(PairWhitening, "first_pass", fails)
    result = identified("spectral_giv")
    assert result.verdict.status is Status.WEAK
    assert any("its equations have no solution" in sentence for sentence in result.verdict.sentences)


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize("method", ["spectral_giv", "whittle_ml"])
def test_without_an_accelerometer_it_is_refused(method):
    log = log_of()
    channels = {name: channel for name, channel in log.channels.items() if name != "specific_force_z"}
    identify_flight = ev.identify_flight(replace(log, channels=channels), method=method, input_map="square")
    assert identify_flight.verdict.status is Status.REFUSED
    assert "accelerometer" in identify_flight.verdict.sentences[0]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_answers_that_are_apart_are_told_and_those_at_another_delay_are_not(monkeypatch):
    problem = problem_of_flight()
    spectral_giv = spectral_giv_of_flights("spectral_giv", problem)
    farthest = spectral_iv.hotelling_quantile(
        spectral_iv.ALLOWED, spectral_giv.theta.size, spectral_iv.COSINE_AVERAGES
    )
    assert spectral_iv._squared_distance(spectral_giv, spectral_giv) == 0.0
    theta = spectral_giv.theta * np.array([1.0, 2.0])
    moved = replace(spectral_giv, solution=replace(spectral_giv.solution, theta=theta))
    assert spectral_iv._squared_distance(spectral_giv, moved) > farthest


def run_of(count, step_s=0.1):
    return SpectralRun(0, count, step_s, (0.04, 4.0))


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_the_second_equation_is_exact_for_an_input_that_is_linear_between_samples():
    K, b, step_s, count = 0.4, 3.0, 0.1, 4000
    time = step_s * np.arange(count)
    u = sum(np.sin(2.0 * np.pi * hertz * time + hertz) for hertz in (0.3, 1.1, 2.3))
    decay = np.exp(-K * step_s)
    prediction = (step_s - (1.0 - decay) / K) / (K * step_s)
    v = np.zeros(count)
    for k in range(count - 1):
        v[k + 1] = decay * v[k] + b * (((1.0 - decay) / K - prediction) * u[k] + prediction * u[k + 1])
    run = run_of(count, step_s)
    columns = run.spectrum(np.column_stack([np.gradient(v, step_s), -v, u]))
    bins = SpectralRegression(
        columns[:, :1], columns[:, 1:], np.empty((run.count, 0), dtype=complex), (), BinRows((run,))
    )
    left = responses(bins)[:, 1] - bins.regressors @ np.array([K, b])
    plain = bins.responses[:, 0] - bins.regressors @ np.array([K, b])
    at_a_line = np.abs(columns[:, 2]) > 0.5 * np.abs(columns[:, 2]).max()
    assert np.abs(left[at_a_line]).max() < 8e-3 * np.abs(b * columns[at_a_line, 2]).max()
    assert np.abs(plain[at_a_line]).max() > 0.1 * np.abs(b * columns[at_a_line, 2]).max()
