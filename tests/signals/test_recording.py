"""Channels, recordings and signals: what they accept, what they count, what they leave alone."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import eivor as ev
from eivor.errors import EivorError, MissingChannelError, NonFiniteError, ShapeError, UsageError
from eivor.logs.common import channel_findings
from eivor.signals.channels import family_members
from eivor.signals.recording import Channel, clean_channel, interval_within

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
    assert result.quality.duplicated_stamps == duplicated
    assert result.quality.backward_stamps == backward
    assert result.quality.missing_values == int((~np.isfinite(values[kept])).sum())
    assert (result.quality.overflowed, result.quality.saturated) == (2, 3)
    np.testing.assert_array_equal(time, before[0])
    np.testing.assert_array_equal(values, before[1])


@pytest.mark.parametrize("stamps", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan], [0.0, np.inf]])
def test_channels_refuse_stamps_that_do_not_increase(stamps):
    with pytest.raises(
        NonFiniteError, match=r"Expected finite, strictly increasing time stamps.*clean_channel"
    ):
        channel(stamps)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("make", [Channel, clean_channel])
def test_channels_refuse_unequal_lengths(make):
    with pytest.raises(ShapeError, match=r"Expected one stamp for each value of channel 'velocity_z'"):
        make("velocity_z", np.arange(3.0), np.arange(4.0), "m/s")


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
    assert channel([]).gaps() == []
    assert channel([1.0]).gaps() == []
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


def test_missing_channels_say_what_was_looked_for():
    log = ev.Recording("a.ulg", "ulog", {}, looked_for={"velocity_z": ("vehicle_local_position.vz",)})
    with pytest.raises(
        MissingChannelError, match=r"Expected the channel 'velocity_z' in a\.ulg.*position\.vz"
    ):
        log.channel("velocity_z")
    with pytest.raises(MissingChannelError, match="no source of it is known"):
        log.channel("input")
    assert log.span_s == (0.0, 0.0)


@given(st.tuples(*[st.floats(-5.0, 15.0)] * 2))
def test_windows_are_cut_to_the_span_or_refused(window):
    span = (0.0, 10.0)
    start, end = max(window[0], 0.0), min(window[1], 10.0)
    if window[0] < window[1] and start < end:
        assert interval_within(window, span) == (start, end)
    else:
        with pytest.raises(UsageError, match="Expected a window START:END inside the log"):
            interval_within(window, span)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_signals_refuse_rates_that_are_none(rate):
    with pytest.raises(NonFiniteError, match=r"Expected a positive rate in Hz; received rate_hz="):
        ev.Signals(rate, {"input": np.zeros(3)})


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    "build",
    [
        lambda: ev.Signals(1.0, {}),
        lambda: ev.Signals(1.0, {"input": np.zeros(3), "velocity_z": np.zeros(4)}),
        lambda: ev.Signals(1.0, {"input": np.zeros(3)}, valid=np.ones(2, dtype=bool)),
    ],
)
def test_signals_refuse_shapes_that_do_not_fit(build):
    with pytest.raises(ShapeError, match="Expected at least one channel"):
        build()


def test_signals_refuse_values_that_are_not_finite_where_they_count():
    values = np.array([0.0, np.nan, 1.0, np.inf])
    with pytest.raises(NonFiniteError, match=r"'input' at every valid sample; received 2 .* sample 1"):
        ev.Signals(1.0, {"input": values})
    with pytest.raises(NonFiniteError, match=r"received 1 .* sample 3"):
        ev.Signals(1.0, {"input": values}, valid=np.array([True, False, True, True]))
    ev.Signals(1.0, {"input": values}, valid=np.array([True, False, True, False]))
    with pytest.raises(
        MissingChannelError, match="Expected a channel called 'speed'; received channels input"
    ):
        ev.Signals(1.0, {"input": np.zeros(2)}).channel("speed")


def test_a_record_without_a_mask_is_one_run_unless_it_is_too_short():
    signals = ev.Signals(2.0, {"input": np.zeros(5)})
    assert signals.runs() == [slice(0, 5)]
    assert signals.runs(2.5) == [slice(0, 5)]
    assert signals.runs(2.6) == []


def test_errors_survive_other_processes_and_copies():
    error = MissingChannelError("the channel 'a'", "a log without it", "Log it.")
    for again in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error)):  # noqa: S301 - our own bytes
        assert isinstance(again, MissingChannelError)
        assert str(again) == "Expected the channel 'a'; received a log without it. Log it."
        assert (again.expected, again.received, again.remedy) == (
            error.expected,
            error.received,
            error.remedy,
        )
    assert issubclass(MissingChannelError, EivorError)


def test_noise_of_a_channel_that_is_not_there_is_refused():
    with pytest.raises(UsageError, match="noise of the channels input; received noise of 'inptu'"):
        ev.Signals(5.0, {"input": np.zeros(4)}, noise={"inptu": ev.WhiteNoise(0.1)})


def erring(step_s, error_s, seconds=40.0):
    """Even times, and stamps of them that err."""
    even = np.arange(0.0, seconds, step_s)
    return even, even + error_s * np.random.default_rng(5).standard_normal(even.size)


def test_it_is_said():
    even, stamps = erring(0.004, 0.004)
    channel = clean_channel("velocity_z", stamps, np.sin(even), "m/s")
    (findings,) = channel_findings({"velocity_z": channel})
    assert findings.name == "time_stamps"
    assert "evened: velocity_z 10000" in findings.message


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
    assert family_members(name, among) == expected
