"""Measurement noises of a flight, declared or estimated; and methods that take them out."""

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, LAG_S, changed, flown

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.grid import Grid, on_grid
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.references import share_left
from eivor.motions.vertical.motion import Vertical
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
    return prepare(log, Vertical(), FlightOptions(**options)).noise[name]


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


@pytest.mark.thorough
def test_generalized_iv_by_references_needs_no_noise_and_by_past_inputs_is_provisional(log):
    by_references = ev.identify_flight(log, method="generalized_iv")
    friction = by_references.quantities["viscous_friction"]
    assert friction.interval[0] < FRICTION < friction.interval[1]
    by_inputs = ev.identify_flight(log, method="generalized_iv", instruments=("lags",))
    assert by_inputs.verdict.status.value in ("provisional", "refused")
    assert any(
        sentence.startswith("Past inputs are the instruments") for sentence in by_inputs.verdict.sentences
    )


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
        prepare(log, Vertical(), FlightOptions(noise=noise))


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
