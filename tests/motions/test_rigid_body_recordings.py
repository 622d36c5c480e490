"""The rigid body of a real Crazyflie: logs of its SD card, without setpoints."""

from __future__ import annotations

import pytest

from eivor.inference.verdict import Status
from eivor.logs import read_log
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle

#: Arm [m] and mass [kg] of that vehicle.
ARM, MASS = 0.028, 0.027
VEHICLE = KnownVehicle("Crazyflie", ((ARM, -ARM), (-ARM, -ARM), (-ARM, ARM), (ARM, ARM)), (-1, 1, -1, 1))


@pytest.mark.thorough
def test_roll_and_pitch_manoeuvres_tell_inertias_and_nothing_is_called_identified(recordings):
    log = read_log(recordings / "arpl-crazyflie" / "log15")
    flight = identify_flight(log, model=RigidBody(VEHICLE), window=(15.8, 50.8))
    assert flight.verdict.status is Status.PROVISIONAL  # no setpoint is logged
    thrust = MASS * flight.quantities["thrust_gain"].value
    about_x, about_y = (thrust / flight.quantities[f"{axis}_gain"].value for axis in ("roll", "pitch"))
    assert 1.1e-5 < about_x < 1.4e-5
    assert 1.02 < about_y / about_x < 1.09
    assert 0.045 < flight.quantities["effective_lag"].value < 0.09
    assert not {"drag_x", "drag_y"} & set(flight.quantities)  # no velocity is logged
    assert 0.15 < flight.quantities["drag_z"].value < 0.65
    (yaw,) = [number for number in flight.implications.numbers if number.name == "inertia_zz"]
    assert yaw.value is None
    assert "do not identify Izz" in yaw.sentence
