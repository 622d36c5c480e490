"""Channels on the common grid against naive references, and commands after their gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eivor.errors import InputError
from eivor.flights.grid import (
    MARGIN_S,
    MEMORY_S,
    RECOVERY_S,
    Grid,
    around,
    command_on_grid,
    common_grid,
    on_grid,
)
from eivor.signals.recording import Channel

GRID = Grid(1.0, 0.01, (range(300),))


def channel(time, values, *, held: bool = False, name: str = "velocity_z") -> Channel:
    return Channel(name, np.asarray(time, dtype=float), np.asarray(values, dtype=float), "", "", held)


def random_stamps(rng: np.random.Generator, rate_hz: float, gaps: int) -> np.ndarray:
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


def test_averages_keep_a_line_and_quieten_noise():
    time = np.arange(0.0, 5.0, 0.001)
    series, _ = on_grid(channel(time, 3.0 * time - 1.0), GRID)
    np.testing.assert_allclose(series, 3.0 * GRID.time_s - 1.0, atol=1e-9)
    noise = np.random.default_rng(0).standard_normal(time.size)
    # Ten samples in a step: a tenth of the variance, to within its sampling error.
    assert on_grid(channel(time, noise), GRID)[0].var() == pytest.approx(0.1, rel=0.4)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("rate_hz", [10.0, 1000.0])
@pytest.mark.parametrize("kept", [0, 1, 2])
def test_channels_with_hardly_a_value_stand_on_nothing_much(held, rate_hz, kept):
    time = np.arange(0.0, 5.0, 1.0 / rate_hz)
    values = np.full(time.size, np.nan)
    values[time.size // 2 : time.size // 2 + kept] = 2.0
    series, good = on_grid(channel(time, values, held=held), GRID)
    assert np.isfinite(series).all()
    assert good.sum() <= kept * max(100.0 / rate_hz, 1.0) + 1
    if kept:
        np.testing.assert_array_equal(series[good], 2.0)
    # The channel without a sample, and the one with a single one.
    assert not on_grid(channel([], [], held=held), GRID)[1].any()
    series, good = on_grid(channel([2.0], [7.0], held=held), GRID)
    np.testing.assert_array_equal(series, 7.0)
    assert good.sum() == (200 if held else 1)


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


def test_commands_stamped_on_the_grid_are_left_alone():
    values = np.random.default_rng(0).standard_normal(500)
    stamps = np.arange(500) * 0.01 + np.where(np.arange(500) % 2, 2e-10, -2e-10)
    series, good = command_on_grid(channel(stamps, values, held=True), GRID)
    np.testing.assert_array_equal(series, values[100:400])
    assert good.all()


def test_hours_of_commands_are_averaged_as_exactly_as_seconds():
    rng = np.random.default_rng(1)
    values = 1000.0 + rng.standard_normal(400)
    stamps = 1.0 + np.arange(400) * 0.01 + 0.004
    alone = command_on_grid(channel(stamps, values, held=True), GRID)[0]
    earlier = channel(
        np.concatenate([[-1e7, -9e6], stamps]), np.concatenate([[1e6, 1000.0], values]), held=True
    )
    np.testing.assert_allclose(command_on_grid(earlier, GRID)[0][1:], alone[1:], rtol=1e-12)


# -- the grid itself --------------------------------------------------------------------------------------


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


# -- hours without a sample ----------------------------------------------------------------------------


def jumping(jump_s: float, *, held: bool = False, name: str = "velocity_z") -> Channel:
    """20 s at 100 Hz whose clock jumps in the middle."""
    time = np.arange(2000) * 0.01
    time[1000:] += jump_s
    return channel(time, np.arange(2000.0), held=held, name=name)


def gridded(*channels: Channel) -> Grid:
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


def test_gaps_of_some_seconds_stay_on_the_grid():
    assert gridded(jumping(9.0)).pieces == (range(2900),)


def test_only_what_makes_samples_useless_is_left_out():
    held = jumping(100.0, held=True, name="landed")
    steady = channel(np.arange(0.0, 120.0, 0.01), np.zeros(12000))
    assert gridded(steady, held).count == 12000
    assert common_grid([steady, held], [steady, held]).count == pytest.approx(
        2000 + 100 * (MARGIN_S + MEMORY_S), abs=2
    )


def test_silences_of_several_channels_are_joined():
    lengths = []
    for jumps in ([100.0], [100.0, 100.0], [100.0, 50.0]):
        channels = [jumping(jump, name=f"c{k}") for k, jump in enumerate(jumps)]
        channels.append(channel(np.arange(0.0, 119.99, 0.01), np.zeros(11999), name="steady"))
        lengths.append(gridded(*channels).count)
    assert lengths[0] == lengths[1]
    assert lengths[2] < lengths[0]  # the time that all share ends earlier


def test_the_mean_rate_is_that_of_the_time_logged():
    assert jumping(1e6).rate_hz == pytest.approx(100.0)
    assert jumping(0.5).rate_hz == pytest.approx(1999 / 20.49)
    resting = channel([0.0, 50.0, 110.0, 150.0], np.zeros(4), held=True)
    assert resting.rate_hz == pytest.approx(3 / 150.0)


def test_more_than_six_hours_of_samples_are_refused():
    time = np.arange(0.0, 7 * 3600.0, 1.0)
    with pytest.raises(InputError, match=r"7\.0 hours"):
        gridded(channel(time, np.zeros(time.size)))


@pytest.mark.thorough
@given(seed=st.integers(0, 999), runs=st.integers(0, 4))
def test_around_what_is_used_stays_what_it_needs(seed, runs):
    rng = np.random.default_rng(seed)
    grid = Grid(0.0, 0.1, (range(100), range(250, 400), range(900, 950)))
    used = np.zeros(grid.count, dtype=bool)
    for first in rng.integers(0, grid.count, runs):
        used[first : first + rng.integers(1, 20)] = True
    kept = around(used, grid, memory_s=2.0)
    t = grid.time_s
    wanted = [
        used.any()
        and bool(
            ((t[used] - item >= -1e-9) & (t[used] - item <= 2.0 + 1e-9)).any()
            or ((item - t[used] >= -1e-9) & (item - t[used] <= MARGIN_S + 1e-9)).any()
        )
        for item in t
    ]
    np.testing.assert_array_equal(kept, wanted)
    cut = grid.kept(kept)
    np.testing.assert_array_equal(cut.time_s, t[kept])
    assert len(cut.pieces) <= runs + 2  # those of the grid that a run lies across
