"""Simulations, scenarios and vehicles that are refused, each with its place and the remedy."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_disturbances import STEP_S, rng, sampled
from test_scenario_files import CONTROL as VELOCITY
from test_scenario_files import REST, SCENARIO, TRUTH, VEHICLE
from test_simulate import CONTROL, FALLING, OPEN, QUIET, QUIET_BODY, fly_body, with_rotors

import eivor as ev
from eivor.errors import InputError, ParameterError, UsageError
from eivor.lab import disturbances as d
from eivor.lab import scenario_files as files
from eivor.lab.records import Intersample
from eivor.simulation import excitation as e
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import SensorNoise
from eivor.simulation.rigid_body import Logged, Sensors, Wind
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from eivor.strict_toml import read_toml
from refusal_rows import calls, rows, table

DISTURBANCES = calls("disturbance", ParameterError,
    (lambda: e.WhiteDisturbance(-1.0), "a finite std of zero or more; received std=-1.0"),
    (lambda: d.Arma(1.0, (1.0,)), r"stationary autoregression.*multiplied by 1 each step"),
    (lambda: d.Arma(1.0, (0.5, 0.6)), "stationary autoregression"),
    (lambda: d.Arma(float("nan")), "a finite std of zero or more; received std=nan"),
    (lambda: d.TimeVaryingArma(1.0, (d.CoefficientCourse(0.5, 0.6),)), "stationary at every time"),
    (lambda: d.RandomCoefficientMovingAverage((1.0,), (-1.0,)), "a finite std of a coefficient of zero"),
    (lambda: d.ThresholdMovingAverage((0.0,), ((0.1,), (0.2,)), delay=0), "delay of 1 or more"),
    (lambda: d.GivenDisturbance((1.0, float("nan"))), "a finite value"),
    (lambda: d.Bilinear((d.BilinearTerm(1.0),)), "below one, so that the series is stationary; received 1"),
    (lambda: d.Garch(0.1, (0.5,), (0.5,)), "add up to less than one.*received 1"),
    (lambda: d.Garch(0.1, (0.5,), largest_square=0.0), "a finite largest_square above zero"),
    (lambda: d.VarianceSwitch(e.WhiteDisturbance(1.0), at=1.5), "a share of the record from 0 to 1"),
    (lambda: d.Trend(()), "one or more coefficients"),
    (lambda: d.Sinusoids((1.0,), (-1.0,)), "a finite frequency of zero or more"),
    (lambda: d.BoundedAdversary(1.0, 2.0, 1.0, 1.1), "a high_share from 0 to 1"),
    (lambda: d.SumOfDisturbances(()), "one or more parts"),
    (lambda: e.DrydenGust(1.0, 0.0, 1.0), "a finite length_m above zero"),
    (lambda: e.WhiteExcitation(float("nan")), "a finite std"),
    (lambda: sampled(e.FilteredWhite(1.0, 0.1, 2.5)), "below half the rate; received high_hz=2.5 at 5 Hz"),
    (lambda: sampled(e.Chirp(1.0, 0.1, 3.0)), "ends below half the rate"),
    (lambda: sampled(e.Multisine(1.0, 0.1001, 0.1002), 50), "holds a multiple of 0.1 Hz"),
    (lambda: e.PseudoRandomBinary(1.0, 5, 0), "hold of 1 or more"),
    (lambda: e.RandomSteps(0.2, 2.0, 1.0), "a shortest_s up to longest_s"),
    (lambda: e.SteppedExcitation((1.0,), 0.0), "a finite dwell_s above zero"),
    (lambda: e.GivenSeries((1.0, float("inf"))), "a finite value"),
    (lambda: e.ScaledExcitation(e.PaperInput(), -1.0), "a finite std of zero or more"),
    (lambda: sampled(e.GivenSeries((1.0, 2.0, 3.0)), 4), r"a series of 4 values or more.*received 3"),
    (lambda: d.GivenDisturbance((0.1,) * 20).sample(21, STEP_S, rng()), "a series of 21 values or more"),
)  # fmt: skip
PARTS = calls("part", ParameterError,
    (lambda: FlightController(quickness=3.0), "quickness between"),
    (lambda: Sensor(delay_s=-1.0), "delay_s between"),
    (lambda: Sensor(bias=float("nan")), "a finite bias"),
    (lambda: Sensors(attitude=Sensor(cutoff_hz=5.0)), "averaged part by part"),
    (lambda: Wind((1.0, 2.0)), "three speeds"),
    (lambda: Logged(setpoint_hz=-1.0), "setpoint_hz between"),
    (lambda: replace(QUIET_BODY, rate_hz=1.0), "rate_hz between"),
    (lambda: replace(QUIET_BODY, duration=0.0), "duration between"),
    (lambda: replace(QUIET_BODY, rate_hz=400.0), "rate_hz of the controller"),
    (lambda: replace(QUIET_BODY, controller=FlightController(attitude_hz=200.0)), "attitude_hz of"),
    (lambda: replace(QUIET_BODY, vehicle=with_rotors(delay=0.003)), "multiple of 0.002 s"),
    (lambda: fly_body(replace(QUIET_BODY, vehicle=with_rotors(spins=(1,) * 4))), "torque about each axis"),
    (lambda: fly_body(replace(QUIET_BODY, sensors=Sensors(angular_rate=Sensor(cutoff_hz=300.0)))),
        "below half the simulation's rate"),
)  # fmt: skip
SCENARIOS = rows("scenario", ParameterError, lambda change: ev.simulate(replace(OPEN, **change), rng()),
    ({"viscous_friction": -0.1}, "viscous_friction of zero or more; received viscous_friction=-0.1"),
    ({"viscous_friction": float("nan")}, "viscous_friction of zero or more; received viscous_friction=nan"),
    ({"input_gain": float("inf")}, "a finite input_gain"),
    ({"noise_to_signal": {"u": 0.1}}, "received noise of 'u'"),
    ({"disturbance_to_signal": 0.1}, "a disturbance to scale; received disturbance_to_signal alone"),
    (FALLING, "disturbance_to_signal of zero or more; received .*=-0.1"),
    (CONTROL | {"intersample": Intersample.LINEAR}, "held between samples.*'linear'"),
    ({"disturbance_to_signal": 0.1, "disturbance": e.WhiteDisturbance(0.0)}, "a disturbance that varies"),
)  # fmt: skip
SPECIFICATIONS = rows("specification", UsageError,
    lambda wrong: SensorNoise(**wrong["noise"]) if "noise" in wrong else VerticalFlightSpec(**wrong),
    ({"viscous_friction": 0.0}, "viscous_friction between"),
    ({"actuator_lag": float("nan")}, "actuator_lag between"),
    ({"delay": 0.005}, "a multiple of 0.002"),
    ({"quickness": 2.0}, "quickness between"),
    ({"duration": 1.0}, "duration between"),
    ({"noise": {"velocity": -0.1}}, "a finite velocity of zero or more"),
)  # fmt: skip
NAMES = calls("name", UsageError,
    (lambda: list(simulate_vertical_flights([QUIET, replace(QUIET, duration=9.0)])),
        "flights of one duration"),
    (lambda: files.shipped_rigid_body_flight("helicopter"), "a flight out of crazyflie, quadrotor"),
    (lambda: files.shipped_scenario("rihc"), r"a scenario out of arch, .*received 'rihc'"),
)  # fmt: skip


def of_scenario(text, tmp_path):
    (tmp_path / "one.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"one\.toml") as refused:
        files.read_scenario(tmp_path / "one.toml")
    raise refused.value


WHITE = TRUTH + "[noise.input]\nkind='white'"
MISTAKES = rows("mistake in a scenario", InputError, of_scenario,
    ("viscous_friction = 0.3", "input_gain of one.toml; received nothing. Add it"),
    (TRUTH + "samples = 1", "samples of 2 or more.*received samples=1"),
    (TRUTH + "samples = 99_000_000", "50000000 samples or fewer at samples"),
    (TRUTH + "rate_hz = nan", "a finite number at rate_hz"),
    (TRUTH + 'route = "wind"', "one of equation, dynamics at route of one.toml; received 'wind'"),
    (TRUTH + "noise = 3", r"a table \[noise\]"),
    (TRUTH + "[noise.specific_force_z]\nkind='white'\nstd=1",
        "velocity_z, acceleration_z, .*at noise of .*'specific_force_z'. A scenario moves about hover"),
    (WHITE, "std or ratio_to_signal at noise.input.*received neither"),
    (WHITE + "\nstd=-1", "zero or more at noise.input.*received std=-1"),
    (WHITE + "\nratio_to_signal=-1", "a finite number >= 0.0 at noise.input.ratio_to_signal"),
    (TRUTH + "[noise.input]\nkind='fractional'\nstd=1\norder=0.7", "at noise.input of.*received order=0.7"),
    (TRUTH + "[disturbance]\nkind='arma'\nstd=1\nautoregression=[1.5]", "stationary.* at disturbance of"),
    (TRUTH + "[disturbance]\nkind='threshold_moving_average'\nthresholds=[0]\ncoefficients=[1,2]",
        "a list of numbers at disturbance.coefficients.1. of one.toml; received 1"),
    (TRUTH + "[disturbance]\nkind='sum'\nparts=[]", "one table .*parts.* or more"),
    (TRUTH + VELOCITY.replace("15", "1e6"),
        "loop decays.* at the top of one.toml; received Control"),
    (TRUTH + VELOCITY + "altitude_gian=1", "the unknown key 'altitude_gian'.*altitude_gain"),
    (TRUTH + VELOCITY + "altitude_gain=-1", "a finite altitude_gain of zero or more"),
    (TRUTH + VELOCITY.replace("15", "0"), "velocity_integral_gain at control of.*received both zero"),
    (TRUTH + VELOCITY.replace("15", "'fast'"),
        "a finite number at control.velocity_gain.*received 'fast'"),
    (TRUTH + VELOCITY + "[noise.position_z]\nkind='white'\nstd=1",
        "received noise of 'position_z'.*under altitude control only"),
    ("viscous_friction = ", "which is not"),
    (SCENARIO + "excitation = { kind = 'series', values = 'mine.csv' }", "a list of numbers at excitation"),
)  # fmt: skip


def of_flight_file(right, wrong, tmp_path):
    text = VEHICLE + REST
    assert right in text
    (tmp_path / "mine.toml").write_text(text.replace(right, wrong), encoding="utf-8")
    files.rigid_body_flight_from_table(read_toml(tmp_path / "mine.toml", "a flight"))


FLIGHT_FILES = rows("file of a flight", InputError, of_flight_file,
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
)  # fmt: skip
NO_FILES = calls("no file", InputError,
    (lambda tmp_path: files.read_scenario(tmp_path / "none.toml"), "a scenario in TOML"),
    (lambda tmp_path: files.read_scenario(tmp_path.parent), "a scenario in TOML"),
)  # fmt: skip


test_refused = table(
    *(DISTURBANCES, PARTS, SCENARIOS, SPECIFICATIONS, NAMES, MISTAKES, FLIGHT_FILES),
    NO_FILES,
    begins="Expected .*",
)
