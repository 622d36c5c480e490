"""Scenarios from TOML: every kind, and every mistake with the place where it was made."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from eivor.lab.disturbances import paper_disturbance
from eivor.lab.records import Control, DisturbanceRoute, Intersample
from eivor.lab.scenario_files import KINDS as PAGE_KINDS
from eivor.lab.scenario_files import (
    SCENARIOS,
    flight_from_table,
    read_scenario,
    rigid_body_flight_from_table,
    shipped_files,
    shipped_rigid_body_flight,
    shipped_scenario,
)
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import (
    DrydenGust,
    GivenSeries,
    PaperInput,
    RandomSteps,
    ScaledExcitation,
    SteppedExcitation,
)
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.vertical import simulate_vertical_flights
from eivor.strict_toml import read_toml
from validation.pages import page_with

TRUTH = "viscous_friction = 0.293\ninput_gain = 0.021\n"
CONTROL = "[control]\nvelocity_gain=15\n"


@pytest.fixture
def read(tmp_path):
    def reader(text):
        path = tmp_path / "one.toml"
        path.write_text(text, encoding="utf-8")
        return read_scenario(path)

    return reader


def test_what_is_left_out_has_the_scenarios_default(read):
    assert read(TRUTH) == ev.Scenario(0.293, 0.021)
    assert read(TRUTH + 'kind = "vertical"') == ev.Scenario(0.293, 0.021)


def test_everything_can_be_said(read):
    result = read(
        TRUTH
        + """
rate_hz = 10
samples = 500
route = "dynamics"

[control]
altitude_gain = 0.4
velocity_gain = 30
velocity_integral_gain = 5.0

[excitation]
kind = "scaled"
std = 0.04
series = { kind = "paper", variance = 1.0 }

[noise.velocity_z]
kind = "fractional"
order = -0.4
ratio_to_signal = 0.1

[noise.input]
kind = "white"
std = 0.05

[noise.position_z]
kind = "white"
std = 0.02

[disturbance]
kind = "paper"
ratio_to_signal = 0.5
"""
    )
    assert result == ev.Scenario(
        0.293,
        0.021,
        rate_hz=10.0,
        samples=500,
        excitation=ScaledExcitation(PaperInput(1.0), 0.04),
        noise={
            "velocity_z": ev.FractionalNoise(1.0, -0.4),
            "input": ev.WhiteNoise(0.05),
            "position_z": ev.WhiteNoise(0.02),
        },
        noise_to_signal={"velocity_z": 0.1},
        disturbance=paper_disturbance(),
        disturbance_to_signal=0.5,
        route=DisturbanceRoute.DYNAMICS,
        control=Control(30.0, 5.0, 0.4),
    )
    assert read(TRUTH + 'intersample = "linear"').intersample is Intersample.LINEAR
    assert read(TRUTH).control is None
    assert read(TRUTH + CONTROL).control == Control(15.0)


ONES, TENTHS = "1, -1, " * 60, "0.1, -0.1, " * 60
#: A kind with its keys, of disturbances and of excitations.
KINDS = {
    "disturbance": [
        "white; std = 0.1",
        "arma; std = 1; autoregression = [0.5]",
        "random_coefficient_moving_average",
        "threshold_moving_average; thresholds = [0]; coefficients = [[0.1], [0.9]]; delay = 2",
        "garch; floor = 0.1; shocks = [0.85]; largest_square = 1e4",
        "variance_switch; series = { kind = 'white', std = 1.0 }",
        "trend; coefficients = [0, 3]",
        "sinusoids; amplitudes = [2]; frequencies = [0.05]",
        "bounded; bound = 0.1; longest_s = 20; shortest_s = 1",
        "dryden; std = 0.1; length_m = 10; airspeed_mps = 5",
        "sum; parts = [{ kind = 'paper' }, { kind = 'white', std = 1 }]",
        "time_varying_arma; std = 1; autoregression = [{ amplitude = 0.8, cycles = 3 }]",
        f"series; values = [{ONES}]",
        "bilinear; terms = [{ coefficient = 0.3 }, { coefficient = -0.2, series_lag = 4 }]",
    ],
    "excitation": [
        "white",
        "filtered_white; std = 1; low_hz = 0.1; high_hz = 1",
        "chirp; amplitude = 1; low_hz = 0.1; high_hz = 1",
        "multisine; std = 1; low_hz = 0.1; high_hz = 1",
        "pseudo_random_binary; amplitude = 1; register = 7; hold = 2",
        "steps; levels = [1, -1]; dwell_s = 3",
        f"series; values = [{ONES}]",
    ],
}
EVERY = [(section, item) for section, items in KINDS.items() for item in items]


@pytest.mark.parametrize("route", [route.value for route in DisturbanceRoute])
@pytest.mark.parametrize(("section", "item"), EVERY, ids=[item.split(";")[0] for _, item in EVERY])
def test_every_kind_simulates(read, section, item, route):
    """A disturbance moves the vehicle by the dynamics, and by the equation only shifts its response."""
    kind, *keys = item.split("; ")
    lines = [f'{TRUTH}samples = 100\nroute = "{route}"', f"[{section}]", f'kind = "{kind}"', *keys]
    scenario = read("\n".join(lines))
    result = ev.simulate(scenario, np.random.default_rng(1))
    assert np.isfinite(result.signals.channel("acceleration_z")).all()
    calm = ev.simulate(replace(scenario, disturbance=None), np.random.default_rng(1)).truth
    moved = np.any(result.truth.channel("velocity_z") != calm.channel("velocity_z"))
    assert moved == (section == "disturbance" and route == "dynamics")


def test_shipped_scenarios_read_and_simulate():
    names = shipped_files(SCENARIOS)
    assert {"v", "p", "rich", "rich-high", "rich-dynamic", "white"} <= set(names)
    for name in names:
        scenario = shipped_scenario(name)
        assert (scenario.samples, scenario.rate_hz) == (4000, 5.0)
        ev.simulate(scenario, np.random.default_rng(1))


SCENARIO = TRUTH + "samples = 60\n"
VALUES = np.random.default_rng(4).standard_normal(60)


@pytest.fixture
def series(tmp_path, read):
    """Reads a scenario whose excitation is what `values` says."""
    return lambda values: read(f'{SCENARIO}[excitation]\nkind = "series"\nvalues = {values}\n')


def test_a_list_is_the_input(series):
    scenario = series(VALUES.tolist())
    assert scenario.excitation == GivenSeries(tuple(VALUES.tolist()))
    truth = ev.simulate(scenario, np.random.default_rng(0)).truth
    np.testing.assert_array_equal(truth.channel("input"), VALUES)


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
"""


@pytest.fixture
def file(tmp_path):
    return tmp_path / "mine.toml"


def test_everything_is_read(file):
    file.write_text(VEHICLE.replace("0.2", '0.2\ntrajectory = "chirp"', 1) + REST, encoding="utf-8")
    flight = rigid_body_flight_from_table(read_toml(file, "a flight"))
    assert flight.vehicle.rotors.positions[1] == (0.12, -0.12, 0.0)
    assert (flight.vehicle.rotors.spins, flight.vehicle.drag.linear) == ((1, -1, 1, -1), (0.1, 0.1, 0.2))
    assert flight.attitude.roll == RandomSteps(0.2)
    assert flight.attitude.pitch is None
    assert flight.injection.yaw == SteppedExcitation((0.1, -0.1), 0.1)
    assert (flight.wind.steady, flight.wind.z) == ((1.0, 0.0, 0.0), DrydenGust(0.3, 3.0, 2.0))
    assert flight.sensors.angular_rate.noise == ev.FractionalNoise(0.02, -0.2)
    assert flight.sensors.velocity.noise == ev.WhiteNoise(0.05)
    assert flight.sensors.rotor_speed is not None
    assert flight.logged.omitted == ("rotor_command_*",)
    assert (flight.trajectory, flight.duration, flight.seed) == (TrajectoryKind.CHIRP, 0.2, 0)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("name", ["crazyflie", "quadrotor"])
def test_shipped_flights_fly(name):
    (flight,) = simulate_rigid_body_flights([replace(shipped_rigid_body_flight(name), duration=2.5, seed=1)])
    assert flight.flew
    assert np.abs(flight.truth.record.body[:, 10:12]).max() > 0.5
    assert np.abs(flight.truth.record.torque).max() < 1.0


pytest.importorskip("griffe")

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "studies" / "scenarios.md").read_text(encoding="utf-8")


def test_tables_are_fresh():
    parts = runpy.run_path(str(DOCS / "scenario_tables.py"))["parts"]()
    assert page_with(PAGE, parts) == PAGE, "run python -m docs.scenario_tables"


def test_every_kind_has_a_row():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    for kinds in PAGE_KINDS.values():
        assert set(kinds) <= set(rows)


@pytest.mark.thorough
def test_examples_are_read_and_simulated(tmp_path):
    examples = re.findall(r"^```toml\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    about_hover, trends, flight, whole = examples[:4]  # then those of studies
    path = tmp_path / "mine.toml"
    path.write_text(f"viscous_friction = 0.3\ninput_gain = 0.02\nsamples = 100\n{trends}", encoding="utf-8")
    assert ev.simulate(read_scenario(path), np.random.default_rng(0)).signals.sample_count == 100
    path.write_text(about_hover, encoding="utf-8")
    assert ev.simulate(read_scenario(path), np.random.default_rng(0)).signals.sample_count == 4000
    path.write_text(flight, encoding="utf-8")
    (flights,) = simulate_vertical_flights([flight_from_table(read_toml(path, "a flight"))])
    assert flights.flew
    path.write_text(whole.replace("duration = 30.0", "duration = 2.0"), encoding="utf-8")
    flight_of_all = rigid_body_flight_from_table(read_toml(path, "a flight"))
    assert [item.flew for item in simulate_rigid_body_flights([flight_of_all])] == [True]
