"""Scenarios from TOML: every kind, and every mistake with the place where it was made."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import eivor as ev
from eivor.errors import InputError, UsageError
from eivor.lab import scenario_files
from eivor.lab.disturbances import paper_disturbance
from eivor.lab.records import AltitudeControl, DisturbanceRoute, Intersample, OpenLoop, VelocityControl
from eivor.lab.scenario_files import KINDS as PAGE_KINDS
from eivor.lab.scenario_files import (
    SCENARIOS,
    flight_from_table,
    read_scenario,
    read_study,
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
kind = "altitude"
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
        control=AltitudeControl(0.4, 30.0, 5.0),
    )
    assert read(TRUTH + 'intersample = "linear"').intersample is Intersample.LINEAR
    assert read(TRUTH).control == OpenLoop()
    assert read(TRUTH + CONTROL).control == VelocityControl(15.0)


ONES, TENTHS = "1, -1, " * 60, "0.1, -0.1, " * 60
#: A kind with its keys, of disturbances and of excitations.
KINDS = {
    "disturbance": [
        "white; std = 0.1",
        "arma; std = 1; autoregression = [0.5]",
        "random_coefficient_moving_average",
        "threshold_moving_average; thresholds = [0]; coefficients = [[0.1], [0.9]]; delay = 2",
        "bilinear; coefficient = 0.3",
        "garch; floor = 0.1; shocks = [0.85]; largest_square = 1e4",
        "variance_switch; series = { kind = 'white', std = 1.0 }",
        "trend; coefficients = [0, 3]",
        "sinusoids; amplitudes = [2]; frequencies = [0.05]",
        "bounded; bound = 0.1; longest_s = 20; shortest_s = 1",
        "dryden; std = 0.1; length_m = 10; airspeed_mps = 5",
        "sum; parts = [{ kind = 'paper' }, { kind = 'white', std = 1 }]",
        "time_varying_arma; std = 1; autoregression = [{ amplitude = 0.8, cycles = 3 }]",
        f"series; values = [{ONES}]",
        "bilinear_sum; terms = [{ coefficient = 0.3 }, { coefficient = -0.2, series_lag = 4 }]",
        "time_varying_arma; std = 1; autoregression = [{ kind = 'sum', parts = [{ mean = 0.3 }, "
        f"{{ kind = 'series', series = [{TENTHS}] }}] }}]",
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


CONTROL = "[control]\nkind='velocity'\nvelocity_gain=15\n"
WHITE = TRUTH + "[noise.input]\nkind='white'"
WRONG = [
    ("viscous_friction = 0.3", "input_gain of one.toml; received nothing. Add it"),
    (TRUTH + "samples = 1", "samples of 2 or more.*received 1"),
    (TRUTH + "samples = 99_000_000", "50000000 samples or fewer at samples"),
    (TRUTH + "rate_hz = nan", "a finite number at rate_hz"),
    (TRUTH + 'route = "wind"', "one of equation, dynamics at route of one.toml; received 'wind'"),
    (TRUTH + "noise = 3", r"a table \[noise\]"),
    (
        TRUTH + "[noise.specific_force_z]\nkind='white'\nstd=1",
        "velocity_z, acceleration_z, .*at noise of .*'specific_force_z'. A scenario moves about hover",
    ),
    (WHITE, "std or ratio_to_signal at noise.input.*received neither"),
    (WHITE + "\nstd=-1", "zero or more at noise.input.*received std=-1"),
    (WHITE + "\nratio_to_signal=-1", "a finite number >= 0.0 at noise.input.ratio_to_signal"),
    (TRUTH + "[noise.input]\nkind='fractional'\nstd=1\norder=0.7", "at noise.input of.*received order=0.7"),
    (TRUTH + "[disturbance]\nkind='arma'\nstd=1\nautoregression=[1.5]", "stationary.* at disturbance of"),
    (
        TRUTH + "[disturbance]\nkind='threshold_moving_average'\nthresholds=[0]\ncoefficients=[1,2]",
        "a list of numbers at disturbance.coefficients.1. of one.toml; received 1",
    ),
    (TRUTH + "[disturbance]\nkind='sum'\nparts=[]", "one table .*parts.* or more"),
    (TRUTH + CONTROL.replace("15", "1e6"), "loop decays.* at the top of one.toml; received Velocity"),
    (TRUTH + CONTROL.replace("velocity'", "attitude'"), "Did you mean 'altitude'"),
    (TRUTH + CONTROL.replace("velocity'", "altitude'"), "finite number at control.altitude_gain.*nothing"),
    (TRUTH + CONTROL + "altitude_gain=1", "the unknown key 'altitude_gain'"),
    (TRUTH + CONTROL.replace("15", "0"), "velocity_integral_gain at control of.*received both zero"),
    (TRUTH + CONTROL.replace("15", "'fast'"), "a finite number at control.velocity_gain.*received 'fast'"),
    (
        TRUTH + CONTROL + "[noise.position_z]\nkind='white'\nstd=1",
        "received noise of 'position_z'.*under altitude control only",
    ),
    ("viscous_friction = ", "which is not"),
]


@pytest.mark.parametrize(("text", "said"), WRONG, ids=[item[:40] for _, item in WRONG])
def test_mistakes_are_told_with_their_place(read, text, said):
    with pytest.raises(InputError, match=f"(?s)Expected .*{said}") as caught:
        read(text)
    assert "one.toml" in str(caught.value)


def test_missing_files_and_folders(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(InputError, match="a scenario in TOML"):
            read_scenario(path)


def test_shipped_scenarios_read_and_simulate():
    names = shipped_files(SCENARIOS)
    assert {"v", "p", "rich", "rich-high", "rich-dynamic", "white"} <= set(names)
    for name in names:
        scenario = shipped_scenario(name)
        assert scenario.samples == 4000
        assert scenario.rate_hz == 5.0
        ev.simulate(scenario, np.random.default_rng(1))


SCENARIO = TRUTH + "samples = 60\n"
VALUES = np.random.default_rng(4).standard_normal(60)


@pytest.fixture
def series(tmp_path, read):
    """Reads a scenario whose excitation is a column of a file, or what else `values` says."""
    return lambda values: read(f'{SCENARIO}[excitation]\nkind = "series"\nvalues = {values}\n')


def table(**columns):
    return pl.DataFrame({"time": np.arange(60.0), "u": VALUES} | columns)


@pytest.mark.parametrize("name", ["mine.csv", "mine.parquet", "below/mine.CSV"])
def test_column_is_the_input(series, tmp_path, name):
    (tmp_path / "below").mkdir()
    write = pl.DataFrame.write_parquet if name.endswith("parquet") else pl.DataFrame.write_csv
    write(table(), tmp_path / name)
    scenario = series(f'{{ file = "{name}", column = "u" }}')
    assert scenario.excitation == GivenSeries(tuple(VALUES.tolist()))
    truth = ev.simulate(scenario, np.random.default_rng(0)).truth
    np.testing.assert_array_equal(truth.channel("input"), VALUES)


#: Files and columns that are refused, and tables that name none.
REFUSED = [
    ("none.csv:u", "a file that exists at excitation.values.file of one.toml; received 'none.csv'"),
    ("../mine.csv:u", "beside the scenario or in a folder below it"),
    ("link.csv:u", "beside the scenario or in a folder below it"),
    ("loop.csv:u", "beside the scenario or in a folder below it|a file that exists"),
    ("folder.csv:u", "a file that exists"),
    ("below:u", "ends in .csv or .parquet"),
    ("broken.parquet:u", "a table as PARQUET.*'broken.parquet', which is not"),
    ("empty.csv:u", "a table as CSV.*'empty.csv', which is not"),
    ("mine.csv:U", r"a column out of time, u, .*received 'U', not in mine.csv"),
    ("mine.csv:word", "finite numbers in column 'word' of mine.csv.*received 'x'.*See its row 3, not"),
    ("mine.csv:hole", "finite numbers in column 'hole'.*received no value.*row 60"),
    ("mine.csv:infinite", "finite numbers in column 'infinite'.*received 'inf'.*row 1,"),
    ("mine.parquet:flag", "values of Boolean"),
    ("mine.parquet:hole", "no value"),
    ("mine.parquet:nan", "received nan"),
    ('{ file = "mine.csv" }', "a text in quotes at excitation.values.column.*nothing"),
    ('{ column = "u" }', "a text in quotes at excitation.values.file.*nothing"),
    ('{ file = "mine.csv", column = "u", sheet = 2 }', "the unknown key 'sheet'"),
    ('"mine.csv"', "a list of numbers or a table at excitation.values"),
]


@pytest.mark.parametrize(("values", "said"), REFUSED)
def test_series_that_are_refused(series, tmp_path, values, said):
    outside = tmp_path.parent / f"{tmp_path.name}-outside.csv"
    table().write_csv(outside)
    for name in ("below", "folder.csv"):
        (tmp_path / name).mkdir()
    (tmp_path / "link.csv").symlink_to(outside)
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 no more")
    (tmp_path / "empty.csv").write_text("")
    columns = {"hole": [1.0] * 59 + [None], "infinite": [np.inf] + [1.0] * 59}
    table(word=["1", "2", "x", *["4"] * 57], **columns).write_csv(tmp_path / "mine.csv")
    table(flag=[True] * 60, nan=[np.nan] * 60, **columns).write_parquet(tmp_path / "mine.parquet")
    file, _, column = values.partition(":")
    with pytest.raises(InputError, match=f"(?s)Expected .*{said}") as caught:
        series(f'{{ file = "{file}", column = "{column}" }}' if column else values)
    assert "one.toml" in str(caught.value)


def test_what_is_too_large_is_refused(series, tmp_path, monkeypatch):
    table().write_csv(tmp_path / "mine.csv")
    for name, most, words in (
        ("MOST_NUMBERS", 59, "59 numbers"),
        ("LARGEST_BYTES", 100, "a file of 100 bytes"),
    ):
        monkeypatch.setattr(scenario_files, name, most)
        with pytest.raises(InputError, match=f"{words} or fewer"):
            series('{ file = "mine.csv", column = "u" }')


def study_identity(folder, values):
    path = folder / "study.toml"
    body = SCENARIO + f'excitation = {{ kind = "series", values = {values} }}\n'
    path.write_text(f'runs = 2\nseed = 1\n[scenario]\n{body}[[methods]]\nname = "least_squares"\n')
    return read_study(path).identity


def test_a_study_depends_on_the_numbers_and_not_on_the_file(tmp_path):
    table().write_csv(tmp_path / "one.csv")
    table(v=VALUES).write_parquet(tmp_path / "two.parquet")
    changed = VALUES.copy()
    changed[59] += 1e-15
    table(u=changed).write_csv(tmp_path / "three.csv")
    names = {name: f'{{ file = "{name}", column = "u" }}' for name in ("one.csv", "two.parquet", "three.csv")}
    results = {name: study_identity(tmp_path, values) for name, values in names.items()}
    assert results["one.csv"] == results["two.parquet"] == study_identity(tmp_path, str(VALUES.tolist()))
    assert results["one.csv"] == study_identity(tmp_path, '{ file = "two.parquet", column = "v" }')
    assert results["three.csv"] != results["one.csv"]


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
    assert flight.vehicle.rotors.spins == (1, -1, 1, -1)
    assert flight.vehicle.drag.linear == (0.1, 0.1, 0.2)
    assert flight.attitude.roll == RandomSteps(0.2)
    assert flight.attitude.pitch is None
    assert flight.injection.yaw == SteppedExcitation((0.1, -0.1), 0.1)
    assert (flight.wind.steady, flight.wind.z) == ((1.0, 0.0, 0.0), DrydenGust(0.3, 3.0, 2.0))
    assert flight.sensors.angular_rate.noise == ev.FractionalNoise(0.02, -0.2)
    assert flight.sensors.velocity.noise == ev.WhiteNoise(0.05)
    assert flight.sensors.rotor_speed is not None
    assert flight.logged.omitted == ("rotor_command_*",)
    assert (flight.trajectory, flight.duration, flight.seed) == (TrajectoryKind.CHIRP, 0.2, 0)


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("mass = 0.5", "mas = 0.5", r"at vehicle of mine\.toml.*unknown key 'mas'. Did you mean 'mass'"),
        ("spins = [1, -1, 1, -1]", "spins = [1, 0.5]", r"a list of whole numbers at vehicle\.rotors\.spins"),
        ("spins = [1, -1, 1, -1]", "spins = [1, -1]", r"a spin for each at vehicle\.rotors"),
        ("lag_up = 0.02", "lag_up = -0.02", r"lag_up above zero at vehicle\.rotors"),
        ("inertia = [3.65e-3,", "inertia = [-3.65e-3,", r"positive definite at vehicle"),
        ("duration = 0.2", 'duration = 0.2\ntrajectory = "jump"', r"one of steps, .* at trajectory"),
        ("duration = 0.2", "duration = 0.2\nrate_hz = 700.0", r"rate_hz of the controller"),
        ("duration = 0.2", "duration = 3600.0\nrate_hz = 1e4", r"2000000 steps or fewer at duration"),
        ("[wind]", "[wind]\nx = 1.0", r"a table at wind\.x"),
        ('kind = "dryden"', 'kind = "dry"', r"one of paper, .* at wind\.z\.kind"),
    ],
)
def test_wrong_files_are_told(file, right, wrong, message):
    text = VEHICLE + REST
    assert right in text
    file.write_text(text.replace(right, wrong), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        rigid_body_flight_from_table(read_toml(file, "a flight"))


def test_there_is_none_of_that_name():
    with pytest.raises(UsageError, match="a flight out of crazyflie, quadrotor"):
        shipped_rigid_body_flight("helicopter")
    with pytest.raises(UsageError, match=r"a scenario out of arch, .*received 'rihc'"):
        shipped_scenario("rihc")


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
    (tmp_path / "mine.csv").write_text("a1\n" + "0.5\n-0.5\n" * 50, encoding="utf-8")
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
