"""What a log that holds every fourth command leaves open of gains and lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Counts, QuantityEstimate
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import POINT_WITHIN, all_systematic_uncertainties
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import Logged

SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=4.0, seed=4)
ROTORS = SPEC.vehicle.rotors
VEHICLE = KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins)
MOTION = RigidBody(VEHICLE)
TOLD = {
    "roll_gain": QuantityEstimate(200.0, "rad/s^2/m", 1.0, (198.0, 202.0)),
    "drag_z": QuantityEstimate(0.3, "1/s", 0.01, (0.28, 0.32)),
    "effective_lag": QuantityEstimate(0.05, "s", 1e-4, (0.0498, 0.0502)),
}


def prepared(command_hz: float):
    spec = replace(SPEC, logged=Logged(rotor_command_hz=command_hz))
    (flight,) = simulate_rigid_body_flights([spec])
    return prepare(flight.recording, MOTION, FlightOptions())


def test_every_fourth_command_may_be_another_throughout():
    """How often commands were issued is not told: one millisecond is assumed of at most two."""
    flight = prepared(125.0)
    assert flight.unlogged_step_s == pytest.approx(0.001)
    allowances = all_systematic_uncertainties((flight,), TOLD, VEHICLE)
    (gain,) = allowances["roll_gain"]
    share = 0.701e-3 / 0.05
    assert (gain.counts, gain.below, gain.above) == (Counts.INDEPENDENT, *[pytest.approx(200.0 * share)] * 2)
    assert "1.4 % larger or smaller" in gain.sentence
    by_stamps, by_loops = allowances["effective_lag"]
    assert (by_stamps.counts, by_stamps.above) == (Counts.INDEPENDENT, flight.command_slack_s)
    assert (by_loops.counts, by_loops.above) == (Counts.INDEPENDENT, pytest.approx(0.701e-3))
    assert "drag_z" not in allowances


def test_where_stamps_tell_how_often_only_the_point_is_open():
    reported = replace(prepared(125.0), command_slack_s=0.0)
    (gain,) = all_systematic_uncertainties((reported,), TOLD, VEHICLE)["roll_gain"]
    assert gain.above == pytest.approx(200.0 * 0.5e-3 / 0.05)
    (late,) = all_systematic_uncertainties((reported,), TOLD, VEHICLE)["effective_lag"]
    assert late.above == pytest.approx(0.5e-3)


def test_the_point_is_a_twentieth_beyond():
    """A time up to H, and a point up to half of it away: drawn."""
    rng = np.random.default_rng(1)
    count = 1_000_000
    away = rng.uniform(0.0, 1.0, count) * rng.uniform(0.0, 0.5, count)
    assert np.mean(away > 0.5 * POINT_WITHIN) == pytest.approx(0.05, abs=5.0 * np.sqrt(0.05 * 0.95 / count))


def test_a_log_of_every_command_leaves_nothing_open():
    assert not all_systematic_uncertainties((prepared(0.0),), TOLD, VEHICLE)


@pytest.mark.thorough
def test_a_digital_filter_is_less_late_than_a_continuous_one():
    own_s, digital_s = (
        np.sqrt(2.0) / (2.0 * np.pi * 80.0),
        np.sqrt(2.0) / (1000.0 * np.tan(np.pi * 80.0 / 500.0)),
    )
    allowances = all_systematic_uncertainties((prepared(0.0),), TOLD, replace(VEHICLE, gyro_cutoff_hz=80.0))
    (lag,) = allowances["effective_lag"]
    assert (lag.below, lag.above) == (0.0, pytest.approx(own_s - digital_s))
    (gain,) = allowances["roll_gain"]
    assert (gain.below, gain.above) == (pytest.approx(200.0 * (own_s - digital_s) / 0.05), 0.0)
    assert gain.counts is lag.counts is Counts.ADDED
    assert "drag_z" not in allowances
