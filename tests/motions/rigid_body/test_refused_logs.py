"""What is refused at once: attitudes in another order, rates in degrees, rotors that never differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import InputError
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.regression import body_velocity
from eivor.motions.rigid_body.select import refuse_other_turns
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.signals.recording import Recording
from eivor.simulation.rigid_body import simulate_rigid_body_flights

SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=6.0, seed=8)
ROTORS = SPEC.vehicle.rotors
MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
PARTS = [f"attitude_{part}" for part in "wxyz"]


@pytest.fixture(scope="module")
def log() -> Recording:
    (flight,) = simulate_rigid_body_flights([SPEC])
    return flight.recording


def with_values(log: Recording, **values: np.ndarray) -> Recording:
    changed = {name: replace(log.channel(name), values=value) for name, value in values.items()}
    return replace(log, channels={**log.channels, **changed})


def attitude(log: Recording) -> np.ndarray:
    return np.stack([log.channel(name).values for name in PARTS])


def prepared(log: Recording):
    return prepare(log, MOTION, FlightOptions())


@pytest.mark.parametrize(
    ("order", "signs", "read_as"),
    [
        ((1, 2, 3, 0), (1, 1, 1, 1), "only when it is read as x, y, z, w."),
        ((0, 1, 2, 3), (1, -1, -1, -1), "only when it is read as w, x, y, z from world to body"),
        ((1, 2, 3, 0), (-1, -1, -1, 1), "only when it is read as x, y, z, w from world to body"),
    ],
)
def test_another_order_is_named(log, order, signs, read_as):
    parts = attitude(log)
    wrong = {name: s * parts[item] for name, item, s in zip(PARTS, order, signs, strict=True)}
    with pytest.raises(InputError) as refused:
        prepared(with_values(log, **wrong))
    assert read_as in str(refused.value)


def test_opposite_quaternions_are_the_same_attitude(log):
    signs = np.where(np.arange(attitude(log).shape[1]) % 7 < 3, 1.0, -1.0)
    flipped = with_values(log, **dict(zip(PARTS, signs * attitude(log), strict=True)))
    result, expected = (body_velocity(prepared(item).signals) for item in (flipped, log))
    np.testing.assert_allclose(result, expected, atol=1e-9)


def test_rates_in_degrees_are_told_by_the_attitude(log):
    rates = [log.channel(f"angular_rate_{axis}") for axis in "xyz"]
    parts = [log.channel(name) for name in PARTS]
    refuse_other_turns(parts, rates, log.name)
    degrees = [replace(rate, values=np.rad2deg(rate.values)) for rate in rates]
    with pytest.raises(InputError, match="57 times as fast as the attitude"):
        refuse_other_turns(parts, degrees, log.name)


def test_rotors_that_never_differ_are_refused_with_the_axes_that_they_do_not_turn(log):
    names = [f"rotor_command_{number}" for number in (1, 2, 3, 4)]
    values = np.stack([log.channel(name).values for name in names])
    equal = dict.fromkeys(names, values.mean(axis=0))
    with pytest.raises(InputError, match="never turn it about roll, pitch, yaw"):
        prepared(with_values(log, **equal))
    spins = np.array(ROTORS.spins)[:, None]
    unturned = dict(zip(names, values - spins * (spins * values).mean(axis=0), strict=True))
    with pytest.raises(InputError, match="never turn it about yaw"):
        prepared(with_values(log, **unturned))
