"""Commands that are logged more slowly than issued: what stamps tell, and what is put between them."""

from __future__ import annotations

import json
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, changed, channel, every, flown, prepare_vertical
from flight_logs import STEP_S as TELEMETRY_STEP_S

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.estimate import (
    SENSORS_APART_S,
    FlightState,
    diagnose_fit,
    estimated,
    lags_from_rates,
    single_frequency_hz,
)
from eivor.flights.grid import Grid, command_on_grid, on_grid
from eivor.flights.lag_prior import OWN_DELAY_S, LagPrior, telemetry_lag
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import QuantityEstimate
from eivor.flights.references import jumps, share_left
from eivor.flights.timestamps import (
    Clock,
    as_issued,
    command_clock,
    corrected_stamps,
    finer_step,
    jitter_estimate,
    period_from_aliasing,
    truth_of,
    with_corrected_stamps,
)
from eivor.inference.verdict import Status
from eivor.models.separable import Bounds, LaggedReferences, Prior
from eivor.motions.rates.motion import Rates
from eivor.motions.vertical.model import (
    MOT_THST_EXPO,
    THR_MDL_FAC,
    CurveFamily,
    motor_signal,
    plant_share,
    proposed,
    share_of,
    thrust_of,
)
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.regression import input_variance, mapped_input
from eivor.motions.vertical.select import selected
from eivor.report.flight import checks
from eivor.signals.filters import actuator_state
from eivor.signals.recording import Channel, DataSheet, Frame, Recording
from motions.turning_logs import STEP_S as TURNED_STEP_S
from motions.turning_logs import Vehicle, turned

COARSE = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def logged(issued_s: float, rate_hz: float, *, jitter_s: float = 0.0, seconds: float = 60.0):
    """Stamps of the commands in force at the instants of a slower logger, with a jitter of their own."""
    issued = np.arange(0.0, seconds, issued_s)
    instants = np.arange(0.0, seconds, 1.0 / rate_hz)
    kept = issued[np.unique(np.searchsorted(issued, instants + 1e-9, side="right") - 1)]
    return np.sort(kept + jitter_s * np.random.default_rng(1).standard_normal(kept.size))


def command(time_s, values=None, name: str = "input") -> Channel:
    return Channel(name, time_s, np.cos(time_s) if values is None else values, "", held=True)


@pytest.mark.parametrize(
    ("issued_s", "rate_hz", "jitter_s"),
    [
        (0.004, 47.3, 0.0),
        (0.004, 47.3, 3e-4),
        (0.010, 30.0, 3e-4),
        (0.004, 100.0, 1e-4),
        (0.0025, 48.0, 1e-4),
        (0.00125, 49.0, 2e-5),
    ],
)
def test_stamps_of_a_thinned_log_tell_the_step_of_its_controller(issued_s, rate_hz, jitter_s):
    assert finer_step(logged(issued_s, rate_hz, jitter_s=jitter_s)) == pytest.approx(issued_s, rel=0.05)


def test_stamps_that_were_rounded_to_milliseconds_tell_none():
    # distances of 21 and 22 ms; those of a controller of 4 ms are not powers of ten
    assert finer_step(np.round(np.arange(0.0, 60.0, 1.0 / 47.3), 3)) is None
    assert finer_step(np.round(logged(0.004, 47.3), 3)) == pytest.approx(0.004)


def test_rows_at_multiples_of_a_tick_leave_open_when_commands_were_issued():
    # a loop of 50 ms that now and then takes a tick of 10 ms more or less, and logs all that it has
    rng = np.random.default_rng(5)
    times = 0.01 * np.cumsum(rng.integers(4, 7, 2000))
    sensor = Channel("velocity_z", times, rng.standard_normal(2000), "m/s")
    assert command_clock(command(times), []).issued_s == pytest.approx(0.01)
    rows = command_clock(command(times), [sensor])
    # from commands at every tick to those that are held from row to row
    assert (rows.is_known, rows.slack_s) == (False, pytest.approx(0.0125))


def test_a_quick_log_holds_every_command_unless_others_are_logged_more_often():
    jitter = 0.001 * np.random.default_rng(2).standard_normal(2000)
    quick = command(np.arange(0.0, 20.0, 0.01) + jitter)
    assert not command_clock(quick, []).thinned
    quicker = Channel("velocity_z", np.arange(0.0, 20.0, 0.004), np.zeros(5000), "m/s")
    assert command_clock(quick, [quick, quicker]).slack_s == pytest.approx(0.0025, rel=0.01)


def test_rows_of_a_table_hold_every_command_no_more_where_some_are_skipped_or_lost():
    rows = np.arange(0.0, 20.0, 0.004)
    skipped = rows[np.unique(np.searchsorted(rows, np.arange(0.0, 19.9, 0.01) - 1e-9))]
    sparse = height(skipped, 9.0 * skipped)
    for others in ([height(rows, 9.0 * rows), sparse], [sparse]):
        clock = command_clock(command(rows), others, 0.004)
        assert (clock.is_known, clock.is_even) == (False, True)
    left = rows[np.random.default_rng(6).random(rows.size) > 0.1]
    clock = command_clock(command(left), [height(left, left)])
    assert (clock.is_known, clock.is_even) == (False, True)


BEATING = [(0.004, 100.0, 0.001), (0.004, 100.0, 0.003), (0.004, 90.0, 0.002)]
BEATING += [(0.01, 47.3, 0.003), (0.01, 30.0, 0.003)]


@pytest.mark.parametrize(("issued_s", "rate_hz", "jitter_s"), BEATING)
def test_stamps_that_jitter_by_much_beat_with_the_step_of_their_controller(issued_s, rate_hz, jitter_s):
    stamps = logged(issued_s, rate_hz, jitter_s=jitter_s)
    assert period_from_aliasing(stamps, 0.001) == pytest.approx(issued_s, rel=0.01)
    lost = stamps[(stamps < 20.0) | (stamps > 20.5)]
    assert command_clock(command(lost), []).issued_s == pytest.approx(issued_s, rel=0.05)


def test_a_parameter_says_how_often_torques_are_issued_where_their_stamps_do_not(turning):
    """PX4's setpoints at 50 Hz of a logger with a clock of its own: thrust is that of a slower loop."""
    named = {"IMU_GYRO_RATEMAX": 400.0}
    logs = turning, replace(turning, parameters=named)
    slack = [prepare(log, Rates(), FlightOptions()).command_slack_s for log in logs]
    assert slack == [pytest.approx(0.00125), 0.0]
    thrust = replace(thinned(flown(seconds=20.0, seed=4)[0], 3), parameters=named)
    assert prepare_vertical(thrust, FlightOptions()).command_slack_s == pytest.approx(0.0075)


def test_nothing_is_put_into_gaps_or_beside_missing_values():
    time = np.concatenate([np.arange(0.0, 1.0, 0.02), np.arange(3.0, 4.0, 0.02)])
    values = np.ones(time.size)
    values[10] = np.nan
    issued = as_issued(command(time, values), Clock(0.02, 0.01))
    assert not ((issued.time_s > 0.99) & (issued.time_s < 3.0)).any()
    assert np.isnan(issued.values).sum() == 1
    assert not ((issued.time_s > time[9]) & (issued.time_s < time[10])).any()
    assert not ((issued.time_s > time[10]) & (issued.time_s < time[11])).any()


def thinned(log, every: int):
    """Log of one command out of several, which does not say how often they were issued."""
    whole = log.channels["rotor_command_1"]
    fewer = replace(whole, time_s=whole.time_s[::every], values=whole.values[::every])
    return changed(replace(log, parameters={}), rotor_command_1=fewer)


def lateness(kept: Channel, clock: Clock) -> float:
    """Time by which a logged command of a controller of 4 ms is late on the grid [s]."""
    grid = Grid(1.0, 0.01, (range(5500),))
    issued = command(0.004 * np.arange(15000))
    whole, thin = (command_on_grid(item, grid)[0] for item in (issued, as_issued(kept, clock)))
    slope = -np.sin(grid.time_s)
    return float((whole - thin) @ slope / (slope @ slope))


def test_a_command_in_force_at_even_instants_of_a_logger_is_late_by_less_than_the_slack():
    """At 100 Hz, issued every 4 ms: as if all were logged the lag was 4.6 ms too short, covered in .45."""
    instants = np.arange(0.0, 60.0, 0.01)
    looked = command(instants, np.cos(0.004 * np.floor(instants / 0.004 + 1e-9)))
    clock = command_clock(looked, [])
    assert abs(lateness(looked, clock)) < clock.slack_s == pytest.approx(0.0025)
    assert lateness(looked, Clock(0.01, 0.01)) > 0.0039


@pytest.mark.thorough
def test_what_the_log_does_not_tell_is_said_with_the_lag():
    log = thinned(flown(seconds=20.0, seed=4)[0], 3)
    prepared = prepare_vertical(log, FlightOptions())
    assert prepared.command_slack_s == pytest.approx(0.0075)
    assert [finding.name for finding in prepared.findings] == ["command_clock"]


def test_a_given_lag_is_less_certain_where_the_command_may_be_late():
    lag = QuantityEstimate(0.050, "s", 0.002, (0.046, 0.054))
    given = LagPrior(Prior(0.060, 0.003), lag, 0.006)
    assert given.for_the_log.std == pytest.approx(np.hypot(0.003, 0.006 / np.sqrt(3.0)))
    assert LagPrior(Bounds(0.04, 0.05), lag, 0.006).for_the_log == Bounds(0.034, 0.056)
    assert LagPrior(Prior(0.060, 0.003), lag).for_the_log == Prior(0.060, 0.003)
    assert LagPrior(Bounds(0.05, 0.09), lag, strong=True).for_the_log == Bounds(0.05, 0.054)
    # 10 ms apart: with standard errors of 2 and 3 ms much, with 6 ms more that are open less
    assert given.p_value > 5.0 * LagPrior(Prior(0.060, 0.003), lag).p_value
    assert "[40, 60] ms" in given.sentence


def changed_reference(log, value):
    """The log with another position reference, of which `value` makes every sample from its time."""
    held = log.channels["reference_position_z"]
    return changed(log, reference_position_z=replace(held, values=value(held.time_s)))


@pytest.mark.thorough
def test_the_band_ends_early_where_a_reference_jumps_between_stamps():
    (every,) = flown(seconds=20.0, seed=4)
    log = thinned(every, 2)
    for jumpy in (lambda t: np.where(t % 5.0 < 2.0, 1.0, 0.0), lambda t: np.abs(t % 5.0 - 2.0)):
        prepared = prepare_vertical(changed_reference(log, jumpy), FlightOptions())
        assert prepared.band_hz[1] == pytest.approx(100.0 / 2 / 40)
    assert prepare_vertical(log, FlightOptions()).band_hz[1] == 5.0
    whole = changed_reference(every, lambda t: np.where(t % 5.0 < 2.0, 1.0, 0.0))
    assert prepare_vertical(whole, FlightOptions()).band_hz[1] == 5.0


def test_uneven_stamps_and_stamps_that_err_make_no_jump():
    grid, rng = Grid(0.0, 0.01, (range(4000),)), np.random.default_rng(7)
    used = np.ones(4000, dtype=np.bool_)
    even = np.arange(0.0, 39.9, 0.02)
    jittered = np.sort(even + rng.uniform(0.0, 0.015, even.size))
    wave = np.sin
    assert not any(jumps(command(jittered, wave(instants)), grid, used) for instants in (jittered, even))
    late = wave(jittered - rng.uniform(0.0, 0.004, even.size))  # a setpoint that is renewed every 4 ms
    assert not jumps(command(jittered, late), grid, used)
    assert jumps(command(jittered, late + (jittered > 20.0)), grid, used)
    # nothing is known of what a reference did while no block was logged
    lost = (even % 5.0 > 2.0) & (even % 5.0 < 3.0)
    quick = wave(even) + 0.3 * wave(5.0 * even)
    assert not jumps(command(even[~lost], quick[~lost]), grid, used)
    # of what is not used nothing counts
    assert not jumps(command(jittered, late + (jittered > 20.0)), grid, grid.time_s < 19.0)


def looked_at(issued_s: float, instants, name: str = "input"):
    """What is in force at a logger's own instants, of a noisy command."""
    issued = np.arange(0.0, 62.0, issued_s)
    noise = 0.05 * np.random.default_rng(8).standard_normal(issued.size)
    which = np.searchsorted(issued, instants + 1e-9, side="right") - 1
    return command(instants, np.cos(issued[which]) + noise[which], name)


def irregular(step_s: float, jitter_s: float, seed: int = 9):
    rng = np.random.default_rng(seed)
    even = np.arange(0.02, 60.0, step_s)
    return even, np.sort(even + jitter_s * rng.standard_normal(even.size))


def height(stamps, instants) -> Channel:
    noise = 0.01 * np.random.default_rng(10).standard_normal(stamps.size)
    return Channel("position_z", stamps, np.sin(instants) + noise, "m")


def test_a_smooth_channel_tells_whether_uneven_stamps_are_true():
    even, uneven_times = irregular(0.01, 0.002)
    pairs = (uneven_times, uneven_times), (uneven_times, even), (even, even)
    assert [truth_of([jitter_estimate(height(*pair))]) for pair in pairs] == [True, False, None]
    assert truth_of([]) is None


def test_a_logger_that_looks_at_its_own_times_is_told_by_values_that_repeat():
    _, instants = irregular(0.01, 0.002)
    _, others = irregular(0.01, 0.002, seed=11)
    sensor = height(others, others)
    clock = command_clock(looked_at(0.01, instants), [sensor])
    assert (clock.looked, clock.slack_s) == (True, 0.0)
    assert "some of its values repeat" in clock.sentence
    # its values once each, at uneven times of its own: when they were issued is not told
    thin = command_clock(looked_at(0.004, instants), [sensor])
    assert (thin.looked, thin.slack_s) == (False, pytest.approx(0.0025, rel=0.02))
    # stamps that err say nothing of the kind, nor does a loop that logs all it has at once
    assert not command_clock(looked_at(0.01, instants), [height(others, irregular(0.01, 0.0)[0])]).thinned
    assert not command_clock(looked_at(0.004, instants), [height(instants, instants)]).thinned
    # but rows whose own stamps err are even
    rows = command_clock(looked_at(0.004, instants), [height(instants, irregular(0.01, 0.0)[0])])
    assert (rows.is_even, rows.slack_s) == (True, pytest.approx(0.0025, rel=0.02))


def test_a_rate_below_that_at_which_the_command_changes_is_refused():
    log = thinned(flown(seconds=20.0, seed=4)[0], 3)
    with pytest.raises(UsageError, match=r"33\.3 Hz or more, at which rotor_command_1 changes"):
        prepare_vertical(log, FlightOptions(controller_rate_hz=20.0))
    assert prepare_vertical(log, FlightOptions(controller_rate_hz=30.0)).locked_s == 0.0


def test_rounded_values_repeat_by_themselves():
    _, instants = irregular(0.01, 0.002)
    _, others = irregular(0.01, 0.002, seed=11)
    exact = looked_at(0.004, instants)
    rounded = replace(exact, values=np.round(exact.values, 2))
    assert not command_clock(rounded, [height(others, others)]).looked


def test_a_clock_that_jumps_by_days_takes_no_memory_for_them():
    rng = np.random.default_rng(0)
    time_s = 0.02 * np.arange(1500) + 0.002 * rng.random(1500)
    tracemalloc.start()
    late = period_from_aliasing(np.append(time_s[:900], time_s[900:] + 1e6), 0.001)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert late == period_from_aliasing(time_s[:900], 0.001)
    assert peak < 50e6


STEP_S, ERROR_S = 0.004, 0.001


def even(seconds: float = 40.0) -> np.ndarray:
    return np.arange(0.0, seconds, STEP_S)


def erring(seed: int, error_s: float = ERROR_S) -> np.ndarray:
    """Stamps of even samples, off by so much, in their order."""
    noise = np.random.default_rng(seed).standard_normal(even().size)
    return even() + np.clip(error_s * noise, -0.45 * STEP_S, 0.45 * STEP_S)


def recording(stamps, taken, command_s) -> Recording:
    """A smooth rate with noise, and a command that is not smooth."""
    rng = np.random.default_rng(1)
    rate = Channel(
        "angular_rate_x", stamps, np.sin(5.0 * taken) + 0.01 * rng.standard_normal(taken.size), "rad/s"
    )
    command = Channel("rotor_command_1", command_s, rng.standard_normal(command_s.size), "", held=True)
    return Recording("log", "frame", {item.name: item for item in (rate, command)}, Frame.Z_UP)


def test_errors_that_add_up_stay():
    waits = np.cumsum(STEP_S + 0.1 * STEP_S * np.random.default_rng(4).standard_normal(5000))
    assert corrected_stamps(waits) is None
    lost = np.delete(erring(5), np.random.default_rng(6).choice(even().size, 100, replace=False))
    assert corrected_stamps(lost) is None
    # in a log whose other stamps err as well
    log = recording(erring(2), even(), waits)
    result, _ = with_corrected_stamps(log)
    assert result.channel("rotor_command_1") is log.channel("rotor_command_1")


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


def rotor_state(log):
    """The command of a log, and the state of its rotors."""
    command = log.channels["rotor_command_1"]
    state = actuator_state(command.values[:, None], step_s=TELEMETRY_STEP_S, lag_s=LAG_S, delay_s=0.0)
    return command, state[:, 0]


def with_telemetry(
    log: Recording, *, rate_hz: float = 50.0, late_s: float = 0.0, power: float = 1.0, rotors: int = 1
) -> Recording:
    """The log with the speeds of its rotors in rpm, on a clock of their own."""
    (command, state), results = rotor_state(log), {}
    for rotor in range(rotors):
        stamps = np.arange(0.003, command.time_s[-1] - 0.1, 1.0 / rate_hz)
        speeds = 1.8e4 * np.interp(stamps - late_s, command.time_s, state) ** power + 300.0
        noise = 30.0 * np.random.default_rng(rotor).standard_normal(stamps.size)
        name = f"rotor_speed_{rotor + 1}"
        results[name] = replace(channel(name, stamps, speeds + noise), held=False)
    return changed(log, **results)


def told(log: Recording) -> LagPrior | None:
    return telemetry_lag((prepare_vertical(log, FlightOptions()),), ("rotor_speed",))


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    "how", [{}, {"rate_hz": 20.0}, {"rate_hz": 100.0, "late_s": 0.01}, {"power": 0.5}, {"rotors": 3}]
)
def test_telemetry_in_any_unit_tells_lag_and_its_own_delay(log, how):
    result = told(with_telemetry(log, **how))
    truth = LAG_S + how.get("late_s", 0.0)
    low, high = result.measured.interval
    assert low < truth < high
    assert high - low < 0.015
    assert result.known.mean == result.measured.value
    assert OWN_DELAY_S < result.known.std < 0.025


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_slow_telemetry_and_what_does_not_follow_tell_nothing(log):
    assert told(log) is None
    assert told(with_telemetry(log, rate_hz=10.0)) is None
    noise = np.random.default_rng(1).standard_normal(log.channels["rotor_command_1"].values.size)
    assert told(changed(log, rotor_speed_1=noise)) is None


@pytest.mark.thorough
@COARSE
def test_the_lag_by_telemetry_is_used_and_said(log):
    alone, known = ev.identify_flight(log), ev.identify_flight(with_telemetry(log))
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("telemetry of the actuators says ")
    assert "the flight alone says" in sentence
    given = json.loads(known.to_json())["given_lag"]
    low, high = given["telemetry_interval"]
    assert low < given["mean"] < high
    assert given["alone"] == alone.quantities["effective_lag"].value
    # what a user knows comes first
    typed = ev.identify_flight(with_telemetry(log), lag=ev.Prior(LAG_S, 0.01))
    assert typed.fit.lag_prior.measured is None


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_slow_telemetry_is_no_input_where_commands_are_logged(log):
    thrust = channel("input", log.channels["rotor_command_1"].time_s, log.channels["rotor_command_1"].values)
    for rate_hz, family in ((4.0, "input"), (50.0, "rotor_speed")):
        neighbours = changed(with_telemetry(log, rate_hz=rate_hz), "rotor_command_1", input=thrust)
        assert selected(neighbours, FlightOptions()).input.name == family
    alone = changed(with_telemetry(log, rate_hz=4.0), "rotor_command_1")
    assert selected(alone, FlightOptions()).input.name == "rotor_speed"


# Measurement noises of a flight, declared or estimated; and methods that take them out.

BCLS = "bias_compensated_least_squares"
NOISE = 0.3


@pytest.fixture(scope="module")
def calm_log():
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
def test_what_is_declared_a_data_sheet_and_a_map_say_the_same(calm_log):
    assert level(calm_log, noise={"velocity_z": NOISE}).std == pytest.approx(NOISE)
    sheet = DataSheet(density=0.04, bandwidth_hz=50.0, step=0.1)
    assert level(calm_log, noise={"velocity_z": sheet}).std == pytest.approx(
        np.hypot(0.04 * 50**0.5, 0.1 / 12**0.5)
    )
    mapped = changed(calm_log, velocity_z=replace(calm_log.channel("velocity_z"), noise=0.2))
    assert level(mapped).std == pytest.approx(0.2)
    assert level(mapped, noise={"velocity_z": 0.1}).std == pytest.approx(0.1)


def test_noise_is_estimated_from_the_fastest_part(calm_log):
    result = level(calm_log, noise="estimate")
    assert result.std == pytest.approx(np.hypot(NOISE, 0.03), rel=0.05)
    assert "estimated" in result.sentence


@pytest.mark.thorough
def test_the_lag_is_searched_with_the_noise_taken_out(calm_log):
    result = ev.identify_flight(calm_log, method=BCLS, noise="estimate")
    lag = result.quantities["effective_lag"]
    assert lag.interval[0] < LAG_S < lag.interval[1]
    assert lag.half_width < 0.02
    assert result.verdict.status.value == "provisional"
    assert any(finding.name == "noise" and "velocity_z" in finding.message for finding in result.findings)


def test_without_a_declared_noise_it_says_what_to_do(calm_log):
    result = ev.identify_flight(calm_log, method=BCLS)
    assert result.verdict.status.value == "refused"
    (sentence,) = result.verdict.sentences
    assert "noise of velocity_z in m/s" in sentence
    assert "--noise velocity_z=STD" in sentence
    assert "--noise estimate" in sentence


def test_a_flight_gives_its_signals(calm_log):
    flight = prepare(calm_log, Vertical(), FlightOptions(noise={"velocity_z": NOISE}))
    assert flight.signals.noise["velocity_z"].std == pytest.approx(NOISE)
    assert (flight.input_map, input_variance(flight, {"velocity_z": NOISE**2})) == ("square", 0.0)
    lagged = mapped_input(flight, lag_s=LAG_S)
    channels = {**flight.signals.channels, "input": lagged}
    noise = {**flight.signals.noise, "input": ev.WhiteNoise(0.0)}
    signals = replace(flight.signals, channels=channels, noise=noise, valid=flight.used)
    problem = ev.VerticalMotion().regression(signals)
    taken = ev.identify(problem, ev.methods.bias_compensated_least_squares())
    low, high = taken.interval("viscous_friction")
    assert low < FRICTION < high
    attenuated = ev.identify(problem, ev.methods.least_squares()).parameters["viscous_friction"]
    assert attenuated < 0.93 * FRICTION
    assert abs(taken.parameters["viscous_friction"] - FRICTION) < 0.4 * abs(attenuated - FRICTION)


def test_noise_of_measured_rotors_goes_through_the_map():
    (quiet,) = flown(1, seconds=20.0, seed=4)
    command = quiet.channel("rotor_command_1")
    rotor = replace(command, name="rotor_speed_1", held=False)
    calm_log = changed(quiet, rotor_speed_1=rotor)
    given = FlightOptions(input="rotor_speed", input_map="square", noise={"rotor_speed": 0.01})
    flight = prepare(calm_log, Vertical(), given)
    expected = 0.01 * 2.0 * np.sqrt(np.mean(command.values**2))
    assert input_variance(flight, {"rotor_speed_1": 0.01**2}) == pytest.approx(expected**2, rel=0.04)


def telemetry(log, late_s):
    """The log with its rotors' actual speed, stamped late, in place of their command."""
    command, speed = rotor_state(log)
    measured = channel("rotor_speed_1", command.time_s + late_s, speed)
    return changed(log, "rotor_command_1", rotor_speed_1=replace(measured, held=False))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("late_s", [0.0, 0.02, pytest.param(-0.023, marks=pytest.mark.thorough)])
def test_late_telemetry_moves_no_parameter_and_is_told(late_s):
    fit = ev.identify_flight(telemetry(flown(seconds=26.0)[0], late_s))
    delay = fit.quantities["delay"]
    assert delay.interval[0] < -late_s < delay.interval[1]
    assert delay.half_width < 0.01
    assert fit.quantities["effective_lag"].value == delay.value
    for name, truth in (("viscous_friction", FRICTION), ("input_gain", GAIN)):
        low, high = fit.quantities[name].interval
        assert low < truth < high
    assert fit.verdict.status is Status.IDENTIFIED
    assert fit.names == ("viscous_friction", "input_gain", "delay")
    assert "their stamps are late" in fit.motion.view(fit.prepared[0]).symbols


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_the_delay_is_part_of_the_friction_s_interval():
    calm_log = telemetry(flown(seconds=26.0)[0], 0.0)
    fit = ev.identify_flight(calm_log)
    problem = fit.fit.problem
    lag, delay = problem.nuisances
    known = problem.with_nuisances((lag, delay.known_at(0.0)))
    sure = ev.identify(known, ev.methods.reference_iv())
    assert fit.estimate.std_error("viscous_friction") > 1.05 * sure.std_error("viscous_friction")


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
    open_first = changed(log_open, input_open_loop=channel("landed", [0.0, 15.0], [1.0, 0.0]))
    references = prepare_vertical(open_first, ev.FlightOptions()).references
    (remark,) = [reference.remark for reference in references if reference.name == "input"]
    assert remark == "a loop acts on it, though for 25% of the flight only"
    references = prepare_vertical(log_open, ev.FlightOptions()).references
    assert "input" not in [reference.name for reference in references]


# The lag as information: by turning, by what is known, and what the thrust curve of motors is.


@pytest.mark.thorough
@COARSE
def test_a_given_lag_is_one_unknown_less(monkeypatch):
    """Finding 3: two instruments were too few for friction, gain and a lag that was given."""
    every = LaggedReferences.columns
    monkeypatch.setattr(LaggedReferences, "columns", lambda *given: every(*given)[:, :2])
    log = flown(seconds=30.0)[0]
    alone = ev.identify_flight(log)
    assert alone.fit is None
    assert "at least 3 independent instruments" in alone.verdict.sentences[0]
    flight = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.005))
    assert "the flight alone has too few instruments for a lag" in dict(checks(flight))["lag"]
    assert flight.quantities["viscous_friction"].value == pytest.approx(0.4, rel=0.2)
    low, high = flight.quantities["effective_lag"].interval
    assert LAG_S - 0.0115 <= low <= high <= LAG_S + 0.0115  # never wider than what was given


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("value", "error", "p_value"), [(0.07, 0.004, 1.0), (0.08, 0.0, 0.0455), (0.083, 0.012, 0.4053)]
)
def test_the_test_is_that_of_two_independent_numbers(value, error, p_value):
    alone = QuantityEstimate(value, "s", error, (value - 2.0 * error, value + 2.0 * error))
    given = LagPrior(ev.Prior(0.07, 0.005 if error < 0.01 else 0.01), alone)
    assert given.p_value == pytest.approx(p_value, abs=1e-3)


ROTORS = Vehicle(lag_s=LAG_S - 2 * TURNED_STEP_S)


@pytest.fixture(scope="module")
def turning() -> Recording:
    """What a flight that turns logs of that."""
    return turned(3, vehicle=ROTORS, seconds=26.0)


def measured(value: float = LAG_S, half_width: float = 0.004, source: str = "other") -> LagPrior:
    interval = (value - half_width, value + half_width)
    lag = QuantityEstimate(value, "s", 0.5 * half_width, interval)
    return LagPrior.by_measurement(source, f"{source} motion", lag, SENSORS_APART_S, "delays")


def estimate(log: Recording, *lag_measurement: LagPrior):
    options = FlightOptions()
    return estimated(
        FlightState(Vertical(), (prepare_vertical(log, options),), options, lambda: lag_measurement)
    )


@pytest.mark.thorough
@COARSE
def test_the_lag_by_turning_is_used_and_said(log, turning):
    log = changed(log, **turning.channels)
    alone, known = estimate(log), ev.identify_flight(log)
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("turning about the body axes (--model rates) says ")
    given = json.loads(known.to_json())["given_lag"]
    low, high = given["told_interval"]
    assert low < LAG_S < high
    assert given["told_by"] == "rates"
    assert given["telemetry_interval"] is None
    assert given["alone"] == alone.quantities["effective_lag"].value
    assert given["std"] == pytest.approx(np.hypot(0.25 * (high - low), SENSORS_APART_S), rel=0.05)


@pytest.mark.thorough
@COARSE
def test_what_a_user_knows_comes_first_and_nothing_else_is_asked(log):
    for lag in (ev.Prior(LAG_S, 0.01), ev.Bounds(0.0, 0.0)):
        options = FlightOptions(lag=lag)
        flights = (prepare_vertical(log, options),)
        given = estimated(FlightState(Vertical(), flights, options, not_to_be_made)).fit.lag_prior
        assert given.measured is None
        assert given.known == lag


@pytest.mark.thorough
@COARSE
def test_a_lag_that_contradicts_the_flight_is_told_and_not_used():
    log = flown(seconds=15.0)[0]
    alone, told = estimate(log), estimate(log, measured(LAG_S + 0.1))
    telemetry = ev.identify_flight(with_telemetry(log, late_s=0.12))
    for late, source in ((told, "other"), (telemetry, "telemetry")):
        assert late.fit.lag_prior is None
        assert late.quantities["viscous_friction"] == alone.quantities["viscous_friction"]
        (finding,) = [item for item in late.findings if item.name == f"{source}_contradicts"]
        assert "is not used" in finding.message


@pytest.mark.thorough
@COARSE
def test_the_closest_that_agrees_serves():
    log = flown(seconds=15.0)[0]
    both = estimate(log, measured(half_width=0.02, source="rough"), measured(source="close"))
    assert both.fit.lag_prior.source == "close"
    wrong = estimate(log, measured(half_width=0.02, source="rough"), measured(LAG_S + 0.1, source="wrong"))
    assert wrong.fit.lag_prior.source == "rough"
    assert any(finding.name == "wrong_contradicts" for finding in wrong.findings)


def family(log: Recording, begin: str) -> list[str]:
    return [name for name in log.channels if name.startswith(begin)]


def answering(log: Recording) -> Recording:
    names = family(log, "reference_")
    loops = {f"feedback_{name}": replace(log.channels[name], name=f"feedback_{name}") for name in names}
    return changed(log, *names, **loops)


@pytest.mark.thorough
@COARSE
@pytest.mark.parametrize(
    "spoilt",
    [
        lambda log: every(log, 3, *family(log, "angular_rate")),
        lambda log: every(log, 2, *family(log, "torque_setpoint")),
        lambda log: changed(log, *family(log, "torque_setpoint")),
        answering,
    ],
)
def test_turning_that_cannot_tell_is_not_estimated(turning, spoilt, monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), spoilt(turning), None, {}) == ()
    with pytest.raises(AssertionError, match="estimated"):
        lags_from_rates((Rates(),), turning, None, {})


@pytest.mark.thorough
@COARSE
def test_turning_that_hardly_moves_the_lag_is_not_estimated_closely(monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), turned(4, vehicle=ROTORS, seconds=26.0, size=0.02), None, {}) == ()


def not_to_be_made(*_: object, **__: object) -> tuple[LagPrior, ...]:
    raise AssertionError("estimated")


def unmade(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eivor.flights.estimate.STAGES", (not_to_be_made, diagnose_fit))


@pytest.mark.thorough
@COARSE
def test_turning_that_is_not_trusted_says_nothing(turning):
    assert lags_from_rates((Rates(),), turning, (5.0, 18.0), {}) == ()  # too short to be identified


@pytest.mark.parametrize(("share", "hover"), [(0.3, 0.4), (0.7, 0.6), (-0.2, 0.5)])
def test_the_share_of_a_signal_behind_the_curve_is_the_parameter(share, hover):
    assert plant_share(CurveFamily(True), share, hover, None) == share
    assert plant_share(CurveFamily(True), share, hover, 0.0) == pytest.approx(share)
    exponent = CurveFamily(True).exponent(share, hover)
    assert plant_share(CurveFamily(False), exponent, hover, None) == pytest.approx(share)


@pytest.mark.parametrize("in_force", [-0.4, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("true", [-0.3, 0.0, 0.65, 1.0])
def test_before_the_curve_both_curves_together_are_the_vehicle_s(in_force, true):
    """Commands went through the inverse of one curve, and thrust is another of the signal."""
    signal, step = 0.45, 1e-6

    def setpoint(nuisances):
        return thrust_of(in_force, nuisances)

    hover = setpoint(signal)
    assert motor_signal(hover, in_force) == pytest.approx(signal)
    ends = [
        (math.log(thrust_of(true, item)), math.log(setpoint(item))) for item in (signal - step, signal + step)
    ]
    seen = (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])
    assert plant_share(CurveFamily(False), seen, hover, in_force) == pytest.approx(true, abs=1e-6)
    of_commands = share_of(seen, hover)
    if math.isfinite(of_commands):
        assert plant_share(CurveFamily(True), of_commands, hover, in_force) == pytest.approx(true, abs=1e-6)
    # thrust that is proportional to the setpoint leaves the curve as it is
    assert plant_share(CurveFamily(True), 0.0, hover, in_force) == pytest.approx(in_force)


@pytest.mark.parametrize("in_force", [None, 0.3])
def test_intervals_hold_every_pair_and_are_cut_to_the_range(in_force):
    curve, hover = (0.6, (0.5, 0.7)), (0.4, (0.38, 0.42))
    share, thrust = proposed(THR_MDL_FAC, CurveFamily(True), curve, hover, in_force)
    for value in np.linspace(0.5, 0.7, 9):
        for command in np.linspace(0.38, 0.42, 9):
            item = plant_share(CurveFamily(True), value, command, in_force)
            assert share[1][0] - 1e-12 <= item <= share[1][1] + 1e-12
            reported = thrust_of(item, motor_signal(command, in_force))
            assert thrust[1][0] - 1e-12 <= reported <= thrust[1][1] + 1e-12
    wide = (0.6, (-math.inf, math.inf))
    assert proposed(THR_MDL_FAC, CurveFamily(True), wide, hover, in_force)[0][1] == (0.0, 1.0)
    exponents = (1.4, (0.2, 40.0))
    at_rest = (0.4, (-0.1, 1.2))
    share, _ = proposed(MOT_THST_EXPO, CurveFamily(False), exponents, at_rest, in_force)
    assert share[1] == (-1.0, 1.0)


@pytest.mark.thorough
def test_a_reference_of_one_frequency_is_told():
    seconds = TELEMETRY_STEP_S * np.arange(2000)
    sine, steps = np.sin(2.0 * np.pi * 0.3 * seconds), np.sign(np.sin(2.0 * np.pi * 0.3 * seconds))
    log = flown(seconds=20.0)[0]

    def frequency(**references):
        flight = prepare_vertical(changed(log, **references), ev.FlightOptions())
        return single_frequency_hz((flight,), tuple(references))

    assert frequency(reference_position_z=sine, reference_velocity_z=np.gradient(sine)) == pytest.approx(
        0.3, abs=0.03
    )
    assert frequency(reference_position_z=steps) == 0.0
    assert frequency(reference_position_z=sine, reference_velocity_z=steps) == 0.0
    assert frequency(reference_position_z=sine + 0.3 * np.sin(2.0 * np.pi * 0.8 * seconds)) == 0.0
    assert frequency() == 0.0
