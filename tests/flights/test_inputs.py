"""Measurement noises of a flight, declared or estimated; and methods that take them out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, STEP_S, changed, channel, flown, prepare_vertical

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.grid import Grid, on_grid
from eivor.flights.prepare import prepare
from eivor.flights.references import share_left
from eivor.inference.verdict import Status
from eivor.motions.vertical.motion import Vertical
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Channel, DataSheet

BCLS = "bias_compensated_least_squares"
NOISE = 0.3


@pytest.fixture(scope="module")
def log():
    """A flight in calm air whose velocity is noisy."""
    (quiet,) = flown(1, seconds=30.0, seed=3)
    return noisier(quiet)


def noisier(quiet, seed=1):
    velocity = quiet.channel("velocity_z")
    more = NOISE * np.random.default_rng(seed).standard_normal(velocity.values.size)
    return changed(quiet, velocity_z=replace(velocity, values=velocity.values + more))


def level(log, name="velocity_z", **options):
    return prepare(log, Vertical(), ev.FlightOptions(**options)).noise[name]


@pytest.mark.parametrize("rate_hz", [20.0, 45.0, 100.0, 400.0, 1000.0])
def test_noise_on_the_grid_is_what_samples_between_stamps_leave_of_it(rate_hz):
    time = np.arange(round(60.0 * rate_hz)) / rate_hz
    grid = Grid(0.0, 0.01, (range(5900),))
    values = np.random.default_rng(0).standard_normal(time.size)
    channel = Channel("velocity_z", time, values, "m/s")
    series, _ = on_grid(channel, grid)
    share = share_left(channel, grid, np.ones(5900, dtype=bool))
    assert series.var() == pytest.approx(share, rel=0.1)
    if rate_hz == 100.0:
        assert share == pytest.approx(1.0)


@pytest.mark.thorough
def test_what_is_declared_a_data_sheet_and_a_map_say_the_same(log):
    assert level(log, noise={"velocity_z": NOISE}).std == pytest.approx(NOISE)
    sheet = DataSheet(density=0.04, bandwidth_hz=50.0, step=0.1)
    assert level(log, noise={"velocity_z": sheet}).std == pytest.approx(
        np.hypot(0.04 * 50**0.5, 0.1 / 12**0.5)
    )
    mapped = changed(log, velocity_z=replace(log.channel("velocity_z"), noise=0.2))
    assert level(mapped).std == pytest.approx(0.2)
    assert level(mapped, noise={"velocity_z": 0.1}).std == pytest.approx(0.1)


def test_noise_is_estimated_from_the_fastest_part(log):
    result = level(log, noise="estimate")
    assert result.std == pytest.approx(np.hypot(NOISE, 0.03), rel=0.05)
    assert "estimated" in result.sentence


@pytest.mark.thorough
def test_the_lag_is_searched_with_the_noise_taken_out(log):
    result = ev.identify_flight(log, method=BCLS, noise="estimate")
    lag = result.quantities["effective_lag"]
    assert lag.interval[0] < LAG_S < lag.interval[1]
    assert lag.half_width < 0.02
    assert result.verdict.status.value == "provisional"
    assert any(finding.name == "noise" and "velocity_z" in finding.message for finding in result.findings)


def test_without_a_declared_noise_it_says_what_to_do(log):
    result = ev.identify_flight(log, method=BCLS)
    assert result.verdict.status.value == "refused"
    (sentence,) = result.verdict.sentences
    assert "noise of velocity_z in m/s" in sentence
    assert "--noise velocity_z=STD" in sentence
    assert "--noise estimate" in sentence


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        ({"speed_z": 0.1}, "'speed_z'"),
        ({"velocity_z": -0.1}, "zero or more"),
        ({"velocity_z": float("nan")}, "zero or more"),
        ("guess", "estimate"),
    ],
)
def test_noises_that_are_none(log, noise, words):
    with pytest.raises(UsageError, match=words):
        prepare(log, Vertical(), ev.FlightOptions(noise=noise))


def test_a_log_gives_its_signals(log):
    signals = ev.log_signals(log, actuator_lag=LAG_S, noise={"velocity_z": NOISE})
    assert signals.noise["velocity_z"].std == pytest.approx(NOISE)
    assert signals.noise["input"].std == 0.0
    problem = ev.VerticalMotion().regression(signals)
    taken = ev.identify(problem, ev.methods.bias_compensated_least_squares())
    low, high = taken.interval("viscous_friction")
    assert low < FRICTION < high
    attenuated = ev.identify(problem, ev.methods.least_squares()).parameters["viscous_friction"]
    assert attenuated < 0.93 * FRICTION
    assert abs(taken.parameters["viscous_friction"] - FRICTION) < 0.4 * abs(attenuated - FRICTION)
    with pytest.raises(UsageError, match="actuator_lag"):
        ev.log_signals(log, actuator_lag=-1.0)


def test_noise_of_measured_rotors_goes_through_the_map():
    (quiet,) = flown(1, seconds=20.0, seed=4)
    command = quiet.channel("rotor_command_1")
    rotor = replace(command, name="rotor_speed_1", held=False)
    log = changed(quiet, rotor_speed_1=rotor)
    signals = ev.log_signals(log, input="rotor_speed", input_map="square", noise={"rotor_speed": 0.01})
    expected = 0.01 * 2.0 * np.sqrt(np.mean(command.values**2))
    assert signals.noise["input"].std == pytest.approx(expected, rel=0.02)


def telemetry(log, late_s):
    """The log with its rotors' actual speed, stamped late, in place of their command."""
    command = log.channels["rotor_command_1"]
    speed = actuator_state(command.values[:, None], step_s=STEP_S, lag_s=LAG_S, delay_s=0.0)[:, 0]
    measured = channel("rotor_speed_1", command.time_s + late_s, speed)
    return changed(log, "rotor_command_1", rotor_speed_1=replace(measured, held=False))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("late_s", [0.0, 0.02, pytest.param(-0.023, marks=pytest.mark.thorough)])
def test_late_telemetry_moves_no_parameter_and_is_told(late_s):
    identify_flight = ev.identify_flight(telemetry(flown(seconds=26.0)[0], late_s))
    delay = identify_flight.quantities["delay"]
    assert delay.interval[0] < -late_s < delay.interval[1]
    assert delay.half_width < 0.01
    assert identify_flight.quantities["effective_lag"].value == delay.value
    for name, truth in (("viscous_friction", FRICTION), ("input_gain", GAIN)):
        low, high = identify_flight.quantities[name].interval
        assert low < truth < high
    assert identify_flight.verdict.status is Status.IDENTIFIED
    assert identify_flight.names == ("viscous_friction", "input_gain", "delay")
    assert "their stamps are late" in identify_flight.motion.view(identify_flight.prepared[0]).symbols


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_the_delay_is_part_of_the_friction_s_interval():
    log = telemetry(flown(seconds=26.0)[0], 0.0)
    identify_flight = ev.identify_flight(log)
    problem = identify_flight.fit.problem
    known = problem.with_nuisances((problem.lag, problem.delay.known_at(0.0)))
    sure = ev.identify(known, ev.methods.reference_iv())
    assert identify_flight.estimate.std_error("viscous_friction") > 1.05 * sure.std_error("viscous_friction")


@pytest.fixture(scope="module")
def log_open():
    flight = flown(seconds=20.0, seed=4)[0]
    return changed(flight, "rotor_command_1", input=flight.channel("rotor_command_1").values)


def usable(log_open, **open_loop):
    """Remarks on what may serve, with states of the loop at some times."""
    log_open = changed(log_open, input_open_loop=channel("landed", open_loop["at"], open_loop["states"]))
    references = prepare_vertical(log_open, ev.FlightOptions()).references
    return {reference.name: reference.remark for reference in references if reference.usable}


def test_it_does_not_serve_where_a_loop_acts_now_and_then_or_nothing_is_known(log_open):
    assert "input" not in usable(log_open, at=[0.0, 15.0, 19.9], states=[1.0, 0.0, 0.0])
    flight = prepare_vertical(
        changed(log_open, input_open_loop=channel("landed", [0.0, 15.0], [1.0, 0.0])), ev.FlightOptions()
    )
    (remark,) = [reference.remark for reference in flight.references if reference.name == "input"]
    assert remark == "a loop acts on it, though for 25% of the flight only"
    assert "input" not in [
        reference.name for reference in prepare_vertical(log_open, ev.FlightOptions()).references
    ]
