"""Logs that have not passed the filters of the vehicle file, and logs that have."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import pytest

from eivor.estimation.estimate import Estimate
from eivor.estimation.moments import Instrumental
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.regression import rigid_body_problem
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import FILTERS, FiltersNotPassed
from eivor.simulation.rigid_body import simulate_rigid_body_flights

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
    again = FiltersNotPassed.of_numbers({**filters_not_passed.numbers, "other": 1.0})
    assert again == filters_not_passed
    assert said in filters_not_passed.sentence
    assert "instead of 281" in filters_not_passed.sentence
    assert all(key in filters_not_passed.remedy for key in without)
    assert FiltersNotPassed.of_numbers({"other": 1.0}) is None


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


def stub(J: float) -> Mock:
    """An estimate, as far as its references' disagreement is asked for."""
    best = Mock(over_identification=(J, 0.0), assembler=Instrumental())
    estimate = Mock(spec=Estimate, best=best)
    estimate.method = "reference_iv"
    return estimate


@pytest.mark.thorough
def test_of_a_pool_the_longest_flight_is_asked_and_no_member_by_itself(monkeypatch):
    flight = simulate_rigid_body_flights([replace(BASE, duration=seconds) for seconds in (5.0, 7.0)])
    rotors = BASE.vehicle.rotors
    positions = tuple((x, y) for x, y, _ in rotors.positions)
    known = KnownVehicle("simulated", positions, rotors.spins, gyro_cutoff_hz=CUTOFF_HZ)
    alone = RigidBody(known)
    flights = tuple(prepare(item.recording, alone, FlightOptions()).shortened for item in flight)
    motion = alone.for_flights(flights, FlightOptions())
    problem = rigid_body_problem(flights, motion.layout, NoInstruments())
    requested = []

    def identified(specific, _method):
        requested.append({column.flight for column in specific.columns})
        return stub(100.0 if len(requested) == 1 else 10.0)

    monkeypatch.setattr("eivor.motions.rigid_body.verdict.identify", identified)
    for other in ("observed_order", "steady_wind"):
        monkeypatch.setattr(f"eivor.motions.rigid_body.motion.{other}", lambda *_: None)
    numbers = FiltersNotPassed.of_numbers(motion.diagnostics(problem, stub(300.0), flights))
    assert numbers == FiltersNotPassed(100.0, {"gyro_cutoff_hz": 10.0})
    assert requested == [{1}, {0}]  # with the filter the second flight of the pool, and without it alone
    assert motion.diagnostics(problem, stub(300.0), flights[:1]) == {}
    assert len(requested) == 2
