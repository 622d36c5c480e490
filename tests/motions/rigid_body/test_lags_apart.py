"""Axes agree about the lag in calm air; not where a delay is given wrong, or air moves the vehicle."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body import verdict as module
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.motions.rigid_body.verdict import LagConsistencyTest, lag_consistency_test
from eivor.simulation.rigid_body import simulate_rigid_body_flights

SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=15.0, seed=2)
ROTORS = SPEC.vehicle.rotors
KNOWN = KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins)
DIRECT = "whitened_least_squares"


def flown(spec):
    """The log of a flight."""
    (flight,) = simulate_rigid_body_flights([spec])
    return flight.recording


@pytest.fixture(scope="module")
def calm():
    """What is told of a flight in calm air."""
    return identify_flight(flown(SPEC), model=RigidBody(KNOWN), method=DIRECT)


def test_axes_agree_in_calm_air(calm, monkeypatch):
    assert lag_consistency_test(calm.fit.estimate) is None
    assert LagConsistencyTest.of_numbers(calm.diagnostics) is None
    monkeypatch.setattr(module, "BEYOND_DOUBT", 2.0)  # tell whatever there is
    result = lag_consistency_test(calm.fit.estimate)
    assert result.p_value > 0.01
    assert list(result.changes_s) == ["roll", "pitch", "yaw", "thrust"]
    lag = calm.quantities["effective_lag"]
    assert result.lag_s == pytest.approx(lag.value)
    assert abs(result.changes_s["roll"]) < 4.0 * lag.std_error


@pytest.mark.thorough
def test_instruments_are_not_second_guessed():
    spec = replace(SPEC, duration=30.0)
    result = identify_flight(flown(spec), model=RigidBody(KNOWN), method="reference_iv")
    assert result.method == "reference_iv"
    assert lag_consistency_test(result.fit.estimate) is None


@pytest.mark.thorough
def test_a_delay_that_was_given_wrong_is_said():
    late = replace(SPEC, vehicle=replace(SPEC.vehicle, rotors=replace(ROTORS, delay=0.01)), duration=30.0)
    vehicle = replace(KNOWN, delay=KnownNumber(0.0))
    flight = identify_flight(flown(late), model=RigidBody(vehicle), method=DIRECT)
    numbers = LagConsistencyTest.of_numbers(flight.diagnostics)
    assert numbers.p_value < 1e-3
    assert numbers.sentence in " ".join(flight.verdict.sentences)
    assert flight.verdict.status is Status.PROVISIONAL
    flight = identify_flight(flown(late), model=RigidBody(KNOWN), method=DIRECT)
    assert LagConsistencyTest.of_numbers(flight.diagnostics) is None


def test_numbers_and_sentences():
    reported = LagConsistencyTest(0.05, {"roll": 0.002, "yaw": -0.2, "thrust": 0.03}, 1e-12)
    assert LagConsistencyTest.of_numbers(reported.numbers) == reported
    assert LagConsistencyTest.of_numbers({}) is None
    assert reported.sentence == (
        "The axes disagree about the lag (p-value 1e-12). For all of them it is 50 ms; by itself "
        "roll asks for 52 ms, yaw for a much shorter one, thrust for a much longer one."
    )
