"""Channels on the common grid against naive references, and commands after their gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import STEP_S as FLOWN_STEP_S
from flight_logs import changed, flown, prepare_vertical, recording
from flight_logs import channel as as_channel
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import eivor as ev
from eivor.flights.grid import (
    AIRBORNE_MARGIN_S,
    MARGIN_S,
    MEMORY_S,
    RECOVERY_S,
    Grid,
    airborne,
    airborne_by_log,
    command_on_grid,
    common_grid,
    cubic,
    linear,
    on_grid,
)
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import triangle_mean
from eivor.flights.references import SLOPE_S, measured_resets, with_headed_references
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.select import vertical_row
from eivor.signals.filters import fast_length
from eivor.signals.recording import GRAVITY, Channel, Frame, Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights

GRID = Grid(1.0, 0.01, (range(300),))


def channel(time, values, *, held=False, name="velocity_z"):
    return Channel(name, np.asarray(time, dtype=float), np.asarray(values, dtype=float), "", "", held)


#: Gaps, share of samples lost, and seed.
LOSSES = st.integers(0, 4), st.floats(0.0, 0.5), st.integers(0, 999)


def lossy(rate_hz, gaps, lost, seed):
    """Stamps and values of which a share is missing."""
    rng = np.random.default_rng(seed)
    time = random_stamps(rng, rate_hz, gaps)
    return time, np.where(rng.random(time.size) < lost, np.nan, rng.standard_normal(time.size))


def random_stamps(rng, rate_hz, gaps):
    """Stamps with jitter from before the grid to after it, some stretches missing."""
    time = np.arange(0.5, 4.5, 1.0 / rate_hz)
    time = time + rng.uniform(-0.2, 0.2, time.size) / rate_hz
    for _ in range(gaps):
        start = rng.uniform(0.5, 4.0)
        time = time[(time < start) | (time > start + rng.uniform(0.1, 0.6))]
    return time


@given(st.sampled_from([5.0, 30.0, 97.0, 400.0]), *LOSSES)
def test_held_channels_keep_the_last_value_logged(rate_hz, gaps, lost, seed):
    time, values = lossy(rate_hz, gaps, lost, seed)
    series, good = on_grid(channel(time, values, held=True), GRID)
    for t, value, stands in zip(GRID.time_s, series, good, strict=True):
        before = np.flatnonzero(time <= t + 1e-9)
        wanted = values[before[-1]] if before.size else np.nan
        assert stands == np.isfinite(wanted)
        if stands:
            assert value == wanted
    assert np.isfinite(series).all()


@pytest.mark.thorough
@given(st.sampled_from([5.0, 30.0, 97.0]), *LOSSES)
def test_slow_channels_are_interpolated_and_gaps_marked(rate_hz, gaps, lost, seed):
    time, values = lossy(rate_hz, gaps, lost, seed)
    finite = np.isfinite(values)
    if not finite.any():
        return
    series, good = on_grid(channel(time, values), GRID)
    time, values = time[finite], values[finite]
    longest = max(5.0 * np.median(np.diff(time)), 0.1) if time.size > 1 else np.inf
    for t, value, stands in zip(GRID.time_s, series, good, strict=True):
        after = int(np.searchsorted(time, t))
        inside = 0 < after < time.size or (after < time.size and abs(time[after] - t) < 1e-9)
        if inside and after > 0:
            width = time[after] - time[after - 1]
            share = (t - time[after - 1]) / width
            assert value == pytest.approx(
                values[after - 1] + share * (values[after] - values[after - 1]), abs=1e-9
            )
            inside = width <= longest
        assert stands == inside
    assert np.isfinite(series).all()


@given(rate_hz=st.sampled_from([200.0, 997.0, 4000.0]), seed=st.integers(0, 999))
def test_fast_channels_are_averaged_over_each_step(rate_hz, seed):
    rng = np.random.default_rng(seed)
    time = random_stamps(rng, rate_hz, 0)
    values = rng.standard_normal(time.size)
    series, good = on_grid(channel(time, values), GRID)
    assert good.all()
    for k in rng.integers(0, GRID.count, 10):
        t = GRID.time_s[k]
        edges = np.array([t - 0.005, t + 0.005])
        knots = np.concatenate([edges[:1], time[(time > edges[0]) & (time < edges[1])], edges[1:]])
        wanted = np.trapezoid(np.interp(knots, time, values), knots) / 0.01
        assert series[k] == pytest.approx(wanted, abs=1e-7)


@pytest.mark.thorough
@given(st.sampled_from([30.0, 97.0, 400.0]), st.integers(0, 4), st.floats(0.0, 0.2), st.integers(0, 999))
def test_commands_are_their_mean_over_each_step_and_waited_for_after_gaps(rate_hz, gaps, lost, seed):
    time, values = lossy(rate_hz, gaps, lost, seed)
    command = channel(time, values, held=True, name="input")
    series, good = command_on_grid(command, GRID)
    broken = np.zeros(GRID.count, dtype=bool)
    for k, t in enumerate(GRID.time_s):
        edges = np.concatenate([[t], time[(time > t) & (time < t + GRID.step_s)], [t + GRID.step_s]])
        before = np.searchsorted(time, edges[:-1], side="right") - 1
        in_force = values[before] if (before >= 0).all() else np.array([np.nan])
        broken[k] = not np.isfinite(in_force).all() or any(a < t < b for a, b in command.gaps())
        if not broken[k]:
            assert series[k] == pytest.approx(np.diff(edges) @ in_force / GRID.step_s, abs=1e-9)
    wait = int(np.ceil(RECOVERY_S / GRID.step_s))
    for k in range(GRID.count):
        assert good[k] == (not broken[max(k - wait, 0) : k + 1].any())
    assert np.isfinite(series).all()


@pytest.mark.parametrize(("rates", "step"), [((149.0, 400.0), 0.01), ((150.5, 400.0), 0.005), ((5.0,), 0.01)])
def test_grid_spans_what_all_share_and_is_fine_when_all_are_fast(rates, step):
    stamps = [np.arange(0.3 * i, 10.0 - 0.2 * i, 1.0 / rate) for i, rate in enumerate(rates)]
    channels = [channel(time, time) for time in stamps]
    grid = common_grid(channels, channels)
    assert grid.step_s == step
    assert grid.start_s == max(c.time_s[0] for c in channels)
    end = min(c.time_s[-1] for c in channels)
    assert grid.time_s[-1] <= end + 1e-9
    assert grid.time_s[-1] > end - 1.001 * step


def jumping(jump_s, *, held=False, name="velocity_z"):
    """20 s at 100 Hz whose clock jumps in the middle."""
    time = np.arange(2000) * 0.01
    time[1000:] += jump_s
    return channel(time, np.arange(2000.0), held=held, name=name)


def test_a_jump_of_the_clock_costs_no_samples():
    results = [common_grid((jumping(jump),), (jumping(jump),)) for jump in (20.0, 1e4, 1e9)]
    assert [grid.count for grid in results] == [results[0].count] * 3
    for grid, jump in zip(results, (20.0, 1e4, 1e9), strict=True):
        assert grid.count * grid.step_s == pytest.approx(20.0 + MARGIN_S + MEMORY_S, abs=0.03)
        assert (grid.time_s[0], grid.time_s[-1]) == (0.0, pytest.approx(19.99 + jump))
        series, good = on_grid(jumping(jump), grid)
        # what is logged is there, nothing in between counts, and no two pieces meet in samples that do
        assert good.sum() == 2000
        np.testing.assert_allclose(series[good], np.arange(2000.0), atol=1e-4)
        assert not good[np.flatnonzero(np.diff(grid.steps) > 1)].any()


STEP_S = 0.01
MARGIN = round(AIRBORNE_MARGIN_S / STEP_S)


def profile(*stretches):
    """Values held for so many seconds each."""
    return np.concatenate([np.full(round(seconds / STEP_S), value) for seconds, value in stretches])


def found(level, *, landed=None, height=None):
    return airborne(input_level=level, step_s=STEP_S, landed=landed, height=height)


def stretches(mask):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def test_land_detector_decides_and_margins_are_left_out():
    landed = profile((3.0, 1.0), (10.0, 0.0), (2.0, 1.0)) > 0.5
    result = found(np.zeros(1500), landed=landed)
    assert result.rule == "the log's land detector"
    assert stretches(result.mask) == [(300 + MARGIN, 1300 - MARGIN)]
    # In the air from the first sample to the last: no take-off and no landing to leave out.
    assert found(np.zeros(1500), landed=np.zeros(1500, dtype=bool)).mask.all()


def test_input_alone_tells_when_there_is_no_height():
    result = found(profile((2.0, 0.05), (10.0, 0.5), (2.0, 0.0)))
    assert result.rule == "the input (no height is logged)"
    assert stretches(result.mask) == [(200 + MARGIN, 1200 - MARGIN)]


def test_an_input_that_is_off_in_the_air_does_not_make_ground():
    """A dive with the throttle near zero at 1.5 m: the vehicle never touched the ground."""
    level = profile((10.0, 0.5), (0.51, 0.05), (9.49, 0.5))
    result = found(level, height=np.full(2000, 1.5))
    assert result.rule == "the input (it is on at both ends of the log)"
    assert stretches(result.mask) == [(0, 1000 - MARGIN), (1051 + MARGIN, 2000)]
    # the ground is where the flight begins, not where the dive was
    level = profile((2.0, 0.0), (8.0, 0.5), (2.0, 0.0), (8.0, 0.5))
    started = found(level, height=profile((2.0, 0.1), (18.0, 2.0)))
    assert stretches(started.mask) == [(200 + MARGIN, 1000 - MARGIN), (1200 + MARGIN, 2000)]


def test_at_idle_the_ground_carries_what_keeps_its_height():
    """Rotors at a third of their speed in flight were in the air: log and ground made every gain refused."""
    level = profile((4.0, 0.16), (10.0, 0.5), (3.0, 0.16))
    height = profile((4.0, 0.02), (10.0, 1.5), (3.0, 0.05))
    assert stretches(found(level, height=height).mask) == [(400 + MARGIN, 1400 - MARGIN)]
    falling = np.concatenate([height[:1400], 1.5 - 0.003 * np.arange(300.0)])
    assert stretches(found(level, height=falling).mask) == [(400 + MARGIN, 1700)]


def test_while_rotors_spool_up_the_ground_carries_the_rest():
    """Height and land detector may say that it flies; a fall with little thrust is flight."""
    level = np.concatenate([np.zeros(200), np.linspace(0.1, 0.5, 500), np.full(1000, 0.5), np.full(400, 0.2)])
    grid = Grid(0.0, STEP_S, (range(level.size),))
    falling = np.concatenate([np.zeros(1700), -0.6 * 9.80665 * STEP_S * np.arange(400)])

    def ends(velocity, vehicle=""):
        index = np.arange(level.size)
        landed = ((index < 200) | (index >= 2080)).astype(float)
        log = replace(recording({"landed": landed, "velocity_z": velocity}), vehicle=vehicle)
        (found,) = stretches(airborne_by_log(log, grid, level).mask)
        return found

    standing = np.zeros(level.size)
    assert ends(standing) == pytest.approx((200 + 500 * 0.35 / 0.4 + MARGIN, 1700 - MARGIN), abs=25)
    assert ends(falling)[1] == ends(standing, "fixed wing")[1] == 2080 - MARGIN
    assert ends(standing, "fixed wing")[0] == 200 + MARGIN


def test_motors_at_idle_end_a_flight_whatever_the_land_detector_says():
    level = profile((10.0, 0.5), (0.4, 0.001), (5.0, 0.5), (5.0, 0.001))
    result = found(level, landed=np.zeros(2040, dtype=bool))
    assert stretches(result.mask) == [(0, 1540 - MARGIN)]


def test_input_that_never_rises_never_flies():
    for level in (profile((5.0, 0.0)), profile((5.0, -0.3)), profile((5.0, 0.0), (0.1, 1.0))):
        assert not found(level).mask.any()


def test_before_its_first_message_the_land_detector_says_landed():
    (log,) = flown(seconds=10.0)
    late = as_channel("landed", [2.0, 9.0], [0.0, 0.0])
    mask = prepare_vertical(changed(log, landed=late), ev.FlightOptions()).active.mask
    assert stretches(mask) == [(200 + MARGIN, 1000)]


@pytest.mark.parametrize("values", [([], []), ([0.0], [np.nan])])
def test_a_land_detector_that_says_nothing_is_no_land_detector(values):
    (log,) = flown(seconds=10.0)
    log = changed(log, landed=as_channel("landed", *values))
    assert prepare_vertical(log, ev.FlightOptions()).active.mask.all()


#: Turns z-up axes (world and body alike) into z-down ones.
DOWN = np.diag([1.0, -1.0, -1.0])


def tilted(seed=0, count=600):
    """Attitudes and world specific forces of a vehicle that leans about, z up."""
    rng = np.random.default_rng(seed)
    time = FLOWN_STEP_S * np.arange(count)
    lean = [0.2 * np.sin(w * time + p) for w, p in ((2.0, 0.3), (3.1, 1.0), (0.7, 0.0))]
    turns = Rotation.from_euler("xyz", np.column_stack(lean))
    force = np.column_stack([np.sin(time), np.cos(time), 9.8 + rng.standard_normal(count)])
    return time, turns, force


def body_log(turns, body_force, frame, scale=1.0):
    x, y, z, w = turns.as_quat().T * scale
    columns = {
        "velocity_z": np.zeros(len(turns)),
        "input": 0.5 + 0.1 * np.sin(np.arange(len(turns))),
        **{f"attitude_{axis}": part for axis, part in zip("wxyz", (w, x, y, z), strict=True)},
        **{f"specific_force_body_{axis}": body_force[:, i].copy() for i, axis in enumerate("xyz")},
    }
    return replace(recording(columns), frame=frame)


@pytest.mark.parametrize("frame", list(Frame))
@pytest.mark.parametrize("scale", [1.0, -1.0, 3.0])
def test_world_force_comes_from_the_bodys_and_the_attitude(frame, scale):
    """An attitude and its negative are one rotation, and its length does not count."""
    _, turns, force = tilted()
    if frame is Frame.NED:
        matrices = DOWN @ turns.as_matrix() @ DOWN
        logged = Rotation.from_matrix(matrices)
        body = logged.inv().apply(force @ DOWN)
    else:
        logged, body = turns, turns.inv().apply(force)
    prepared = prepare_vertical(body_log(logged, body, frame, scale), ev.FlightOptions())
    np.testing.assert_allclose(prepared.signals.channel("specific_force_z"), force[:, 2], atol=1e-9)
    np.testing.assert_allclose(prepared.signals.channel("cos_tilt"), turns.as_matrix()[:, 2, 2], atol=1e-12)


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search", "unchecked_shapes")
def test_z_down_log_gives_the_answers_of_the_z_up_log():
    (log,) = flown(seconds=12.0)
    _, turns, _ = tilted(count=1200)
    x, y, z, w = turns.as_quat().T
    leaning = changed(log, "cos_tilt", attitude_w=w, attitude_x=x, attitude_y=y, attitude_z=z)
    down = dict(leaning.channels)
    for name in ("position_z", "velocity_z", "specific_force_z", "reference_position_z",
                 "reference_velocity_z", "attitude_y", "attitude_z"):  # fmt: skip
        down[name] = replace(down[name], values=-down[name].values)
    flight = ev.identify_flight(leaning)
    mirrored = ev.identify_flight(replace(leaning, channels=down, frame=Frame.NED))
    for name, quantity in flight.quantities.items():
        assert mirrored.quantities[name].value == pytest.approx(quantity.value, rel=1e-9)
        assert mirrored.quantities[name].interval == pytest.approx(quantity.interval, rel=1e-6)
    np.testing.assert_array_equal(down["velocity_z"].values, -leaning.channels["velocity_z"].values)


def test_attitudes_that_are_none_give_no_value():
    zero = [as_channel(f"attitude_{axis}", np.arange(3.0), [0.0, 1.0, np.nan]) for axis in "wxyz"]
    row = vertical_row(zero)[1]
    assert np.isnan(row[[0, 2]]).all()
    assert np.isfinite(row[1]).all()


def test_axes_of_the_accelerometer_may_have_their_own_clocks():
    time, turns, force = tilted()
    log = body_log(turns, turns.inv().apply(force), Frame.Z_UP)
    z = log.channels["specific_force_body_z"]
    smooth = turns.inv().apply(np.column_stack([np.sin(time), np.cos(time), 9.8 + 0.0 * time]))
    later = time[:-1] + 0.5 * FLOWN_STEP_S
    moved = {"specific_force_body_z": replace(z, values=smooth[:, 2].copy())}
    for i, name in enumerate(("specific_force_body_x", "specific_force_body_y")):
        moved[name] = as_channel(name, later, np.interp(later, time, smooth[:, i]))
    flown_with = changed(log, **moved)
    result = prepare_vertical(flown_with, ev.FlightOptions()).signals.channel("specific_force_z")
    np.testing.assert_allclose(result[2:-2], 9.8, atol=2e-3)
    # An axis without a sample is no accelerometer.
    empty = changed(log, specific_force_body_x=as_channel("specific_force_body_x", [], []))
    names = [finding.name for finding in prepare_vertical(empty, ev.FlightOptions()).findings]
    assert "no_accelerometer" in names


LEVEL, TILTED = 1.0, 0.8


def tilting(log, *excursions):
    """The log with a tilt beyond the limit between some times [s]."""
    time = log.channels["cos_tilt"].time_s
    cosine = np.full(time.size, LEVEL)
    for start, end in excursions:
        cosine[(time >= start - FLOWN_STEP_S / 2) & (time < end - FLOWN_STEP_S / 2)] = TILTED
    return changed(log, cos_tilt=cosine)


def test_short_excursions_are_left_out_of_a_run_and_long_ones_end_it(still_log):
    excursions = (0.0, 0.5), (4.0, 4.6), (6.0, 7.0), (11.0, 12.1), (13.5, 14.0)
    flight = prepare_vertical(tilting(still_log, *excursions), ev.FlightOptions())
    time = flight.grid.time_s
    spans = [(time[run.start], time[run.stop - 1] + FLOWN_STEP_S) for run in flight.runs]
    # 790 samples are 784 and a few, which are left out for the sake of transforms
    end = 12.1 + fast_length(790) * FLOWN_STEP_S
    np.testing.assert_allclose(spans, [(0.5, 11.0), (12.1, end)], atol=1e-9)
    assert flight.used_s == pytest.approx(10.5 - 1.6 + end - 12.1 - 0.5)
    assert not flight.used[flight.signals.channel("cos_tilt") < 0.9].any()


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["reference_iv", "extended_iv"])
@pytest.mark.usefixtures("coarse_search")
def test_what_is_measured_beyond_a_limit_counts_for_nothing(still_log, method):
    tilted = tilting(still_log, (4.0, 4.6), (9.0, 9.8))
    force = tilted.channel("specific_force_z").values.copy()
    spoilt = changed(tilted, specific_force_z=np.where(tilted.channel("cos_tilt").values < 0.9, 1e3, force))
    options = ev.FlightOptions(method=method)
    was, flight = ev.identify_flight(tilted, options), ev.identify_flight(spoilt, options)
    for name, quantity in was.quantities.items():
        assert flight.quantities[name].value == pytest.approx(quantity.value, rel=1e-9)
        assert flight.quantities[name].interval == pytest.approx(quantity.interval, rel=1e-9)


# Preparation: which samples are used, which channels serve, and the sentences of refusals.


@pytest.fixture(scope="module")
def still_log():
    return flown(seconds=20.0)[0]


def bounds(prepared):
    """First and last second of each run."""
    time = prepared.grid.time_s
    return [(time[run.start], time[run.stop - 1]) for run in prepared.runs]


def test_window_cuts_the_run(still_log):
    # 850 of 851 samples, which is 23 * 37; a window that reaches beyond the log ends with it
    for window, run in (((4.0, 12.5), (4.0, 12.49)), ((15.0, 99.0), (15.0, 19.99))):
        prepared = prepare_vertical(still_log, FlightOptions(window=window))
        assert bounds(prepared) == [pytest.approx(run)]


def test_tilt_beyond_the_limit_is_left_out(still_log):
    tilt = np.ones(2000)
    tilt[800:900] = np.cos(np.deg2rad(20.0))
    tilt[1300:1400] = np.cos(np.deg2rad(30.0))
    leaning = changed(still_log, cos_tilt=tilt)
    assert len(prepare_vertical(leaning, FlightOptions()).runs) == 1
    assert prepare_vertical(leaning, FlightOptions()).used.sum() == 1900
    assert prepare_vertical(leaning, FlightOptions(max_tilt_deg=10.0)).used.sum() == 1800
    assert prepare_vertical(leaning, FlightOptions(max_tilt_deg=40.0)).used.sum() == 2000


def test_a_gap_of_the_command_breaks_the_run_and_is_waited_for(still_log):
    command = still_log.channels["rotor_command_1"]
    keep = (command.time_s < 8.0) | (command.time_s >= 9.0)
    kept = replace(command, time_s=command.time_s[keep], values=command.values[keep])
    prepared = prepare_vertical(changed(still_log, rotor_command_1=kept), FlightOptions())
    first, second = bounds(prepared)
    assert first == pytest.approx((0.0, 7.99), abs=0.011)
    assert second[0] == pytest.approx(9.3, abs=0.021)


def test_acceleration_may_be_logged_without_gravity(still_log):
    force = still_log.channels["specific_force_z"].values
    coordinate = changed(still_log, "specific_force_z", acceleration_z=force - GRAVITY)
    made = (prepare_vertical(log, FlightOptions()).signals for log in (still_log, coordinate))
    np.testing.assert_allclose(*(signals.channel("specific_force_z") for signals in made))


@pytest.mark.parametrize(
    ("missing", "finding"), [("specific_force_z", "no_accelerometer"), ("cos_tilt", "no_attitude")]
)
def test_what_is_not_logged_becomes_a_finding(still_log, missing, finding):
    prepared = prepare_vertical(changed(still_log, missing), FlightOptions())
    assert finding in [item.name for item in prepared.findings]
    np.testing.assert_array_equal(prepared.signals.channel("cos_tilt"), 1.0)
    rate_hz = 0.0 if missing == "specific_force_z" else 100.0
    assert prepared.rates_hz["acceleration"] == pytest.approx(rate_hz)


def test_an_accelerometer_at_its_limit_is_left_out(still_log):
    quick = GRAVITY + 3.0 * np.sin(3.0 * still_log.channels["specific_force_z"].time_s)
    for force, clipped in ((quick, False), (np.minimum(quick, 12.0), True), (np.round(quick), False)):
        findings = prepare_vertical(changed(still_log, specific_force_z=force), FlightOptions()).findings
        assert ("clipped_accelerometer" in {item.name for item in findings}) is clipped


def test_commands_come_before_measured_speeds_before_inputs(still_log):
    steady = np.full(2000, 0.5)
    everything = changed(still_log, rotor_speed_1=steady, input=steady)
    for drop, family, measured, name in (
        ((), "rotor_command", False, "square"),
        (("rotor_command_1",), "rotor_speed", True, "square"),
        (("rotor_command_1", "rotor_speed_1"), "input", False, "linear"),
    ):
        prepared = prepare_vertical(replace(changed(everything, *drop), input_map=""), FlightOptions())
        assert (prepared.input.name, prepared.input.measured, prepared.input_map) == (family, measured, name)


def test_map_is_the_users_then_the_logs(still_log):
    mixed = replace(still_log, input_map="mixed:0.3")
    assert prepare_vertical(mixed, FlightOptions()).input_map == "mixed:0.3"
    assert prepare_vertical(mixed, FlightOptions(input_map="power:1.5")).input_map == "power:1.5"


def empty(name, kept):
    """A channel that is there and says nothing."""
    return {
        "nothing": as_channel(name, [], []),
        "one sample": as_channel(name, [1.0], [1.0]),
        "NaN": as_channel(name, np.arange(3.0), np.full(3, np.nan)),
    }[kept]


@pytest.mark.parametrize("kept", ["nothing", "one sample", "NaN"])
def test_an_empty_accelerometer_is_done_without(still_log, kept):
    blind = changed(still_log, specific_force_z=empty("specific_force_z", kept))
    prepared = prepare_vertical(blind, FlightOptions())
    assert "empty_channel" in [finding.name for finding in prepared.findings]
    assert "specific_force_z" not in prepared.signals.channels
    assert prepared.runs


def remarks(log, **options):
    return {r.name: r.remark for r in prepare_vertical(log, FlightOptions(**options)).references}


def test_pilots_stick_counts_while_a_pilot_flies(still_log):
    stick = changed(still_log, pilot_throttle=np.sin(FLOWN_STEP_S * np.arange(2000)))
    assert "pilot_throttle" in prepare_vertical(stick, FlightOptions()).usable_references
    for share, serves in ((0.4, False), (0.6, True)):
        flies = as_channel("pilot_in_control", [0.0, 20.0 * share], [1.0, 0.0])
        flies = replace(flies, held=True)
        judged = changed(stick, pilot_in_control=flies)
        assert ("pilot_throttle" in prepare_vertical(judged, FlightOptions()).usable_references) is serves
        if not serves:
            assert remarks(judged)["pilot_throttle"] == "no pilot flies"


def test_a_reference_that_is_set_to_the_measured_height_stands_still_there():
    """Landings begin at the measured height, and so do height holds: such a jump answers the vehicle."""
    (still_log,) = flown(1, seconds=20.0, seed=3)
    height, wanted = still_log.channel("position_z"), still_log.channel("reference_position_z")
    measured = np.interp(wanted.time_s, height.time_s, height.values)
    flying = wanted.time_s < 12.0  # with a standing error, and then a landing from where the vehicle is
    landing = replace(wanted, values=np.where(flying, wanted.values + 0.3, measured[1200]))
    between = (wanted.time_s > 5.0) & (wanted.time_s < 9.0)
    held = replace(wanted, values=np.where(between, measured, wanted.values - 0.3))
    for other, times in ((landing, "11.9"), (held, "4.9")):
        flight = prepare_vertical(changed(still_log, reference_position_z=other), FlightOptions())
        (reference,) = [item for item in flight.references if item.name == "reference_position_z"]
        assert f"set to the measured position_z at {times}" in reference.remark
        assert any(finding.name == "reference_reset" for finding in flight.findings)
        np.testing.assert_array_equal(flight.reference_on_grid(reference.name), reference.logged)
        moved = np.abs(np.diff(reference.values))
        assert moved.max() < 0.05 < np.abs(np.diff(reference.logged)).max()
    echo = changed(still_log, reference_position_z=replace(wanted, values=measured))
    assert remarks(echo)["reference_position_z"] == "it is the measured position_z"
    steps = replace(wanted, values=np.where(wanted.time_s % 4.0 < 2.0, 0.5, -0.5))
    kinks = replace(wanted, values=np.abs(wanted.time_s % 4.0 - 2.0))
    since = np.maximum(0.01 * np.arange(400) - 2.003, 0.0)  # a smooth step passes by what is measured
    assert not measured_resets(0.023 - np.minimum(10.0 * since**2, 1.0), np.zeros(400), 0.01)
    for clean in (wanted, steps, kinks):
        flight = prepare_vertical(changed(still_log, reference_position_z=clean), FlightOptions())
        assert all(reference.logged is None for reference in flight.references)


def test_setpoints_across_the_ground_are_turned_by_the_heading():
    """Of a position the slope; without what it is set to as measured, and where one part is not in force."""
    time = 0.02 * np.arange(500)
    wanted, position = np.where(time < 4.0, 0.0, 2.0), np.minimum(np.maximum(time - 4.2, 0.0), 1.4)
    wanted[350:] = position[350:]
    series = {"reference_position_x": wanted, "reference_position_y": 0.0 * time, "position_x": position}
    series |= {
        f"attitude_{part}": np.full(500, value) for part, value in zip("wxyz", (0.6, 0, 0, 0.8), strict=True)
    }
    series |= {
        "reference_acceleration_x": np.where(time < 1.0, np.nan, 3.0),
        "reference_acceleration_y": time,
    }
    channels = {name: as_channel(name, time, values) for name, values in series.items()}
    log = with_headed_references(Recording("across", "simulated", channels))
    # the heading is 2 atan2(.8, .6): what goes along x goes backward and to the right
    cos, sin = 0.6**2 - 0.8**2, 2.0 * 0.6 * 0.8
    along = {word: log.channels[f"reference_position_{word}"].values for word in ("forward", "left")}
    slope = np.where(time < 4.0, 0.0, 2.0 * np.exp(-(time - 4.0) / SLOPE_S) / SLOPE_S)
    np.testing.assert_allclose(along["forward"], cos * slope, atol=1e-9)  # the reset at 7 s is taken out
    np.testing.assert_allclose(along["left"], -sin * slope, atol=1e-9)
    forward = log.channels["reference_acceleration_forward"].values
    assert np.isnan(forward[time < 1.0]).all()
    np.testing.assert_allclose(forward[time >= 1.0], 3.0 * cos + time[time >= 1.0] * sin)


def test_references_must_be_in_force_for_half_of_the_flight(still_log):
    position = still_log.channels["reference_position_z"].values.copy()
    position[900:] = np.nan
    log = changed(still_log, reference_position_z=position)
    assert remarks(log)["reference_position_z"] == "in force for 45% of the flight only"
    # Within a window in which it is in force it serves.
    windowed = prepare_vertical(log, FlightOptions(window=(0.0, 8.0)))
    assert "reference_position_z" in windowed.usable_references


def test_feedback_serves_only_when_nothing_else_does(still_log):
    velocity = changed(still_log, feedback_reference_velocity_z=np.sin(FLOWN_STEP_S * np.arange(2000)))
    assert remarks(velocity)["feedback_reference_velocity_z"] == "contains feedback; others serve"
    alone = changed(velocity, "reference_position_z", "reference_velocity_z")
    assert prepare_vertical(alone, FlightOptions()).usable_references == ("feedback_reference_velocity_z",)
    # A loop whose own setpoint never moves computes from disturbances alone.
    still = changed(velocity, "reference_velocity_z", reference_position_z=np.zeros(2000))
    assert prepare_vertical(still, FlightOptions()).usable_references == ()
    assert "never moved (reference_position_z)" in remarks(still)["feedback_reference_velocity_z"]


@pytest.mark.parametrize(("feedback", "planned"), [(0.0, True), (1.5, False)])
def test_a_velocity_setpoint_that_holds_feedback_is_noticed(still_log, feedback, planned):
    """As a table may hold what a position loop makes: the friction was covered in .81, without a word."""
    wanted, speed = (still_log.channels[f"reference_{name}_z"].values for name in ("position", "velocity"))
    blown = 0.1 * np.sin(1.7 * FLOWN_STEP_S * np.arange(2000))
    log = changed(still_log, position_z=wanted + blown, reference_velocity_z=speed - feedback * blown)
    (reference,) = (
        item
        for item in prepare_vertical(log, FlightOptions()).references
        if item.name == "reference_velocity_z"
    )
    assert reference.exogenous is reference.usable is planned
    assert (reference.remark == "contains feedback; others serve") is not planned


def test_instruments_may_be_named(still_log):
    prepared = prepare_vertical(still_log, FlightOptions(instruments=("reference_velocity_z", "velocity_z")))
    assert prepared.usable_references == ("reference_velocity_z", "velocity_z")
    np.testing.assert_array_equal(
        prepared.signals.channel("reference_velocity_z"), still_log.channels["reference_velocity_z"].values
    )


def test_named_channels_of_the_vehicle_itself_answer_it(still_log):
    extra = changed(still_log, battery_voltage=np.ones(2000), pilot_in_control=np.ones(2000))
    names = ("velocity_z", "rotor_command", "battery_voltage", "pilot_in_control", "reference_velocity_z")
    references = prepare_vertical(extra, FlightOptions(instruments=names)).references
    exogenous = {"pilot_in_control", "reference_velocity_z"}
    members = (name.replace("command", "command_1") for name in names)
    assert {r.name: r.exogenous for r in references} == {name: name in exogenous for name in members}


def test_no_usable_sample_leaves_no_reference(still_log):
    grounded = changed(still_log, landed=as_channel("landed", [0.0, 19.0], [1.0, 1.0]))
    prepared = prepare_vertical(grounded, FlightOptions())
    assert prepared.runs == ()
    assert set(remarks(grounded).values()) == {"no usable sample of flight"}
    assert not prepared.constant_input


SEEDS = range(50, 58)


@pytest.mark.thorough
def test_gains_are_not_small():
    specs = [VerticalFlightSpec(seed=seed, duration=60.0) for seed in SEEDS]
    errors = []
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        channels = dict(flight.recording.channels)
        for name in ("velocity_z", "position_z"):
            logged = channels[name]
            channels[name] = Channel(name, logged.time_s[::10], logged.values[::10], logged.unit)
        fit = identify_flight(Recording("slow", "simulated", channels))
        gain = fit.quantities["input_gain"]
        errors.append((gain.value / spec.input_gain - 1.0, gain.std_error / spec.input_gain))
    error, scatter = np.array(errors).T
    # lines between the stamps make it 0.55 % too small, twice what chance does to eight flights
    assert abs(error.mean()) < 2.0 * np.sqrt(np.mean(scatter**2) / error.size)
    assert abs(error.mean()) < 0.003


FINE_GRID = Grid(0.0, 0.005, (range(4000),))


@pytest.mark.parametrize("frequency_hz", [1.0, 4.0, 8.0])
def test_amplitudes_shrink_as_those_of_a_line_between_stamps(frequency_hz):
    time, width_s = FINE_GRID.time_s, 0.02
    series = np.sin(2.0 * np.pi * frequency_hz * time)
    # the line between samples that are as far apart, with every phase of the samples
    lines = np.mean(
        [
            np.interp(time, stamps, np.sin(2.0 * np.pi * frequency_hz * stamps))
            for stamps in (np.arange(-0.1, 20.1, width_s) + shift for shift in np.arange(0.0, width_s, 0.001))
        ],
        axis=0,
    )
    inside = slice(100, -100)
    seen = series[inside]
    spread = triangle_mean(series, FINE_GRID, width_s, held=0.5)  # what samples of a triangle lack
    gains = [float(item[inside] @ seen / (seen @ seen)) for item in (spread, lines)]
    assert gains[0] == pytest.approx(gains[1], abs=2e-4)
    assert gains[0] < 1.0


STAMPS = np.arange(0.0, 20.0, 0.1)
AT = np.arange(1.0, 19.0, 0.01)


def test_numbers_near_the_largest_give_numbers():
    values = 1e308 * (-1.0) ** np.arange(STAMPS.size)
    with np.errstate(all="ignore"):
        between, line = cubic(STAMPS, values, AT), linear(STAMPS, values, AT)
    assert np.array_equal(np.isfinite(between), np.isfinite(line))
