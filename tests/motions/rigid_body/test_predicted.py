"""Flights under torques from outside: what exogenous signals predict, and what instruments of it tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.disturbances import Arma
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import LaggedReferences
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.regression import predicted_flight
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.simulation.excitation import Multisine
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AxisExcitations, RigidBodyFlightSpec, TorqueDisturbance

BASE = shipped_rigid_body_flight("crazyflie")
#: Onboard low-passes [Hz], the delay of the rotors [s], and torques from outside of 4 rad/s^2 for .3 s.
GYRO_HZ, FORCE_HZ, DELAY_S = 80.0, 30.0, 0.004
DECAY = float(np.exp(-1.0 / (BASE.rate_hz * 0.3)))
SHOVES = TorqueDisturbance(*[Arma(4.0 * float(np.sqrt(1.0 - DECAY**2)), (DECAY,))] * 3)
SWEPT = AxisExcitations(*[Multisine(0.05, 0.3, 8.0)] * 3)


def spec(seed: int, **changes: object) -> RigidBodyFlightSpec:
    sensors = replace(
        BASE.sensors,
        angular_rate=replace(BASE.sensors.angular_rate, cutoff_hz=GYRO_HZ),
        specific_force=replace(BASE.sensors.specific_force, cutoff_hz=FORCE_HZ),
    )
    vehicle = replace(BASE.vehicle, rotors=replace(BASE.vehicle.rotors, delay=DELAY_S))
    controller = replace(BASE.controller, quickness=2.0, derivative_share=1.0)
    made = replace(BASE, vehicle=vehicle, sensors=sensors, controller=controller, seed=seed, injection=SWEPT)
    return replace(made, torque_disturbance=SHOVES, **changes)


def motion(**known: float) -> RigidBody:
    rotors = BASE.vehicle.rotors
    positions = tuple((x, y) for x, y, _ in rotors.positions)
    return RigidBody(KnownVehicle("simulated", positions, rotors.spins, **known))


def flown(*specs: RigidBodyFlightSpec) -> list[RigidBodyFlight]:
    flights = [flight for item in specs for flight in simulate_rigid_body_flights([item])]
    assert all(flight.flew for flight in flights)
    return flights


@pytest.mark.thorough
def test_references_and_sweeps_predict_the_flight_without_what_shoves_it():
    shoved = spec(1, duration=11.0)
    flights = flown(shoved, replace(shoved, torque_disturbance=TorqueDisturbance()))
    disturbed, calm = (prepare(flight.recording, motion(), FlightOptions()) for flight in flights)
    names = [name for name in disturbed.usable_references if name.startswith("injected")]
    assert len(names) == 3  # what is injected serves
    result = predicted_flight(disturbed, motion().layout, LaggedReferences(disturbed.usable_references))
    assert set(result.signals.channels) == set(disturbed.signals.channels)
    used = disturbed.used
    for name in ("angular_rate_x", "angular_rate_y"):
        truth = calm.signals.channel(name)[used]
        predicted = result.signals.channel(name)[used]
        assert np.std(predicted - truth) < 0.7 * np.std(truth)
        shoved_by = disturbed.signals.channel(name)[used] - truth
        assert abs(np.corrcoef(predicted - truth, shoved_by)[0, 1]) < 0.3
    assert np.ptp(result.signals.channel("attitude_w")) == 0.0


@pytest.mark.thorough
def test_shoves_leave_the_gains_of_a_swept_flight_alone_which_least_squares_misses():
    (flight,) = flown(spec(2))
    truth = flight.truth.parameters.torque_gains
    known = motion(gyro_cutoff_hz=GYRO_HZ, accelerometer_cutoff_hz=FORCE_HZ)
    reported = identify_flight(flight.recording, model=known)
    missed = identify_flight(flight.recording, model=known, method="least_squares")
    for name, gain in zip(("roll_gain", "pitch_gain"), truth, strict=False):
        assert reported.quantities[name].value == pytest.approx(gain, rel=0.05)
        assert missed.quantities[name].value != pytest.approx(gain, rel=0.1)
    assert reported.quantities["effective_lag"].value == pytest.approx(0.072 + DELAY_S, rel=0.05)


@pytest.mark.long
def test_gains_of_swept_flights_under_shoves_have_no_bias_and_intervals_that_hold():
    flights = flown(*(spec(seed) for seed in range(12)))
    known = motion(gyro_cutoff_hz=GYRO_HZ, accelerometer_cutoff_hz=FORCE_HZ)
    held = []
    errors = {name: [] for name in ("roll_gain", "pitch_gain", "yaw_gain")}
    for flight in flights:
        result = identify_flight(flight.recording, model=known)
        for (name, error), truth in zip(errors.items(), flight.truth.parameters.torque_gains, strict=True):
            quantity = result.quantities[name]
            error.append(quantity.value / truth - 1.0)
            held.append(quantity.interval[0] <= truth <= quantity.interval[1])
    for name, error in errors.items():
        assert abs(np.mean(error)) < 0.01, name
        assert np.sqrt(np.mean(np.square(error))) < 0.025, name
    assert np.mean(held) >= 0.85
