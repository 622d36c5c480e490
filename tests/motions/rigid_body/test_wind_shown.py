"""A steady wind is told where the vehicle yaws, and spoils the drags across alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import SteadyWind, steady_wind
from eivor.simulation.rigid_body import simulate_rigid_body_flights

SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=8.0, seed=0)
ROTORS = SPEC.vehicle.rotors
MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
AT = {"actuator_lag": ROTORS.lag_up, "delay": ROTORS.delay}
WIND = (2.0, -1.0, 0.0)


@pytest.fixture(scope="module")
def log():
    """Of a flight in a steady wind."""
    (flight,) = simulate_rigid_body_flights([replace(SPEC, wind=replace(SPEC.wind, steady=WIND))])
    return flight.recording


def through_the_air(log):
    """The same log with velocities through the air: a flight in calm."""
    channels = dict(log.channels)
    for axis, speed in zip("xyz", WIND, strict=True):
        channel = channels[f"velocity_{axis}"]
        channels[channel.name] = replace(channel, values=channel.values - speed)
    return replace(log, channels=channels)


def told(log):
    flight = prepare(log, MOTION, FlightOptions())
    return steady_wind(MOTION.problem((flight,), NoInstruments()), AT, (flight,))


def test_a_steady_wind_is_told_and_calm_air_is_not_called_windy(log):
    assert told(through_the_air(log)) is None
    windy = told(log)
    assert (windy.x, windy.y) == pytest.approx(WIND[:2], abs=0.5)
    assert SteadyWind.of_numbers(windy.numbers) == windy
    assert SteadyWind.of_numbers({}) is None


def test_without_velocity_nothing_is_said_of_the_wind(log):
    kept = {name: channel for name, channel in log.channels.items() if not name.startswith("velocity")}
    assert told(replace(log, channels=kept)) is None


@pytest.mark.thorough
def test_drags_across_in_a_wind_are_weak_at_most_and_gains_stay(log):
    flight = identify_flight(log, model=MOTION)
    reasons = {
        name: [reason.sentence for reason in quantity.reasons] for name, quantity in flight.quantities.items()
    }
    for name in ("drag_x", "drag_y"):
        assert any("A steady wind of about 2." in reason for reason in reasons[name])
        assert flight.quantities[name].verdict.value != "identified"
    assert not any("wind of about" in reason for reason in reasons["roll_gain"])
    assert flight.diagnostics["steady_wind_x"] == pytest.approx(WIND[0], abs=0.5)
