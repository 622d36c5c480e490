"""What a log that holds every fourth command leaves open of gains and lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import InputError
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Counts, QuantityEstimate
from eivor.flights.verdict import VerdictInputs, systematic_uncertainties
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody, refuse_other_turns
from eivor.motions.rigid_body.regression import body_velocity
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.motions.rigid_body.verdict import PARTS as TABLE
from eivor.motions.rigid_body.verdict import RigidBodyChecks, filter_early_s, steady_wind
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import Sensor
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


def open_parts(flight, cutoff_hz=None):
    """Systematic parts of a flight with the filter of a gyroscope."""
    checks = RigidBodyChecks(filter_early_s=filter_early_s(cutoff_hz, flight.rates_hz["roll"]))
    of_flight = VerdictInputs((flight,), 100.0, 100.0, True, False, checks=checks, quantities=TOLD)
    return systematic_uncertainties(TABLE, of_flight)


def test_every_fourth_command_may_be_another_throughout():
    """How often commands were issued is not told: one millisecond is assumed of at most two."""
    flight = prepared(125.0)
    assert flight.unlogged_step_s == pytest.approx(0.001)
    allowances = open_parts(flight)
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
    (gain,) = open_parts(reported)["roll_gain"]
    assert gain.above == pytest.approx(200.0 * 0.5e-3 / 0.05)
    (late,) = open_parts(reported)["effective_lag"]
    assert late.above == pytest.approx(0.5e-3)


def test_a_log_of_every_command_leaves_nothing_open():
    assert not open_parts(prepared(0.0))


REFUSED_SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=6.0, seed=8)
REFUSED_MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
PARTS = [f"attitude_{part}" for part in "wxyz"]


@pytest.fixture(scope="module")
def log() -> Recording:
    (flight,) = simulate_rigid_body_flights([REFUSED_SPEC])
    return flight.recording


def with_values(log: Recording, **values: np.ndarray) -> Recording:
    changed = {name: replace(log.channel(name), values=value) for name, value in values.items()}
    return replace(log, channels={**log.channels, **changed})


def attitude(log: Recording) -> np.ndarray:
    return np.stack([log.channel(name).values for name in PARTS])


def prepared_refused(log: Recording):
    return prepare(log, REFUSED_MOTION, FlightOptions())


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
        prepared_refused(with_values(log, **wrong))
    assert read_as in str(refused.value)


def test_opposite_quaternions_are_the_same_attitude(log):
    signs = np.where(np.arange(attitude(log).shape[1]) % 7 < 3, 1.0, -1.0)
    flipped = with_values(log, **dict(zip(PARTS, signs * attitude(log), strict=True)))
    result, expected = (body_velocity(prepared_refused(item).signals) for item in (flipped, log))
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
        prepared_refused(with_values(log, **equal))
    spins = np.array(ROTORS.spins)[:, None]
    unturned = dict(zip(names, values - spins * (spins * values).mean(axis=0), strict=True))
    with pytest.raises(InputError, match="never turn it about yaw"):
        prepared_refused(with_values(log, **unturned))


WIND_SPEC = replace(shipped_rigid_body_flight("crazyflie"), duration=8.0, seed=0)
WIND_MOTION = RigidBody(KnownVehicle("x", tuple((x, y) for x, y, _ in ROTORS.positions), ROTORS.spins))
AT = {"actuator_lag": ROTORS.lag_up, "delay": ROTORS.delay}
WIND = (2.0, -1.0, 0.0)


@pytest.fixture(scope="module")
def log_wind():
    """Of a flight in a steady wind."""
    (flight,) = simulate_rigid_body_flights([replace(WIND_SPEC, wind=replace(WIND_SPEC.wind, steady=WIND))])
    return flight.recording


def through_the_air(log_wind):
    """The same log with velocities through the air: a flight in calm."""
    channels = dict(log_wind.channels)
    for axis, speed in zip("xyz", WIND, strict=True):
        channel = channels[f"velocity_{axis}"]
        channels[channel.name] = replace(channel, values=channel.values - speed)
    return replace(log_wind, channels=channels)


def told(log_wind):
    flight = prepare(log_wind, WIND_MOTION, FlightOptions())
    return steady_wind(WIND_MOTION.problem((flight,), NoInstruments()), AT, (flight,))


def test_a_steady_wind_is_told_and_calm_air_is_not_called_windy(log_wind):
    assert told(through_the_air(log_wind)) is None
    windy = told(log_wind)
    assert (windy.x, windy.y) == pytest.approx(WIND[:2], abs=0.5)


def test_without_velocity_nothing_is_said_of_the_wind(log_wind):
    kept = {name: channel for name, channel in log_wind.channels.items() if not name.startswith("velocity")}
    assert told(replace(log_wind, channels=kept)) is None


@pytest.mark.thorough
def test_drags_across_in_a_wind_are_weak_at_most_and_gains_stay(log_wind):
    flight = identify_flight(log_wind, model=WIND_MOTION)
    reasons = {
        name: [reason.sentence for reason in quantity.reasons] for name, quantity in flight.quantities.items()
    }
    for name in ("drag_x", "drag_y"):
        assert any("A steady wind of about 2." in reason for reason in reasons[name])
        assert flight.quantities[name].verdict.value != "identified"
    assert not any("wind of about" in reason for reason in reasons["roll_gain"])
    assert flight.diagnostics["steady_wind_x"] == pytest.approx(WIND[0], abs=0.5)


BASE = shipped_rigid_body_flight("crazyflie")
MEASURED_ROTORS = BASE.vehicle.rotors
MEASURED_MOTION = RigidBody(
    KnownVehicle("x", tuple((x, y) for x, y, _ in MEASURED_ROTORS.positions), MEASURED_ROTORS.spins)
)
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
    flight = prepare(log, MEASURED_MOTION, FlightOptions(input="rotor_speed", noise=NOISE)).shortened
    problem = MEASURED_MOTION.problem((flight,), NoInstruments())
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
    flight = prepare(log, MEASURED_MOTION, FlightOptions(input="rotor_speed")).shortened
    assert MEASURED_MOTION.problem((flight,), NoInstruments()).noisier is None


@pytest.mark.thorough
def test_total_least_squares_is_not_attenuated_by_noise_of_speeds():
    flight = flown(20.0, 7)
    log, truth = flight.recording, flight.truth.parameters.torque_gains

    def errors(method: str, **options):
        result = identify_flight(log, model=MEASURED_MOTION, method=method, input="rotor_speed", **options)
        return [result.quantities[name].value / true - 1.0 for name, true in zip(NAMES, truth, strict=False)]

    plain = errors("whitened_least_squares")
    known = errors("total_least_squares", noise=NOISE)
    assert all(error < -0.03 for error in plain)
    assert all(abs(error) < 0.5 * abs(other) for error, other in zip(known, plain, strict=True))
