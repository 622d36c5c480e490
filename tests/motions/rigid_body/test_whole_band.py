"""The whole band: where it reaches, and what it is worth in air that turns the vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import FULL_BAND_HZ, RigidBody, in_full_band
from eivor.motions.rigid_body.regression import FORCE_BAND_HZ, TURNING_BAND_HZ
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import lag_consistency_test
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import Logged, TorqueDisturbance

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
