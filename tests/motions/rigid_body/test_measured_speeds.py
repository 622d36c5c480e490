"""Measured speeds of rotors with noise: what it does to columns, and total least squares that knows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import simulate_rigid_body_flights

BASE = shipped_rigid_body_flight("crazyflie")
ROTORS = BASE.vehicle.rotors
MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
SPEED_STD = 0.005 * BASE.vehicle.hover_speed
NOISE = {"rotor_speed": SPEED_STD, "velocity_x": 0.05, "velocity_y": 0.05, "velocity_z": 0.05}
NOISE |= {f"angular_rate_{axis}": 0.02 for axis in "xyz"}
NAMES = ("roll_gain", "pitch_gain")
NOISE |= {f"specific_force_body_{axis}": 0.5 for axis in "xyz"}


def flown(seconds: float, seed: int):
    sensors = replace(BASE.sensors, rotor_speed=Sensor(WhiteNoise(SPEED_STD)))
    spec = replace(BASE, duration=seconds, seed=seed, sensors=sensors)
    (flight,) = simulate_rigid_body_flights([spec])
    return flight


@pytest.mark.thorough
def test_noise_of_speeds_goes_through_the_map_of_thrust():
    log = flown(5.0, 3).recording
    flight = prepare(log, MOTION, FlightOptions(input="rotor_speed", noise=NOISE)).shortened
    problem = MOTION.problem((flight,), NoInstruments())
    names = [parameter.name for parameter in problem.parameters]
    rows = problem.rows({"actuator_lag": 0.0, "delay": 0.0})
    noise = rows.regressor_noise_covariance()
    thrust = names.index("thrust_gain")
    speeds = flight.signals.family("rotor_speed")[flight.used]
    std = flight.signals.noise["rotor_speed_1"].std
    # one row of six is of the force along z; n^2 has 2 n times the noise of n
    expected = 4.0 * std**2 * float(np.mean((speeds**2).sum(axis=1))) / 6.0
    assert noise[thrust, thrust] == pytest.approx(expected, rel=0.1)
    arms = names.index("roll_gain"), names.index("roll_offset")
    assert abs(noise[arms]) < 0.2 * np.sqrt(noise[arms[0], arms[0]] * noise[arms[1], arms[1]])
    again = problem.rows({"actuator_lag": 0.0, "delay": 0.0}).regressor_noise_covariance()
    np.testing.assert_array_equal(noise, again)


def test_without_declared_noises_nothing_is_known_of_columns():
    log = flown(5.0, 3).recording
    flight = prepare(log, MOTION, FlightOptions(input="rotor_speed")).shortened
    assert MOTION.problem((flight,), NoInstruments()).noisier is None


@pytest.mark.thorough
def test_total_least_squares_is_not_attenuated_by_noise_of_speeds():
    flight = flown(20.0, 7)
    log, truth = flight.recording, flight.truth.parameters.torque_gains

    def errors(method: str, **options):
        result = identify_flight(log, model=MOTION, method=method, input="rotor_speed", **options)
        return [result.quantities[name].value / true - 1.0 for name, true in zip(NAMES, truth, strict=False)]

    plain = errors("whitened_least_squares")
    known = errors("total_least_squares", noise=NOISE)
    assert all(error < -0.03 for error in plain)
    assert all(abs(error) < 0.5 * abs(other) for error, other in zip(known, plain, strict=True))
