"""What noises say of their covariance, against direct sums and against noise that was drawn."""

from __future__ import annotations

import copy
import pickle
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from cost import in_transforms
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import lsim
from scipy.spatial.transform import Rotation
from scipy.special import binom

import eivor as ev
import refusal_rows as refusals
from eivor.errors import (
    ChannelMapError,
    EivorError,
    MissingChannelError,
    NonFiniteError,
    ParameterError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.flights.grid import upward
from eivor.flights.timestamps import as_issued, command_clock
from eivor.logs.common import channel_findings
from eivor.signals import channels, noise
from eivor.signals import channels as canonical
from eivor.signals.filters import actuator_state, low_passed, rate_limited, reciprocal, time_derivative
from eivor.signals.noise import GrowthTable, fractional_difference, fractional_weights
from eivor.signals.recording import Channel, DataSheet, Frame, clean_channel, interval_within
from eivor.signals.thrust_map import Mixed, Power, input_map


def direct(order, lag, start, count):
    """Sum of the products of weights, term by term."""
    weights = fractional_weights(order, start + count + lag + 1)
    return np.array(
        [sum(weights[q] * weights[q + lag] for q in range(m + 1)) for m in range(start, start + count)]
    )


@given(order=st.floats(-0.5, 0.5), lag=st.integers(0, 12), start=st.integers(0, 40), count=st.integers(1, 40))
def test_fractional_autocovariance_is_the_double_sum(order, lag, start, count):
    autocovariance = ev.FractionalNoise(2.0, order).autocovariance(lag, start, count)
    np.testing.assert_allclose(autocovariance, 4.0 * direct(order, lag, start, count), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("lag", [0, 3, 11])
@pytest.mark.parametrize("order", [-0.5, -0.4, 0.3])
def test_growth_across_blocks_is_the_growth_without_them(monkeypatch, order, lag):
    whole = direct(order, lag, 0, 90)
    monkeypatch.setattr(noise, "BLOCK", 7)
    table = GrowthTable(order, lag)
    # The default number of weights was bound when the class was made: blocks of seven need their own.
    monkeypatch.setattr(GrowthTable._weights, "__defaults__", (8,), raising=True)
    for start, count in ((60, 5), (0, 90), (6, 2), (13, 30), (89, 1)):
        np.testing.assert_allclose(table.stretch(start, count), whole[start : start + count], rtol=1e-12)


def test_growth_across_the_border_of_real_blocks():
    border = noise.BLOCK
    lag, order = 4, -0.4
    weights = fractional_weights(order, border + 40)
    whole = np.cumsum(weights[: border + 20] * weights[lag : border + 20 + lag])
    stretch = GrowthTable(order, lag).stretch(border - 10, 25)
    np.testing.assert_allclose(stretch, whole[border - 10 : border + 15], rtol=1e-10)


def test_published_weights_and_differences():
    """Order 0.4: 1, -0.4, -0.12, ...; order 0.5 of (1, 2, 4, 7, 0); by hand, from the binomial series."""
    weights = [1.0, -0.4, -0.12, -0.064, -0.0416, -0.029952]
    np.testing.assert_allclose(fractional_weights(0.4, 6), weights, rtol=1e-14)
    difference = fractional_difference(np.array([1.0, 2.0, 4.0, 7.0, 0.0]), 0.5)
    np.testing.assert_allclose(difference, [1.0, 1.5, 2.875, 4.6875, -4.1640625], rtol=1e-13)


def test_order_is_the_slope_of_the_spectrum():
    """Over the middle decades, log S rises by 2 * order per unit of log w."""
    for order in (-0.5, -0.4, 0.3):
        noise, streams = ev.FractionalNoise(1.0, order), np.random.default_rng(2).spawn(60)
        samples = np.array([noise.sample(4096, stream) for stream in streams])
        power = np.mean(np.abs(np.fft.rfft(samples * np.hanning(4096))) ** 2, axis=0)
        w = 2.0 * np.pi * np.fft.rfftfreq(4096)
        band = (w > 0.01) & (w < 0.5)
        slope, _ = np.polyfit(np.log(2.0 * np.sin(w[band] / 2.0)), np.log(power[band]), 1)
        assert slope == pytest.approx(2.0 * order, abs=0.06)


COUNT = 200_000
NOISES = [
    ev.AutoregressiveNoise(0.4, 0.9),
    ev.AutoregressiveNoise(0.4, -0.5),
    ev.HeavyTailedNoise(0.4, 5.0),
    ev.RoundingNoise(0.4),
]


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 7])
def test_samples_have_the_autocovariance(noise, lag):
    series = noise.sample(COUNT, np.random.default_rng(4))
    result = np.mean(series[: COUNT - lag] * series[lag:])
    expected = noise.autocovariance(lag, 1_000, 3)
    assert expected.shape == (3,)
    assert result == pytest.approx(expected[0], abs=0.03 * noise.std**2)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 3])
def test_the_moving_average_has_the_autocovariance_of_a_record_that_begins(noise, lag):
    weights = noise.moving_average(40)
    expected = [weights[: m + 1] @ weights[lag : lag + m + 1] for m in range(20)]
    np.testing.assert_allclose(noise.autocovariance(lag, 0, 20), expected, atol=1e-12)
    np.testing.assert_allclose(noise.autocovariance(lag, 5, 4), expected[5:9], atol=1e-12)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
def test_another_size_is_the_same_noise_larger(noise):
    louder = noise.with_std(2.0 * noise.std)
    once, twice = (item.sample(50, np.random.default_rng(1)) for item in (noise, louder))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-12)


def test_tails_are_heavy_and_rounding_has_none():
    heavy = ev.HeavyTailedNoise(1.0, 3.0).sample(COUNT, np.random.default_rng(2))
    assert np.abs(heavy).max() > 12.0
    rounding = ev.RoundingNoise(1.0)
    assert rounding.step == pytest.approx(np.sqrt(12.0))
    assert np.abs(rounding.sample(COUNT, np.random.default_rng(2))).max() <= 0.5 * rounding.step


def test_density_over_a_bandwidth_and_the_rounding_of_a_step_add_up():
    assert DataSheet(density=0.002, bandwidth_hz=50.0).std(200.0) == pytest.approx(0.002 * 50.0**0.5)
    assert DataSheet(density=0.002).std(200.0) == pytest.approx(0.02)
    assert DataSheet(step=0.12).std(1.0) == pytest.approx(0.12 / 12.0**0.5)


RUNS = 500


@pytest.mark.calibration
@pytest.mark.parametrize("bandwidth", [None, 1999])
@pytest.mark.parametrize("order", [-0.5, -0.4, 0.0, 0.3, 0.5])
def test_estimates_are_centred_and_their_errors_cover(order, bandwidth):
    rng = np.random.default_rng([31, int(10 * order + 10), bandwidth or 0])
    records = 1.7 * fractional_difference(rng.standard_normal((4000, RUNS)), order) + 9.81
    results = [ev.estimate_long_memory(record.copy(), bandwidth=bandwidth) for record in records.T]
    order_scores = np.array([(result.order - order) / result.order_error for result in results])
    std_scores = np.array([(result.std - 1.7) / result.std_error for result in results])
    # The periodogram's own bias is of the order of log(m)/sqrt(m): a fifth of a standard error at most.
    for scores in (order_scores, std_scores):
        assert abs(scores.mean()) < 0.2 + 4.0 / np.sqrt(RUNS)
        assert scores.std() == pytest.approx(1.0, abs=0.03 + 4.0 / np.sqrt(2.0 * RUNS))
    covered = np.mean(np.abs(order_scores) <= 1.96)
    assert abs(covered - 0.95) < 0.01 + 3.5 * np.sqrt(0.95 * 0.05 / RUNS)


def test_errors_are_those_of_the_theory():
    values = np.random.default_rng(4).standard_normal(100_001)
    local, whole = (ev.estimate_long_memory(values, bandwidth=m) for m in (500, 50_000))
    assert local.order_error == pytest.approx(0.5 / np.sqrt(500), rel=0.04)  # ln(m)^2 / (2m) more
    assert whole.order_error == pytest.approx(np.sqrt(6.0 / np.pi**2 / values.size), rel=0.01)
    assert whole.std_error == pytest.approx(whole.std / np.sqrt(2.0 * values.size), rel=0.01)
    assert local.bandwidth == 500
    assert ev.estimate_long_memory(values).bandwidth == int(100_001**0.65)


def test_noise_to_declare():
    record = fractional_difference(np.random.default_rng(3).standard_normal(2000), -0.7)
    memory = ev.estimate_long_memory(record)
    assert memory.order < -0.5
    assert memory.noise() == ev.FractionalNoise(memory.std, memory.order)


@pytest.mark.thorough
def test_a_million_samples_take_as_long_as_a_few_transforms():
    """About six, of 0.04 s each."""
    rng = np.random.default_rng(0)
    values = ev.FractionalNoise(1.0, -0.5).sample(999_983, rng)  # a prime: the FFT's worst case
    memory = ev.estimate_long_memory(values)
    assert in_transforms(lambda: ev.estimate_long_memory(values), values.size) < 20.0
    assert abs(memory.order + 0.5) < 5.0 * memory.order_error


# Fractional differences against direct summation and against their own inverse.


@given(order=st.floats(-2.0, 2.0), count=st.integers(1, 60), seed=st.integers(0, 1000))
def test_fft_is_the_direct_sum(order, count, seed):
    values = np.random.default_rng(seed).standard_normal((count, 2))
    weights = fractional_weights(order, count)
    direct = np.stack([np.convolve(weights, column)[:count] for column in values.T], axis=1)
    near = 1e-13 * count * (1.0 + np.abs(direct).max())
    np.testing.assert_allclose(fractional_difference(values, order), direct, rtol=0.0, atol=near)


@pytest.mark.parametrize("order", [-1.3, -0.5, 0.25, 0.5, 1.7])
def test_weights_are_signed_binomials(order):
    lags = np.arange(20)
    np.testing.assert_allclose(fractional_weights(order, 20), (-1.0) ** lags * binom(order, lags), rtol=1e-10)


def test_integer_orders_are_differences_and_sums_with_zeros_before():
    values = np.random.default_rng(1).standard_normal(30)
    np.testing.assert_allclose(fractional_difference(values, 0.0), values, atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, 1.0), np.diff(values, prepend=0.0), atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, -1.0), np.cumsum(values), atol=1e-12)


@pytest.mark.thorough
def test_a_million_samples_are_differenced_by_a_few_transforms():
    """About four; direct summation takes as long as a hundred thousand. One is 0.04 s."""
    values = np.random.default_rng(3).standard_normal(999_983)  # a prime: the FFT's worst case
    difference = fractional_difference(values, -0.5)
    assert in_transforms(lambda: fractional_difference(values, -0.5), values.size) < 15.0
    # The last sample, by direct summation over the whole record.
    direct = fractional_weights(-0.5, values.size) @ values[::-1]
    assert difference[-1] == pytest.approx(direct, rel=1e-10)


# Input maps: inverse, slope and name each give back what the map says.

THROTTLE = canonical.CanonicalChannel("throttle", "", held=True, free_unit=True)
SPEED = canonical.CanonicalChannel("forward_speed", "m/s")
SIDEWAYS = canonical.CanonicalChannel("sideways_speed", "m/s", flipped=True)
CURRENT = canonical.CanonicalChannel("motor_current_*", "A")


@pytest.fixture
def table(monkeypatch):
    """The table of channels, which is as it was after the test."""
    monkeypatch.setattr(channels, "_TABLE", dict(canonical.canonical_channels()))


@pytest.fixture
def declared(table):
    canonical.declare_channels(THROTTLE, SPEED, SIDEWAYS, CURRENT)


def test_rotors_have_numbers():
    assert (
        canonical.canonical_channel("rotor_command_12") == canonical.canonical_channels()["rotor_command_*"]
    )
    for name in ("rotor_command_*", "rotor_command_", "rotor_command_01", "rotor_command_1234", "absent", ""):
        assert canonical.canonical_channel(name) is None
        assert not canonical.held_by_default(name)
    assert (canonical.unit_of("rotor_speed_3"), canonical.unit_of("velocity_z")) == ("", "m/s")
    assert (canonical.held_by_default("landed"), canonical.held_by_default("velocity_z")) == (True, False)


def test_declared_channels_in_maps(declared, tmp_path):
    (tmp_path / "t.csv").write_text("t,v,i,pwm\n0.0,36.0,1.0,9\n1.0,72.0,2.0,9\n")
    text = """
name = "rover"
[time]
column = "t"
[channels.forward_speed]
column = "v"
unit = "km/h"
[channels.motor_current_2]
column = "i"
unit = "A"
[channels.throttle]
column = "pwm"
unit = "us"
"""
    (tmp_path / "m.toml").write_text(text)
    r = ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels["forward_speed"].values, [10.0, 20.0])
    assert (r.channels["motor_current_2"].unit, r.channels["throttle"].held) == ("A", True)
    assert [c.name for c in r.family("motor_current_*")] == ["motor_current_2"]
    (tmp_path / "m.toml").write_text(text.replace('"km/h"', '"A"'))
    with pytest.raises(ChannelMapError, match=r"one of .*, km/h, .*received 'A'"):
        ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")


def test_frames_turn_what_says_so(declared):
    columns = {"time": [0.0, 0.1], "forward_speed": [1.0, 2.0], "sideways_speed": [1.0, 2.0]}
    r = upward(ev.recording_from_columns(columns, frame=Frame.NED))
    assert r.channels["forward_speed"].values.tolist() == [1.0, 2.0]
    assert r.channels["sideways_speed"].values.tolist() == [-1.0, -2.0]


def test_declaring_again(declared):
    before = dict(canonical.canonical_channels())
    canonical.declare_channels(SPEED, SPEED, canonical.canonical_channels()["velocity_z"])
    assert dict(canonical.canonical_channels()) == before


@pytest.mark.parametrize(
    "other",
    [
        canonical.CanonicalChannel("forward_speed", "km/h"),
        canonical.CanonicalChannel("forward_speed", "m/s", held=True),
        canonical.CanonicalChannel("velocity_z", "m/s"),
        canonical.CanonicalChannel("rotor_speed_1", "rad/s"),
        canonical.CanonicalChannel("motor_current_7", "A"),
    ],
)
def test_another_channel_of_a_name_that_is_taken(declared, other):
    before = dict(canonical.canonical_channels())
    with pytest.raises(UsageError, match=r"declared once, or the same each time.*Rename one"):
        canonical.declare_channels(canonical.CanonicalChannel("steering", "rad"), other)
    assert dict(canonical.canonical_channels()) == before


def test_a_family_beside_one_of_its_members(table):
    canonical.declare_channels(canonical.CanonicalChannel("wheel_1", "rad/s"))
    with pytest.raises(UsageError, match="wheel_1"):
        canonical.declare_channels(canonical.CanonicalChannel("wheel_*", "rad/s"))
    with pytest.raises(UsageError, match="declared once"):
        canonical.declare_channels(*(canonical.CanonicalChannel(f"track_{end}", "") for end in "1*"))


MAPS = st.one_of(
    st.floats(0.2, 5.0).map(Power),
    st.sampled_from([Power(1.0), Power(2.0), Power(1.5), Mixed(0.0), Mixed(1.0)]),
    st.floats(0.0, 1.0).map(Mixed),
)


def value(mapping, state):
    return float(mapping(np.array([state]))[0])


@given(mapping=MAPS, state=st.floats(1e-3, 1e4))
def test_inverse_undoes_the_map(mapping, state):
    assert mapping.inverse(value(mapping, state)) == pytest.approx(state, rel=1e-9)


@given(mapping=MAPS, state=st.floats(1e-3, 1e4))
def test_slope_is_the_difference_quotient(mapping, state):
    step = 1e-5 * state
    quotient = (value(mapping, state + step) - value(mapping, state - step)) / (2.0 * step)
    assert mapping.slope(state) == pytest.approx(quotient, rel=1e-6)


def test_the_words_are_the_maps():
    state = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_array_equal(input_map("linear")(state), state)
    np.testing.assert_array_equal(input_map("square")(state), [-4.0, 0.0, 9.0])
    np.testing.assert_allclose(input_map("power:3")(state), [-8.0, 0.0, 27.0])
    np.testing.assert_allclose(input_map("mixed:0.3")(state), 0.7 * state + 0.3 * state * np.abs(state))
    assert np.isnan(Mixed(0.3).inverse(-0.1))
    assert Power(2.0).inverse(-4.0) == -2.0


# Channels, recordings and signals: what they accept, what they count, what they leave alone.

STAMPS = st.lists(
    st.one_of(st.integers(-3, 12).map(float), st.sampled_from([np.nan, np.inf, -np.inf])), max_size=25
)


def channel(time, values=None, name="velocity_z"):
    time = np.asarray(time, dtype=float)
    return Channel(name, time, time.copy() if values is None else np.asarray(values, dtype=float), "m/s")


@given(stamps=STAMPS, seed=st.integers(0, 99))
def test_cleaning_is_the_naive_walk_through_the_samples(stamps, seed):
    rng = np.random.default_rng(seed)
    values = np.where(rng.random(len(stamps)) < 0.2, np.inf, rng.standard_normal(len(stamps)))
    kept, duplicated, backward, latest = [], 0, 0, -np.inf
    for index, stamp in enumerate(stamps):
        if not np.isfinite(stamp):
            backward += 1
        elif stamp > latest:
            kept.append(index)
            latest = stamp
        elif stamp == latest:
            duplicated += 1
        else:
            backward += 1
    time = np.array(stamps, dtype=float)
    before = (time.copy(), values.copy())
    result = clean_channel("velocity_z", time, values, "m/s", overflowed=2, saturated=3)
    np.testing.assert_array_equal(result.time_s, time[kept])
    np.testing.assert_array_equal(result.values, np.where(np.isfinite(values[kept]), values[kept], np.nan))
    assert (result.quality.duplicated_stamps, result.quality.backward_stamps) == (duplicated, backward)
    assert result.quality.missing_values == int((~np.isfinite(values[kept])).sum())
    assert (result.quality.overflowed, result.quality.saturated) == (2, 3)
    np.testing.assert_array_equal(time, before[0])
    np.testing.assert_array_equal(values, before[1])


@pytest.mark.parametrize(
    ("time", "rate"),
    [([], 0.0), ([3.0], 0.0), ([1.0, 1.5, 2.0, 2.5], 2.0), ([0.0, 0.5, 1.0, 1.5, 9.0, 9.5], 2.0)],
)
def test_rate_is_steps_over_span_without_gaps(time, rate):
    assert channel(time).rate_hz == rate


def test_gaps_are_long_in_median_steps_and_in_seconds():
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(1.06, 2.0, 0.01), np.arange(2.5, 3.0, 0.01)])
    gaps = channel(time).gaps()
    assert len(gaps) == 1
    assert gaps[0] == pytest.approx((1.99, 2.5), abs=1e-9)
    assert len(channel(time).gaps(at_least_s=0.01)) == 2
    assert (channel([]).gaps(), channel([1.0]).gaps()) == ([], [])
    assert channel(np.arange(0.0, 10.0, 0.2)).gaps() == []


def test_families_are_in_the_order_of_their_numbers():
    names = ["rotor_command_10", "rotor_command_2", "rotor_command_1", "rotor_command_x", "input"]
    log = ev.Recording("log", "frame", {name: channel([0.0, 1.0], name=name) for name in names})
    ordered = ["rotor_command_1", "rotor_command_2", "rotor_command_10"]
    for item in ("rotor_command", "rotor_command_", "rotor_command_*"):
        assert [c.name for c in log.family(item)] == ordered
    assert [c.name for c in log.family("rotor_command_2")] == ["rotor_command_2"]
    assert log.family("rotor_speed") == []
    signals = ev.Signals(10.0, {name: np.full(3, float(i)) for i, name in enumerate(names)})
    np.testing.assert_array_equal(signals.family("rotor_command")[0], [2.0, 1.0, 0.0])
    assert signals.family("rotor_speed").shape == (3, 0)


EMPTY = ev.Recording("a.ulg", "ulog", {}, looked_for={"velocity_z": ("vehicle_local_position.vz",)})


def test_a_log_without_channels_has_no_span():
    assert EMPTY.span_s == (0.0, 0.0)


@given(st.tuples(*[st.floats(-5.0, 15.0)] * 2))
def test_windows_are_cut_to_the_span_or_refused(window):
    span = (0.0, 10.0)
    start, end = max(window[0], 0.0), min(window[1], 10.0)
    if window[0] < window[1] and start < end:
        assert interval_within(window, span) == (start, end)
    else:
        with pytest.raises(UsageError, match="Expected a window START:END inside the log"):
            interval_within(window, span)


def test_errors_survive_other_processes_and_copies():
    error = MissingChannelError("the channel 'a'", "a log without it", "Log it.")
    for again in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error)):  # noqa: S301 - our own bytes
        assert isinstance(again, MissingChannelError)
        assert str(again) == "Expected the channel 'a'; received a log without it. Log it."
        assert vars(again) == vars(error)
    assert issubclass(MissingChannelError, EivorError)


def erring(step_s, error_s, seconds=40.0):
    """Even times, and stamps of them that err."""
    even = np.arange(0.0, seconds, step_s)
    return even, even + error_s * np.random.default_rng(5).standard_normal(even.size)


EVEN, ERRING = erring(0.004, 0.004)
BURSTS = np.ceil(EVEN / 0.02 - 1e-6) * 0.02 + 1e-6 * ((np.arange(EVEN.size) + 4) % 5)


@pytest.mark.parametrize("stamps", [ERRING, BURSTS])
def test_stamps_that_err_or_come_in_bursts_are_evened(stamps):
    channel = clean_channel("velocity_z", stamps, np.sin(EVEN), "m/s")
    (findings,) = channel_findings({"velocity_z": channel})
    assert (findings.name, "evened: velocity_z 10000" in findings.message) == ("time_stamps", True)
    assert np.std(channel.time_s - EVEN) < 0.25 * np.std(stamps - EVEN)


def test_stamps_at_two_rates_take_no_more_memory_than_others():
    time_s = np.append(1e-6 * np.arange(6000), 1.0 + 0.01 * np.arange(4000))
    channel = clean_channel("input", time_s, np.sin(time_s), "")
    assert as_issued(channel, command_clock(channel, [])).time_s.size < 10 * time_s.size
    assert rate_limited(channel.values, channel.time_s, np.array([0.5])).shape == (1, channel.time_s.size)
    assert time_derivative(np.ones(1), 0.01).tolist() == [0.0]


@pytest.mark.parametrize(
    ("name", "among", "members"),
    [
        ("input", ["input", "input_1"], ["input"]),
        ("rotor_command", ["rotor_command_10", "rotor_command_2", "rotor_command_x1"], ["2", "10"]),
        ("rotor_command_*", ["rotor_command_1", "other_2"], ["1"]),
        ("torque_setpoint", ["torque_setpoint_z", "torque_setpoint_x", "torque_setpoint_w"], ["x", "z"]),
        ("nothing", ["something_1"], []),
    ],
)
def test_numbers_come_in_their_order_and_axes_in_theirs(name, among, members):
    stem = name.removesuffix("_*")
    expected = members if members == ["input"] else [f"{stem}_{member}" for member in members]
    assert canonical.family_members(name, among) == expected


# The actuator's state against an independent integration and the exact solution between changes.

STEP_S = 0.01


def exact_state(command, lag_s, delay_s):
    """State at the samples, by the exponential between the times at which the delayed command changes."""
    state = command[0]
    states = [state]
    for k in range(1, command.size):
        start, end = (k - 1) * STEP_S, k * STEP_S
        changes = np.arange(command.size) * STEP_S + delay_s
        inside = changes[(changes > start + 1e-12) & (changes < end - 1e-12)]
        edges = np.concatenate([[start], inside, [end]])
        for begin, finish in pairwise(edges):
            index = int(np.floor((0.5 * (begin + finish) - delay_s) / STEP_S))
            held = command[max(index, 0)]
            state = held + (state - held) * np.exp(-(finish - begin) / lag_s)
        states.append(state)
    return np.array(states)


@settings(max_examples=60)
@given(lag_s=st.floats(1e-3, 0.5), delay_s=st.floats(0.0, 0.06), seed=st.integers(0, 10_000))
def test_state_is_exact_for_any_lag_and_any_fraction_of_a_delay(lag_s, delay_s, seed):
    command = np.random.default_rng(seed).standard_normal(25)
    result = actuator_state(command[:, None], step_s=STEP_S, lag_s=lag_s, delay_s=delay_s)[:, 0]
    np.testing.assert_allclose(result, exact_state(command, lag_s, delay_s), atol=1e-6)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.48])
def test_a_second_stage_is_two_lags_in_series(share):
    """By the transition matrix of both over the step in which the command is held."""
    command, lag_s = np.random.default_rng(1).standard_normal(25), 0.05
    first, second = (1.0 - share) * lag_s, share * lag_s
    A = np.array([[-1.0 / first, 0.0], [1.0 / second, -1.0 / second]])
    step, state = expm(A * STEP_S), np.full(2, command[0])
    exact = [state[1]]
    for held in command[:-1]:
        state = held + step @ (state - held)
        exact.append(state[1])
    given = {"lag_s": lag_s, "delay_s": 0.0, "second_stage": share * (1.0 - share)}
    result = actuator_state(command[:, None], step_s=STEP_S, **given)[:, 0]
    np.testing.assert_allclose(result, exact, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 64, 500])
def test_an_inverse_filter_solves_the_recursion(count):
    weights = 5.0 * fractional_weights(0.7, count)
    weights[0] += 1.0
    solved = np.zeros(count)
    for k in range(count):
        solved[k] = ((k == 0) - weights[1 : k + 1] @ solved[:k][::-1]) / weights[0]
    assert reciprocal(weights) == pytest.approx(solved, abs=1e-15)


def test_polynomials_of_degree_six_are_exact_inside():
    time = STEP_S * np.arange(40)
    derivative = time_derivative(time**6 - 3.0 * time**5 + time, STEP_S)
    exact = 6.0 * time**5 - 15.0 * time**4 + 1.0
    np.testing.assert_allclose(derivative[3:-3], exact[3:-3], rtol=1e-9)
    np.testing.assert_allclose(derivative, exact, atol=0.05)


def test_short_series_have_a_derivative_too():
    np.testing.assert_allclose(time_derivative(np.array([1.0, 2.0, 3.0]), 0.5), [2.0, 2.0, 2.0])


@pytest.mark.parametrize(("step_s", "cutoff_hz"), [(0.002, 80.0), (0.01, 80.0), (0.005, 30.0)])
def test_lines_between_samples_are_filtered_exactly_also_beyond_half_the_grids_rate(step_s, cutoff_hz):
    time = step_s * np.arange(300)
    series = np.cos(2.0 * np.pi * 3.0 * time) + time
    omega = 2.0 * np.pi * cutoff_hz
    # from rest, so that the constant that the filter has seen for ever is taken off
    _, expected, _ = lsim(([omega**2], [1.0, np.sqrt(2.0) * omega, omega**2]), series - series[0], time)
    result = low_passed(series[:, None], step_s=step_s, cutoff_hz=cutoff_hz)[:, 0]
    np.testing.assert_allclose(result, expected + series[0], atol=1e-12)


def test_angles_are_those_of_successive_turns_and_yaw_goes_on():
    angles = np.linspace([-1.0, 0.8, -2.0], [1.2, -1.1, 9.0], 50).T
    quaternions = Rotation.from_euler("ZYX", angles[::-1].T).as_quat(scalar_first=True).T
    quaternions[:, ::7] *= -1.0  # the same attitudes
    np.testing.assert_allclose(canonical.roll_pitch_yaw(quaternions), angles, atol=1e-12)


def test_what_is_missing_stays_missing():
    quaternions = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), 3)
    quaternions[2, 1] = np.nan
    np.testing.assert_array_equal(np.isnan(canonical.roll_pitch_yaw(quaternions)), [[False, True, False]] * 3)


OF_NOISES = refusals.calls("noise", (ParameterError, NonFiniteError), *(
    (make, f"Expected .*; received {said}") for make, said in (
        (lambda: ev.WhiteNoise(-0.1), "std=-0.1"),
        (lambda: ev.WhiteNoise(float("nan")), "std=nan"),
        (lambda: ev.FractionalNoise(float("inf"), 0.1), "std=inf"),
        (lambda: ev.FractionalNoise(1.0, 0.51), "order=0.51"),
        (lambda: ev.FractionalNoise(1.0, float("nan")), "order=nan"),
        (lambda: ev.AutoregressiveNoise(1.0, 1.0), "coefficient"),
        (lambda: ev.AutoregressiveNoise(1.0, -1.2), "coefficient"),
        (lambda: ev.AutoregressiveNoise(1.0, np.nan), "coefficient"),
        (lambda: ev.HeavyTailedNoise(1.0, 2.0), "degrees"),
        (lambda: ev.HeavyTailedNoise(1.0, -3.0), "degrees"),
        (lambda: ev.HeavyTailedNoise(1.0, np.inf), "degrees"),
)))  # fmt: skip
OF_RECORDS = refusals.rows("record", None, lambda values, options: ev.estimate_long_memory(values, **options),
    (np.arange(10.0), {}, TooFewSamplesError, "Expected 17 samples or more; received 10"),
    (np.full(100, 3.3), {}, ParameterError, "a record that varies; received a constant one"),
    (np.zeros(100), {}, ParameterError, "a record that varies; received a constant one"),
    (np.full(100, np.nan), {}, NonFiniteError, "finite values; received NaN"),
    (np.arange(100.0), {"bandwidth": 50}, ParameterError, "8 to 49 frequencies; received bandwidth=50"),
    (np.arange(100.0), {"bandwidth": 3}, ParameterError, "8 to 49 frequencies; received bandwidth=3"),
)  # fmt: skip


def signals(*counts, valid=None):
    ev.Signals(1.0, dict(zip(("input", "velocity_z"), map(np.zeros, counts), strict=False)), valid=valid)


HOLED = {"input": np.array([0.0, np.nan, 1.0, np.inf])}
FIRST_THREE = np.array([True, False, True, True])
OF_CALLS = refusals.calls("call", None,
    *((partial(DataSheet, **stated), UsageError, "Expected")
        for stated in ({}, {"density": -1.0}, {"step": float("inf")},
            {"density": 1.0, "bandwidth_hz": -1.0})),
    (signals, ShapeError, "Expected at least one channel"),
    (lambda: signals(3, 4), ShapeError, "Expected at least one channel"),
    (lambda: signals(3, valid=np.ones(2, bool)), ShapeError, "Expected at least one channel"),
    (lambda: ev.Signals(1.0, HOLED), NonFiniteError,
        r"'input' at every valid sample; received 2 .* sample 1"),
    (lambda: ev.Signals(1.0, HOLED, valid=FIRST_THREE), NonFiniteError, r"received 1 .* sample 3"),
    (lambda: ev.Signals(1.0, {"input": np.zeros(2)}).channel("speed"), MissingChannelError,
        "a channel called 'speed'; received channels input"),
    (lambda: ev.Signals(5.0, {"input": np.zeros(4)}, noise={"inptu": ev.WhiteNoise(0.1)}), UsageError,
        "noise of the channels input; received noise of 'inptu'"),
    (lambda: canonical.unit_of("absent"), UsageError,
        "name of a canonical channel; received 'absent'.*velocity_z"),
    (lambda: EMPTY.channel("velocity_z"), MissingChannelError,
        r"the channel 'velocity_z' in a\.ulg.*position\.vz"),
    (lambda: EMPTY.channel("input"), MissingChannelError, "no source of it is known"),
)  # fmt: skip
OF_RATES = refusals.rows("rate", NonFiniteError, lambda rate: ev.Signals(rate, {"input": np.zeros(3)}),
    *((rate, r"Expected a positive rate in Hz; received rate_hz=") for rate in (0.0, -1.0, np.nan, np.inf)),
)  # fmt: skip
OF_STAMPS = refusals.rows("stamps", NonFiniteError, channel,
    *((stamps, r"finite, strictly increasing time stamps.*clean_channel")
        for stamps in ([0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan], [0.0, np.inf])),
)  # fmt: skip
OF_LENGTHS = refusals.rows("lengths", ShapeError,
    lambda make: make("velocity_z", np.arange(3.0), np.arange(4.0), "m/s"),
    (Channel, r"Expected one stamp for each value of channel 'velocity_z'"),
    (clean_channel, r"Expected one stamp for each value of channel 'velocity_z'"),
)  # fmt: skip
OF_NAMES = refusals.rows("name", UsageError, lambda name: canonical.CanonicalChannel(name, ""),
    *((name, "small letters, digits") for name in ("", "Speed", "time", "a b", "a-b", "*")),
)  # fmt: skip
OF_MAPS = refusals.rows("input map", UsageError, input_map,
    *((name, r"Expected an? .*; received")
        for name in ("", "cubic", "square:2", "power", "power:", "power:0", "mixed", "mixed:1.01")),
)  # fmt: skip


test_refused = refusals.table(
    OF_NOISES, OF_RECORDS, OF_CALLS, OF_RATES, OF_STAMPS, OF_LENGTHS, OF_NAMES, OF_MAPS
)


def test_signals_may_hold_what_is_not_valid():
    ev.Signals(1.0, HOLED, valid=np.array([True, False, True, False]))
