"""Flights of a whole vehicle from TOML: what is read, what is refused, those that come with the package."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from eivor.errors import InputError, UsageError
from eivor.lab.scenario_files import SHIPPED, read_rigid_body_flight, shipped_rigid_body_flight
from eivor.motions.identify import identify_flight
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import DrydenGust, RandomSteps, SteppedExcitation
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AdaptiveSteps

VEHICLE = """
kind = "rigid-body"
duration = 0.2
[vehicle]
mass = 0.5
inertia = [3.65e-3, 3.68e-3, 7.03e-3]
[vehicle.rotors]
positions = [[0.12, 0.12, 0], [0.12, -0.12, 0], [-0.12, -0.12, 0], [-0.12, 0.12, 0]]
spins = [1, -1, 1, -1]
highest_speed = 1500.0
thrust_quadratic = 5.57e-6
torque_ratio = 0.0244
lag_up = 0.02
lag_down = 0.03
"""
REST = """
[vehicle.drag]
linear = [0.1, 0.1, 0.2]
[attitude.roll]
kind = "random_steps"
amplitude = 0.2
[injection.yaw]
kind = "steps"
levels = [0.1, -0.1]
dwell_s = 0.1
[wind]
steady = [1.0, 0.0, 0.0]
[wind.z]
kind = "dryden"
std = 0.3
length_m = 3.0
airspeed_mps = 2.0
[sensors.angular_rate]
rate_hz = 250.0
cutoff_hz = 80.0
noise = { kind = "fractional", std = 0.02, order = -0.2 }
[sensors.rotor_speed]
[logged]
omitted = ["rotor_command_*"]
[integrator]
kind = "adaptive"
method = "RK45"
rtol = 1e-6
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "mine.toml"


def test_everything_is_read(file):
    file.write_text(VEHICLE.replace("0.2", '0.2\ntrajectory = "chirp"', 1) + REST, encoding="utf-8")
    flight = read_rigid_body_flight(file)
    assert flight.vehicle.rotors.positions[1] == (0.12, -0.12, 0.0)
    assert flight.vehicle.rotors.spins == (1, -1, 1, -1)
    assert flight.vehicle.drag.linear == (0.1, 0.1, 0.2)
    assert flight.attitude.roll == RandomSteps(0.2)
    assert flight.attitude.pitch is None
    assert flight.injection.yaw == SteppedExcitation((0.1, -0.1), 0.1)
    assert (flight.wind.steady, flight.wind.z) == ((1.0, 0.0, 0.0), DrydenGust(0.3, 3.0, 2.0))
    assert flight.sensors.angular_rate.noise == FractionalNoise(0.02, -0.2)
    assert flight.sensors.velocity.noise == WhiteNoise(0.05)
    assert flight.sensors.rotor_speed is not None
    assert flight.logged.omitted == ("rotor_command_*",)
    assert flight.integrator == AdaptiveSteps(rtol=1e-6, method="RK45")
    assert (flight.trajectory, flight.duration, flight.seed) == (TrajectoryKind.CHIRP, 0.2, 0)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("mass = 0.5", "mas = 0.5", r"at vehicle of mine\.toml.*unknown key 'mas'. Did you mean 'mass'"),
        ("mass = 0.5", "mass = 0.5\ncolour = 1", r"the unknown key 'colour'"),
        (
            "spins = [1, -1, 1, -1]",
            "spins = [1, -1, 1, 0.5]",
            r"a list of whole numbers at vehicle\.rotors\.spins",
        ),
        ("spins = [1, -1, 1, -1]", "spins = [1, -1]", r"a spin for each at vehicle\.rotors"),
        ("lag_up = 0.02", "lag_up = -0.02", r"lag_up above zero at vehicle\.rotors"),
        ("inertia = [3.65e-3,", "inertia = [-3.65e-3,", r"positive definite at vehicle"),
        ("duration = 0.2", 'duration = 0.2\ntrajectory = "jump"', r"one of steps, .* at trajectory"),
        ("duration = 0.2", "duration = 0.2\nseed = 1", r"the unknown key 'seed'"),
        ("duration = 0.2", "duration = 0.2\nrate_hz = 700.0", r"rate_hz of the controller"),
        ("duration = 0.2", "duration = 3600.0\nrate_hz = 1e4", r"2000000 steps or fewer at duration"),
        ("[wind]", "[wind]\nx = 1.0", r"a table at wind\.x"),
        ('kind = "dryden"', 'kind = "dry"', r"one of paper, .* at wind\.z\.kind"),
        ("rtol = 1e-6", "rtol = 2.0", r"tolerances above zero.* at integrator"),
        ('kind = "rigid-body"', 'kind = "flight"', r"one of rigid-body at kind"),
    ],
)
def test_wrong_files_are_told(file, right, wrong, message):
    text = VEHICLE + REST
    assert right in text
    file.write_text(text.replace(right, wrong), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_rigid_body_flight(file)


def test_there_is_none_of_that_name():
    with pytest.raises(UsageError, match="a flight out of crazyflie, quadrotor"):
        shipped_rigid_body_flight("helicopter")


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_flights_fly(name):
    (flight,) = simulate_rigid_body_flights([replace(shipped_rigid_body_flight(name), duration=2.5, seed=1)])
    assert flight.flew
    assert np.abs(flight.truth.angular_rate[:, :2]).max() > 0.5
    assert np.abs(flight.truth.torque_setpoint).max() < 1.0


@pytest.mark.long
def test_their_vertical_motion_is_identified():
    """Seeds from zero on, none left out; 95 % intervals of the friction and the input gain."""
    seeds, chance = 4, 1e-3
    spec = shipped_rigid_body_flight("crazyflie")
    flights = simulate_rigid_body_flights([replace(spec, seed=seed) for seed in range(seeds)])
    accepted = held = 0
    for flight in flights:
        fit = identify_flight(flight.recording)
        accepted += fit.verdict.status.value == "identified"
        parameters = flight.truth.parameters
        for name, truth in (
            ("viscous_friction", parameters.drag[2]),
            ("input_gain", 4.0 * parameters.thrust_gain),
        ):
            low, high = fit.interval(name)
            held += low <= truth <= high
    assert accepted >= binom.ppf(chance, seeds, 0.9)
    assert held >= binom.ppf(chance, 2 * seeds, 0.93)
