"""Scenarios from TOML: every kind, and every mistake with the place where it was made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eivor.errors import InputError, UsageError
from eivor.lab.disturbances import (
    CoefficientCourse,
    Garch,
    SumOfDisturbances,
    ThresholdMovingAverage,
    TimeVaryingArma,
    paper_disturbance,
)
from eivor.lab.records import (
    AltitudeControl,
    DisturbanceRoute,
    Intersample,
    OpenLoop,
    Scenario,
    VelocityControl,
    simulate,
)
from eivor.lab.scenario_files import read_scenario, shipped_scenario, shipped_scenarios
from eivor.signals.noise import FractionalNoise, WhiteNoise
from eivor.simulation.excitation import GivenSeries, PaperInput, ScaledExcitation, WhiteDisturbance

TRUTH = "viscous_friction = 0.293\ninput_gain = 0.021\n"


@pytest.fixture
def read(tmp_path):
    def reader(text: str) -> Scenario:
        path = tmp_path / "one.toml"
        path.write_text(text, encoding="utf-8")
        return read_scenario(path)

    return reader


def test_what_is_left_out_has_the_scenarios_default(read):
    assert read(TRUTH) == Scenario(0.293, 0.021)
    assert read(TRUTH + 'kind = "vertical"') == Scenario(0.293, 0.021)


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
    assert result == Scenario(
        0.293,
        0.021,
        rate_hz=10.0,
        samples=500,
        excitation=ScaledExcitation(PaperInput(1.0), 0.04),
        noise={
            "velocity_z": FractionalNoise(1.0, -0.4),
            "input": WhiteNoise(0.05),
            "position_z": WhiteNoise(0.02),
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


KINDS = [
    ("disturbance", 'kind = "white"\nstd = 0.1'),
    ("disturbance", 'kind = "arma"\nstd = 1\nautoregression = [0.5]'),
    ("disturbance", 'kind = "random_coefficient_moving_average"'),
    (
        "disturbance",
        'kind = "threshold_moving_average"\nthresholds = [0]\ncoefficients = [[0.1], [0.9]]\ndelay = 2',
    ),
    ("disturbance", 'kind = "bilinear"\ncoefficient = 0.3'),
    ("disturbance", 'kind = "garch"\nfloor = 0.1\nshocks = [0.85]\nlargest_square = 1e4'),
    ("disturbance", 'kind = "variance_switch"\nseries = { kind = "white", std = 1.0 }'),
    ("disturbance", 'kind = "trend"\ncoefficients = [0, 3]'),
    ("disturbance", 'kind = "sinusoids"\namplitudes = [2]\nfrequencies = [0.05]'),
    ("disturbance", 'kind = "bounded"\nbound = 0.1\nlongest_s = 20\nshortest_s = 1'),
    ("disturbance", 'kind = "dryden"\nstd = 0.1\nlength_m = 10\nairspeed_mps = 5'),
    ("disturbance", 'kind = "sum"\nparts = [{ kind = "paper" }, { kind = "white", std = 1 }]'),
    (
        "disturbance",
        'kind = "time_varying_arma"\nstd = 1\nautoregression = [{ amplitude = 0.8, cycles = 3 }]',
    ),
    ("disturbance", 'kind = "series"\nvalues = [' + "1, -1, " * 60 + "]"),
    (
        "disturbance",
        'kind = "bilinear_sum"\nterms = [{ coefficient = 0.3 }, { coefficient = -0.2, series_lag = 4 }]',
    ),
    (
        "disturbance",
        'kind = "time_varying_arma"\nstd = 1\nautoregression = [{ kind = "sum", parts = [{ mean = 0.3 }, '
        '{ kind = "series", series = [' + "0.1, -0.1, " * 60 + "] }] }]",
    ),
    ("excitation", 'kind = "white"'),
    ("excitation", 'kind = "filtered_white"\nstd = 1\nlow_hz = 0.1\nhigh_hz = 1'),
    ("excitation", 'kind = "chirp"\namplitude = 1\nlow_hz = 0.1\nhigh_hz = 1'),
    ("excitation", 'kind = "multisine"\nstd = 1\nlow_hz = 0.1\nhigh_hz = 1'),
    ("excitation", 'kind = "pseudo_random_binary"\namplitude = 1\nregister = 7\nhold = 2'),
    ("excitation", 'kind = "steps"\nlevels = [1, -1]\ndwell_s = 3'),
    ("excitation", 'kind = "series"\nvalues = [' + "1, -1, " * 60 + "]"),
]


@pytest.mark.parametrize("route", [route.value for route in DisturbanceRoute])
@pytest.mark.parametrize(("section", "body"), KINDS, ids=[body.split('"')[1] for _, body in KINDS])
def test_every_kind_simulates(read, section, body, route):
    """A disturbance moves the vehicle by the dynamics, and by the equation only shifts its response."""
    scenario = read(f'{TRUTH}samples = 100\nroute = "{route}"\n[{section}]\n{body}\n')
    result = simulate(scenario, np.random.default_rng(1))
    assert np.isfinite(result.signals.channel("acceleration_z")).all()
    calm = simulate(replace(scenario, disturbance=None), np.random.default_rng(1)).truth
    moved = np.any(result.truth.channel("velocity_z") != calm.channel("velocity_z"))
    assert moved == (section == "disturbance" and route == "dynamics")


def test_nested_values_arrive(read):
    disturbance = read(f"{TRUTH}[disturbance]\n{KINDS[3][1]}").disturbance
    assert disturbance == ThresholdMovingAverage((0.0,), ((0.1,), (0.9,)), delay=2)
    disturbance = read(f"{TRUTH}[disturbance]\n{KINDS[11][1]}").disturbance
    assert disturbance == SumOfDisturbances((paper_disturbance(), WhiteDisturbance(1.0)))
    disturbance = read(f"{TRUTH}[excitation]\n{KINDS[-1][1]}").excitation
    assert disturbance == GivenSeries((1.0, -1.0) * 60)


CONTROL = "[control]\nkind='velocity'\nvelocity_gain=15\n"
WRONG = [
    ("viscous_friction = 0.3", "input_gain of one.toml; received nothing. Add it"),
    (
        "viscous_frction = 0.3\ninput_gain = 1",
        "unknown key 'viscous_frction'. Did you mean 'viscous_friction'",
    ),
    (TRUTH + "sample = 5", "the unknown key 'sample'. Did you mean 'samples'"),
    (TRUTH + 'samples = "many"', "a whole number at samples of one.toml; received 'many'"),
    (TRUTH + "samples = 4.5", "a whole number at samples"),
    (TRUTH + "samples = 1", "samples of 2 or more.*received 1"),
    (TRUTH + "samples = 99_000_000", "50000000 samples or fewer at samples"),
    (TRUTH + "rate_hz = true", "a finite number at rate_hz of one.toml; received True"),
    (TRUTH + "rate_hz = nan", "a finite number at rate_hz"),
    (TRUTH + "rate_hz = -5", "rate_hz above zero.*received -5.0"),
    (TRUTH + 'route = "wind"', "one of equation, dynamics at route of one.toml; received 'wind'"),
    (TRUTH + 'kind = "lateral"', "one of vertical at kind"),
    (TRUTH + "noise = 3", r"a table \[noise\]"),
    (TRUTH + "[noise.velocity]\nkind='white'\nstd=1", "unknown key 'velocity'. Did you mean 'velocity_z'"),
    (
        TRUTH + "[noise.specific_force_z]\nkind='white'\nstd=1",
        "velocity_z, acceleration_z, .*at noise of .*'specific_force_z'. A scenario moves about hover",
    ),
    (TRUTH + "[noise.input]\nkind='white'", "std or ratio_to_signal at noise.input.*received neither"),
    (TRUTH + "[noise.input]\nkind='white'\nstd=1\nratio_to_signal=1", "noise.input.*received both"),
    (TRUTH + "[noise.input]\nkind='white'\nstd=-1", "zero or more at noise.input.*received std=-1"),
    (
        TRUTH + "[noise.input]\nkind='white'\nratio_to_signal=-1",
        "a finite number >= 0.0 at noise.input.ratio_to_signal",
    ),
    (TRUTH + "[noise.input]\nkind='fractional'\nstd=1\norder=0.7", "at noise.input of.*received order=0.7"),
    (TRUTH + "[noise.input]\nkind='fractional'\nstd=1", "finite number at noise.input.order.*nothing"),
    (TRUTH + "[excitation]\nkind='paper'\nvariance=-0.02", "at excitation of.*received variance=-0.02"),
    (TRUTH + "[noise.input]\nkind='fractal'\nstd=1", "Did you mean 'fractional'"),
    (TRUTH + "[disturbance]\nkind='garsh'", "one of paper, white.*Did you mean 'garch'"),
    (TRUTH + "[disturbance]\nstd=1", "one of paper, white, .* at disturbance.kind.*received nothing"),
    (TRUTH + "[disturbance]\nkind='white'\nstdev=1", "unknown key 'stdev'. Did you mean 'std'"),
    (TRUTH + "[disturbance]\nkind='white'\nstd=1\ncolor=2", "unknown key 'color'"),
    (TRUTH + "[disturbance]\nkind='arma'\nstd=1\nautoregression=[1.5]", "stationary.* at disturbance of"),
    (
        TRUTH + "[disturbance]\nkind='arma'\nstd=1\nautoregression=0.5",
        "a list of numbers or a table at disturbance.",
    ),
    (
        TRUTH + "[disturbance]\nkind='threshold_moving_average'\nthresholds=[0]\ncoefficients=[1,2]",
        "a list of numbers at disturbance.coefficients.1. of one.toml; received 1",
    ),
    (
        TRUTH + "[disturbance]\nkind='threshold_moving_average'\nthresholds=[0]\ncoefficients=3",
        "a list of lists at disturbance.coefficients of one.toml; received 3",
    ),
    (TRUTH + "[disturbance]\nkind='sum'\nparts=[]", "one table .*parts.* or more"),
    (TRUTH + "[disturbance]\nkind='variance_switch'\nseries=1", "a table at disturbance.series"),
    (TRUTH + CONTROL.replace("15", "1e6"), "loop is stable.* at the top of one.toml; received Velocity"),
    (TRUTH + CONTROL.replace("velocity'", "attitude'"), "Did you mean 'altitude'"),
    (TRUTH + CONTROL.replace("velocity'", "altitude'"), "finite number at control.altitude_gain.*nothing"),
    (TRUTH + CONTROL + "altitude_gain=1", "the unknown key 'altitude_gain'"),
    (TRUTH + CONTROL.replace("15", "0"), "velocity_integral_gain at control of.*received both zero"),
    (TRUTH + CONTROL.replace("15", "'fast'"), "a finite number at control.velocity_gain.*received 'fast'"),
    (TRUTH + "control = 'altitude'", "a table at control"),
    (TRUTH + "velocity_gain = 15", "the unknown key 'velocity_gain'"),
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
    names = shipped_scenarios()
    assert {"v", "p", "rich", "rich-high", "rich-dynamic", "white"} <= set(names)
    for name in names:
        scenario = shipped_scenario(name)
        assert scenario.samples == 4000
        assert scenario.rate_hz == 5.0
        simulate(scenario, np.random.default_rng(1))


def test_shipped_scenarios_say_what_the_method_says():
    assert shipped_scenario("arch").disturbance == Garch(0.1, (0.85,), largest_square=1e4)
    assert shipped_scenario("time-varying-arma").disturbance == TimeVaryingArma(
        1.0,
        (CoefficientCourse(amplitude=0.8, cycles=3.0),),
        (CoefficientCourse(amplitude=0.9, cycles=5.0, phase=np.pi / 2.0),),
    )
    closed = shipped_scenario("closed-loop")
    assert closed.control == VelocityControl(15.0, 4.0)
    # The reference is scaled to the standard deviation that z' has in the open loop.
    spread = [
        simulate(shipped_scenario("rich"), stream).truth.channel("velocity_z").std()
        for stream in np.random.default_rng(3).spawn(10)
    ]
    assert isinstance(closed.excitation, ScaledExcitation)
    assert closed.excitation.std == pytest.approx(np.mean(spread), rel=0.02)


def test_unknown_shipped_scenario():
    with pytest.raises(UsageError, match=r"a scenario out of arch, .*received 'rihc'"):
        shipped_scenario("rihc")


def test_scenario_files_are_in_the_package():
    import eivor.lab.scenario_files

    folder = Path(eivor.lab.scenario_files.__file__).parent / "scenarios"
    assert sorted(path.stem for path in folder.glob("*.toml")) == list(shipped_scenarios())


#: RMSE of least squares in per cent, K and K_u: reference errors over the bound times the bound, 200 runs
#: (method page, section 10).
REFERENCE = {
    "v": (9.1 * 0.674, 8.0 * 0.547),
    "rich": (5.3 * 0.565, 7.0 * 0.150),
    "rich-high": (11 * 2.05, 14 * 0.750),
    "rich-dynamic": (4.4 * 1.58, 3.7 * 0.833),
    "white": (6.3 * 1.29, 4.2 * 0.246),
}


@pytest.mark.parametrize("name", REFERENCE)
def test_least_squares_errs_as_the_reference_says(name):
    """Least squares is biased by the noises, so that its error tells their sizes and shapes apart."""
    runs = 60
    scenario = shipped_scenario(name)
    errors = np.empty((runs, 2))
    for run, stream in enumerate(np.random.default_rng(17).spawn(runs)):
        channels = simulate(scenario, stream).signals.channels
        rows = np.column_stack([-channels["velocity_z"], channels["input"]])
        theta = np.linalg.lstsq(rows, channels["acceleration_z"], rcond=None)[0]
        errors[run] = 100.0 * (theta / [0.293, 0.021] - 1.0)
    squares = errors**2
    rmse = np.sqrt(squares.mean(axis=0))
    error = squares.std(axis=0) / (2.0 * rmse)
    # Three standard errors of the difference, and half a unit of the printed digit (at most 5 %).
    allowed = 3.0 * error * np.sqrt(1 / runs + 1 / 200) + 0.03 * rmse
    assert np.all(np.abs(rmse - REFERENCE[name]) < allowed), (rmse, REFERENCE[name], allowed)
