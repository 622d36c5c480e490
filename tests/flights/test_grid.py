"""Channels on the common grid against naive references, and commands after their gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import STEP_S as EXCURSIONS_STEP_S
from flight_logs import STEP_S as FRAMES_STEP_S
from flight_logs import changed, flown, prepare_vertical, recording
from flight_logs import channel as channel_airborne
from flight_logs import channel as channel_frames
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import eivor as ev
from eivor.errors import InputError, ShapeError
from eivor.flights.grid import (
    AIRBORNE_MARGIN_S,
    MARGIN_S,
    MEMORY_S,
    RECOVERY_S,
    Grid,
    airborne,
    command_on_grid,
    common_grid,
    on_grid,
)
from eivor.motions.vertical.select import vertical_row
from eivor.signals.filters import fast_length
from eivor.signals.recording import Channel, Frame

GRID = Grid(1.0, 0.01, (range(300),))


def channel(time, values, *, held=False, name="velocity_z"):
    return Channel(name, np.asarray(time, dtype=float), np.asarray(values, dtype=float), "", "", held)


def random_stamps(rng, rate_hz, gaps):
    """Stamps with jitter from before the grid to after it, some stretches missing."""
    time = np.arange(0.5, 4.5, 1.0 / rate_hz)
    time = time + rng.uniform(-0.2, 0.2, time.size) / rate_hz
    for _ in range(gaps):
        start = rng.uniform(0.5, 4.0)
        time = time[(time < start) | (time > start + rng.uniform(0.1, 0.6))]
    return time


@given(
    rate_hz=st.sampled_from([5.0, 30.0, 97.0, 400.0]),
    gaps=st.integers(0, 4),
    lost=st.floats(0.0, 0.5),
    seed=st.integers(0, 999),
)
def test_held_channels_keep_the_last_value_logged(rate_hz, gaps, lost, seed):
    rng = np.random.default_rng(seed)
    time = random_stamps(rng, rate_hz, gaps)
    values = np.where(rng.random(time.size) < lost, np.nan, rng.standard_normal(time.size))
    series, good = on_grid(channel(time, values, held=True), GRID)
    for t, value, stands in zip(GRID.time_s, series, good, strict=True):
        before = np.flatnonzero(time <= t + 1e-9)
        wanted = values[before[-1]] if before.size else np.nan
        assert stands == np.isfinite(wanted)
        if stands:
            assert value == wanted
    assert np.isfinite(series).all()


@pytest.mark.thorough
@given(
    rate_hz=st.sampled_from([5.0, 30.0, 97.0]),
    gaps=st.integers(0, 4),
    lost=st.floats(0.0, 0.5),
    seed=st.integers(0, 999),
)
def test_slow_channels_are_interpolated_and_gaps_marked(rate_hz, gaps, lost, seed):
    rng = np.random.default_rng(seed)
    time = random_stamps(rng, rate_hz, gaps)
    values = np.where(rng.random(time.size) < lost, np.nan, rng.standard_normal(time.size))
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
@given(
    rate_hz=st.sampled_from([30.0, 97.0, 400.0]),
    gaps=st.integers(0, 4),
    lost=st.floats(0.0, 0.2),
    seed=st.integers(0, 999),
)
def test_commands_are_their_mean_over_each_step_and_waited_for_after_gaps(rate_hz, gaps, lost, seed):
    rng = np.random.default_rng(seed)
    time = random_stamps(rng, rate_hz, gaps)
    values = np.where(rng.random(time.size) < lost, np.nan, rng.standard_normal(time.size))
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
    channels = [
        channel(
            np.arange(0.3 * i, 10.0 - 0.2 * i, 1.0 / rate), np.arange(0.3 * i, 10.0 - 0.2 * i, 1.0 / rate)
        )
        for i, rate in enumerate(rates)
    ]
    grid = common_grid(channels, channels)
    assert grid.step_s == step
    assert grid.start_s == max(c.time_s[0] for c in channels)
    end = min(c.time_s[-1] for c in channels)
    assert grid.time_s[-1] <= end + 1e-9
    assert grid.time_s[-1] > end - 1.001 * step


def test_clocks_that_do_not_overlap_are_refused():
    early, late = channel([0.0, 1.0], [0.0, 0.0]), channel([2.0, 3.0], [0.0, 0.0], name="input")
    with pytest.raises(
        InputError, match=r"velocity_z, input are all logged; received none \(the last begins at 2"
    ):
        common_grid([early, late], [])
    with pytest.raises(InputError, match="Expected a stretch of time"):
        common_grid([early, channel([1.0, 3.0], [0.0, 0.0])], [])


def test_stamps_in_another_unit_are_refused_before_memory_runs_out():
    microseconds = channel([0.0, 6e7], [0.0, 0.0])
    with pytest.raises(InputError, match=r"at most 6 hours; received stamps that cover 16666\.7 hours.*unit"):
        common_grid([microseconds], [])


def jumping(jump_s, *, held=False, name="velocity_z"):
    """20 s at 100 Hz whose clock jumps in the middle."""
    time = np.arange(2000) * 0.01
    time[1000:] += jump_s
    return channel(time, np.arange(2000.0), held=held, name=name)


def gridded(*channels):
    """Grid of 100 Hz of channels of which the first is fast."""
    return common_grid(channels, channels[:1])


def test_a_jump_of_the_clock_costs_no_samples():
    results = [gridded(jumping(jump)) for jump in (20.0, 1e4, 1e9)]
    assert [grid.count for grid in results] == [results[0].count] * 3
    for grid, jump in zip(results, (20.0, 1e4, 1e9), strict=True):
        assert grid.count * grid.step_s == pytest.approx(20.0 + MARGIN_S + MEMORY_S, abs=0.03)
        assert grid.time_s[0] == 0.0
        assert grid.time_s[-1] == pytest.approx(19.99 + jump)
        series, good = on_grid(jumping(jump), grid)
        # what is logged is there, nothing in between counts, and no two pieces meet in samples that do
        assert good.sum() == 2000
        np.testing.assert_allclose(series[good], np.arange(2000.0), atol=1e-4)
        assert not good[np.flatnonzero(np.diff(grid.steps) > 1)].any()


def test_more_than_six_hours_of_samples_are_refused():
    time = np.arange(0.0, 7 * 3600.0, 1.0)
    with pytest.raises(InputError, match=r"7\.0 hours"):
        gridded(channel(time, np.zeros(time.size)))


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
    started = found(
        profile((2.0, 0.0), (8.0, 0.5), (2.0, 0.0), (8.0, 0.5)), height=profile((2.0, 0.1), (18.0, 2.0))
    )
    assert stretches(started.mask) == [(200 + MARGIN, 1000 - MARGIN), (1200 + MARGIN, 2000)]


def test_motors_at_idle_end_a_flight_whatever_the_land_detector_says():
    level = profile((10.0, 0.5), (0.4, 0.001), (5.0, 0.5), (5.0, 0.001))
    result = found(level, landed=np.zeros(2040, dtype=bool))
    assert stretches(result.mask) == [(0, 1540 - MARGIN)]


@pytest.mark.parametrize(
    "level", [profile((5.0, 0.0)), profile((5.0, -0.3)), profile((5.0, 0.0), (0.1, 1.0))]
)
def test_input_that_never_rises_never_flies(level):
    assert not found(level).mask.any()


def airborne_share(log):
    return float(prepare_vertical(log, ev.FlightOptions()).active.mask.mean())


def test_before_its_first_message_the_land_detector_says_landed():
    (log,) = flown(seconds=10.0)
    late = channel_airborne("landed", [2.0, 9.0], [0.0, 0.0])
    mask = prepare_vertical(changed(log, landed=late), ev.FlightOptions()).active.mask
    assert stretches(mask) == [(200 + MARGIN, 1000)]


@pytest.mark.parametrize("values", [([], []), ([0.0], [np.nan])])
def test_a_land_detector_that_says_nothing_is_no_land_detector(values):
    (log,) = flown(seconds=10.0)
    assert airborne_share(changed(log, landed=channel_airborne("landed", *values))) == 1.0


#: Turns z-up axes (world and body alike) into z-down ones.
DOWN = np.diag([1.0, -1.0, -1.0])


def tilted(seed=0, count=600):
    """Attitudes and world specific forces of a vehicle that leans about, z up."""
    rng = np.random.default_rng(seed)
    time = FRAMES_STEP_S * np.arange(count)
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
@pytest.mark.usefixtures("coarse_search")
@pytest.mark.usefixtures("unchecked_shapes")
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
    zero = [channel_frames(f"attitude_{axis}", np.arange(3.0), [0.0, 1.0, np.nan]) for axis in "wxyz"]
    row = vertical_row(zero)[1]
    assert np.isnan(row[[0, 2]]).all()
    assert np.isfinite(row[1]).all()


def test_attitudes_on_several_clocks_are_refused():
    parts = [
        channel_frames(f"attitude_{axis}", np.arange(3.0) + (axis == "y"), np.ones(3)) for axis in "wxyz"
    ]
    with pytest.raises(
        ShapeError, match=r"Expected the four parts of an attitude on one clock; received 3 stamps"
    ):
        vertical_row(parts)


def test_axes_of_the_accelerometer_may_have_their_own_clocks():
    time, turns, force = tilted()
    log = body_log(turns, turns.inv().apply(force), Frame.Z_UP)
    z = log.channels["specific_force_body_z"]
    smooth = turns.inv().apply(np.column_stack([np.sin(time), np.cos(time), 9.8 + 0.0 * time]))
    later = time[:-1] + 0.5 * FRAMES_STEP_S
    moved = {
        f"specific_force_body_{axis}": channel_frames(
            f"specific_force_body_{axis}", later, np.interp(later, time, smooth[:, i])
        )
        for i, axis in enumerate("xy")
    }
    flown_with = changed(log, **moved, specific_force_body_z=replace(z, values=smooth[:, 2].copy()))
    result = prepare_vertical(flown_with, ev.FlightOptions()).signals.channel("specific_force_z")
    np.testing.assert_allclose(result[2:-2], 9.8, atol=2e-3)
    # An axis without a sample is no accelerometer.
    empty = changed(log, specific_force_body_x=channel_frames("specific_force_body_x", [], []))
    names = [finding.name for finding in prepare_vertical(empty, ev.FlightOptions()).findings]
    assert "no_accelerometer" in names


LEVEL, TILTED = 1.0, 0.8


def tilting(log, *excursions):
    """The log with a tilt beyond the limit between some times [s]."""
    time = log.channels["cos_tilt"].time_s
    cosine = np.full(time.size, LEVEL)
    for start, end in excursions:
        cosine[(time >= start - EXCURSIONS_STEP_S / 2) & (time < end - EXCURSIONS_STEP_S / 2)] = TILTED
    return changed(log, cos_tilt=cosine)


@pytest.fixture(scope="module")
def log():
    return flown(seconds=20.0, seed=3)[0]


def test_short_excursions_are_left_out_of_a_run_and_long_ones_end_it(log):
    flight = prepare_vertical(
        tilting(log, (0.0, 0.5), (4.0, 4.6), (6.0, 7.0), (11.0, 12.1), (13.5, 14.0)), ev.FlightOptions()
    )
    time = flight.grid.time_s
    spans = [(time[run.start], time[run.stop - 1] + EXCURSIONS_STEP_S) for run in flight.runs]
    # 790 samples are 784 and a few, which are left out for the sake of transforms
    end = 12.1 + fast_length(790) * EXCURSIONS_STEP_S
    np.testing.assert_allclose(spans, [(0.5, 11.0), (12.1, end)], atol=1e-9)
    assert flight.used_s == pytest.approx(10.5 - 1.6 + end - 12.1 - 0.5)
    assert not flight.used[flight.signals.channel("cos_tilt") < 0.9].any()


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["reference_iv", pytest.param("extended_iv", marks=pytest.mark.thorough)])
@pytest.mark.usefixtures("coarse_search")
def test_what_is_measured_beyond_a_limit_counts_for_nothing(log, method):
    tilted = tilting(log, (4.0, 4.6), (9.0, 9.8))
    force = tilted.channel("specific_force_z").values.copy()
    spoilt = changed(tilted, specific_force_z=np.where(tilted.channel("cos_tilt").values < 0.9, 1e3, force))
    options = ev.FlightOptions(method=method)
    was, flight = ev.identify_flight(tilted, options), ev.identify_flight(spoilt, options)
    for name, quantity in was.quantities.items():
        assert flight.quantities[name].value == pytest.approx(quantity.value, rel=1e-9)
        assert flight.quantities[name].interval == pytest.approx(quantity.interval, rel=1e-9)
