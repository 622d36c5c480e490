"""What lift turns, against the torques of the simulated rotors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.rigid_body.dynamics import coefficients_of, wrench
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.regression import lift_moments
from eivor.motions.rigid_body.vehicle import (
    FORCE_Z_EQUATION,
    LIFT_MOMENT,
    PITCH_EQUATION,
    ROLL_EQUATION,
    KnownVehicle,
    RotorLayout,
)
from eivor.simulation.rigid_body import simulate_rigid_body_flights

LIFT = 2e-4
SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=4.0, seed=5)
LIFTED = replace(SPEC.vehicle, rotors=replace(SPEC.vehicle.rotors, translational_lift=LIFT))
KNOWN = KnownVehicle("simulated", tuple((x, y) for x, y, _ in LIFTED.rotors.positions), LIFTED.rotors.spins)


def test_lift_turns_as_in_the_simulator():
    air, rates, speeds = (3.0, -2.0, 0.5), (0.3, -0.7, 1.9), (1500.0, 1600.0, 1700.0, 1550.0)
    turned = [wrench(coefficients_of(item), air, rates, speeds)[1] for item in (LIFTED, SPEC.vehicle)]
    moments = lift_moments(RotorLayout(KNOWN), np.array(air)[:, None], np.array([rates[2]]))
    expected = np.subtract(*np.array(turned, dtype=np.float64))[:2]
    assert LIFT * moments[:, 0] == pytest.approx(expected, rel=1e-9)
    assert np.abs(expected).min() > 1e-7


def test_the_equations_of_roll_and_pitch_have_what_lift_turns():
    (flight,) = simulate_rigid_body_flights([SPEC])
    motion = RigidBody(KNOWN)
    problem = motion.problem((prepare(flight.recording, motion, FlightOptions()),), NoInstruments())
    assert (problem.band_hz(ROLL_EQUATION)[1], problem.band_hz(FORCE_Z_EQUATION)[1]) == (20.0, 8.0)
    for axis, parameter in enumerate(LIFT_MOMENT):
        index = problem.parameters.index(parameter)
        moved = [bool(column.fixed[:, index].any()) for column in problem.columns]
        assert moved == [column.axis == (ROLL_EQUATION, PITCH_EQUATION)[axis] for column in problem.columns]
