"""Logs that have not passed the filters of the vehicle file, and logs that have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.inference.verdict import Status
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body import verdict as module
from eivor.motions.rigid_body.motion import FULL_BAND_HZ, RigidBody, in_full_band
from eivor.motions.rigid_body.regression import (
    FORCE_BAND_HZ,
    TURNING_BAND_HZ,
    OnboardFilter,
    as_logged,
    mean_over_step,
)
from eivor.motions.rigid_body.terms import DAMPING, DRAG, GAIN, OFFSET, PITCH_EQUATION, TERMS, THRUST
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.motions.rigid_body.verdict import (
    FILTERS,
    FiltersNotPassed,
    LagConsistencyTest,
    lag_consistency_test,
)
from eivor.signals.filters import low_passed
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import Logged, TorqueDisturbance

BASE = replace(shipped_rigid_body_flight("crazyflie"), duration=12.0, seed=2)
CUTOFF_HZ = 80.0


@pytest.mark.parametrize(
    ("without", "said"),
    [
        ({"gyro_cutoff_hz": 40.0}, "the gyroscope's filter of the vehicle file: without it"),
        (dict.fromkeys(FILTERS, 40.0), "the gyroscope's and the accelerometer's filters of the vehicle file"),
    ],
)
def test_they_are_told_by_the_numbers_of_a_result(without, said):
    filters_not_passed = FiltersNotPassed(281.2, without)
    assert said in filters_not_passed.sentence
    assert "instead of 281" in filters_not_passed.sentence
    assert all(key in filters_not_passed.remedy for key in without)


@pytest.mark.thorough
@pytest.mark.parametrize("passed", [False, True])
def test_a_filter_that_was_not_passed_is_told(passed):
    filtered = replace(BASE.sensors.angular_rate, cutoff_hz=CUTOFF_HZ)
    spec = replace(BASE, sensors=replace(BASE.sensors, angular_rate=filtered)) if passed else BASE
    (flight,) = simulate_rigid_body_flights([spec])
    rotors = BASE.vehicle.rotors
    positions = tuple((x, y) for x, y, _ in rotors.positions)
    vehicle = KnownVehicle("simulated", positions, rotors.spins, gyro_cutoff_hz=CUTOFF_HZ)
    result = identify_flight(flight.recording, model=RigidBody(vehicle))
    reasons = result.verdict.reasons
    reasons_kept = [reason for reason in reasons if "passed the gyroscope's filter" in reason.sentence]
    assert len(reasons_kept) == (0 if passed else 1)
    assert all(reason.status is Status.WEAK for reason in reasons_kept)


STEP_S, ONBOARD_CUTOFF_HZ = 0.002, 30.0
OWN_S = np.sqrt(2.0) / (2.0 * np.pi * ONBOARD_CUTOFF_HZ)
TIME = STEP_S * np.arange(2000)
INNER = slice(200, -200)


def sine(frequency_hz: float, late_s: float = 0.0) -> np.ndarray:
    return np.sin(2.0 * np.pi * frequency_hz * (TIME - late_s))


@pytest.mark.parametrize(
    ("taken_s", "left_s"), [(0.0, OWN_S), (OWN_S, 0.0), (OWN_S + 0.02, 0.0), (0.002, OWN_S - 0.002)]
)
def test_a_delay_that_was_taken_off_the_stamps_is_not_applied_again(taken_s, left_s):
    onboard_filter = OnboardFilter(STEP_S, ONBOARD_CUTOFF_HZ, taken_s)(sine(1.0))
    np.testing.assert_allclose(onboard_filter[INNER], sine(1.0, left_s)[INNER], atol=2e-4)


def test_what_is_more_than_a_delay_is_left():
    result = OnboardFilter(STEP_S, ONBOARD_CUTOFF_HZ, OWN_S)(sine(20.0))[INNER]
    amplitude = np.sqrt(2.0 * np.mean(result**2))
    assert amplitude == pytest.approx(1.0 / np.sqrt(1.0 + (20.0 / ONBOARD_CUTOFF_HZ) ** 4), rel=0.01)


@pytest.mark.usefixtures("unchecked_shapes")
def test_columns_of_filtered_rates_do_not_pass_the_filter_twice():
    sensor = OnboardFilter(STEP_S, ONBOARD_CUTOFF_HZ, 0.0)
    late = low_passed(sine(5.0)[:, None], step_s=STEP_S, cutoff_hz=ONBOARD_CUTOFF_HZ)[:, 0]
    terms = {term.parameter: replace(term, formula=lambda of, _: of) for term in TERMS}
    for parameter in (GAIN[PITCH_EQUATION], OFFSET[PITCH_EQUATION], DRAG[2]):
        np.testing.assert_allclose(as_logged(terms[parameter], sine(5.0), sensor), late)
    damping = as_logged(terms[DAMPING[PITCH_EQUATION]], sine(5.0), sensor)
    np.testing.assert_allclose(damping, mean_over_step(sine(5.0)))
    np.testing.assert_allclose(as_logged(terms[THRUST], sine(5.0), None), sine(5.0))


SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=5.0, seed=2)
ROTORS = SPEC.vehicle.rotors
MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
DIRECT = "whitened_least_squares"


def flown(spec):
    """The log of a flight."""
    (flight,) = simulate_rigid_body_flights([spec])
    return flight.recording


def problem_of(log):
    """The equations of a flight."""
    return MOTION.problem((prepare(log, MOTION, FlightOptions()).shortened,), NoInstruments())


def test_rows_of_turning_reach_up_and_those_of_forces_stay():
    problem = problem_of(flown(SPEC))
    whole = in_full_band(problem)
    assert [column.band_hz for column in whole.columns[:3]] == [(TURNING_BAND_HZ[0], FULL_BAND_HZ)] * 3
    assert {column.band_hz for column in whole.columns[3:]} == {FORCE_BAND_HZ}
    assert in_full_band(whole) is whole
    index = {"actuator_lag": ROTORS.lag_up, "delay": 0.0}
    assert len(whole.bins(index).responses) > 1.5 * len(problem.bins(index).responses)


def test_commands_that_the_log_does_not_hold_end_it():
    slow = problem_of(flown(replace(SPEC, logged=Logged(rotor_command_hz=125.0))))
    assert in_full_band(slow) is slow


@pytest.mark.thorough
def test_what_comes_back_through_the_controller_cancels_in_it():
    """Torques of the air make the lag of the lower band too short, and that of the whole one hardly."""
    air = OrnsteinUhlenbeck(4.0, 0.3)
    spec = replace(SPEC, torque_disturbance=TorqueDisturbance(air, air, air), duration=30.0)
    lower, whole = [], []
    for (flight,) in (simulate_rigid_body_flights([replace(spec, seed=seed)]) for seed in (10, 11, 12, 13)):
        alone = identify(problem_of(flight.recording), by_name(DIRECT))
        assert lag_consistency_test(alone) is not None
        lower.append(alone.parameters["actuator_lag"] + alone.parameters["delay"] - ROTORS.lag_up)
        result = identify_flight(flight.recording, model=MOTION, method=DIRECT)
        assert result.fit.problem.band_hz(0)[1] == FULL_BAND_HZ
        assert "The axes disagree about the lag" in " ".join(result.verdict.sentences)
        whole.append(result.quantities["effective_lag"].value - ROTORS.lag_up)
    assert np.mean(lower) < -0.001
    assert abs(np.mean(whole)) < 0.3 * abs(np.mean(lower))


LAGS_SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=15.0, seed=2)
KNOWN = KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins)


@pytest.fixture(scope="module")
def calm():
    """What is told of a flight in calm air."""
    return identify_flight(flown(LAGS_SPEC), model=RigidBody(KNOWN), method=DIRECT)


def test_axes_agree_in_calm_air(calm, monkeypatch):
    assert lag_consistency_test(calm.fit.estimate) is None
    assert calm.fit.motion_checks.lags is None
    monkeypatch.setattr(module, "BEYOND_DOUBT", 2.0)  # tell whatever there is
    result = lag_consistency_test(calm.fit.estimate)
    assert result.p_value > 0.01
    assert list(result.changes_s) == ["roll", "pitch", "yaw", "thrust"]
    lag = calm.quantities["effective_lag"]
    assert result.lag_s == pytest.approx(lag.value)
    assert abs(result.changes_s["roll"]) < 4.0 * lag.std_error


@pytest.mark.thorough
def test_a_delay_that_was_given_wrong_is_said():
    late = replace(
        LAGS_SPEC, vehicle=replace(LAGS_SPEC.vehicle, rotors=replace(ROTORS, delay=0.01)), duration=30.0
    )
    vehicle = replace(KNOWN, delay=KnownNumber(0.0))
    flight = identify_flight(flown(late), model=RigidBody(vehicle), method=DIRECT)
    numbers = flight.fit.motion_checks.lags
    assert numbers.p_value < 1e-3
    assert numbers.sentence in " ".join(flight.verdict.sentences)
    assert flight.verdict.status is Status.PROVISIONAL
    flight = identify_flight(flown(late), model=RigidBody(KNOWN), method=DIRECT)
    assert flight.fit.motion_checks.lags is None


def test_numbers_and_sentences():
    reported = LagConsistencyTest(0.05, {"roll": 0.002, "yaw": -0.2, "thrust": 0.03}, 1e-12)
    assert reported.sentence == (
        "The axes disagree about the lag (p-value 1e-12). For all of them it is 50 ms; by itself "
        "roll asks for 52 ms, yaw for a much shorter one, thrust for a much longer one."
    )
