"""Input maps: inverse, slope and name each give back what the map says."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

import eivor as ev
from eivor.errors import ChannelMapError, UsageError
from eivor.flights.grid import upward
from eivor.signals import channels
from eivor.signals.channels import (
    CanonicalChannel,
    canonical_channel,
    canonical_channels,
    declare_channels,
    held_by_default,
    unit_of,
)
from eivor.signals.recording import Frame
from eivor.signals.thrust_map import Mixed, Power, input_map

THROTTLE = CanonicalChannel("throttle", "", held=True, free_unit=True)
SPEED = CanonicalChannel("forward_speed", "m/s")
SIDEWAYS = CanonicalChannel("sideways_speed", "m/s", flipped=True)
CURRENT = CanonicalChannel("motor_current_*", "A")


@pytest.fixture
def table(monkeypatch):
    """The table of channels, which is as it was after the test."""
    monkeypatch.setattr(channels, "_TABLE", dict(canonical_channels()))


@pytest.fixture
def declared(table):
    declare_channels(THROTTLE, SPEED, SIDEWAYS, CURRENT)


def test_rotors_have_numbers():
    assert canonical_channel("rotor_command_12") == canonical_channels()["rotor_command_*"]
    for name in ("rotor_command_*", "rotor_command_", "rotor_command_01", "rotor_command_1234", "speed", ""):
        assert canonical_channel(name) is None
        assert not held_by_default(name)
    assert (unit_of("rotor_speed_3"), unit_of("velocity_z")) == ("", "m/s")
    assert (held_by_default("landed"), held_by_default("velocity_z")) == (True, False)
    with pytest.raises(UsageError, match=r"name of a canonical channel; received 'speed'.*velocity_z"):
        unit_of("speed")


def test_declared_channels_in_maps(declared, tmp_path):
    pl.DataFrame({"t": [0.0, 1.0], "v": [36.0, 72.0], "i": [1.0, 2.0], "pwm": [9, 9]}).write_csv(
        tmp_path / "t.csv"
    )
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
    before = dict(canonical_channels())
    declare_channels(SPEED, SPEED, canonical_channels()["velocity_z"])
    assert dict(canonical_channels()) == before


@pytest.mark.parametrize(
    "other",
    [
        CanonicalChannel("forward_speed", "km/h"),
        CanonicalChannel("forward_speed", "m/s", held=True),
        CanonicalChannel("velocity_z", "m/s"),
        CanonicalChannel("rotor_speed_1", "rad/s"),
        CanonicalChannel("motor_current_7", "A"),
    ],
)
def test_another_channel_of_a_name_that_is_taken(declared, other):
    before = dict(canonical_channels())
    with pytest.raises(UsageError, match=r"declared once, or the same each time.*Rename one"):
        declare_channels(CanonicalChannel("steering", "rad"), other)
    assert dict(canonical_channels()) == before


def test_a_family_beside_one_of_its_members(table):
    declare_channels(CanonicalChannel("wheel_1", "rad/s"))
    with pytest.raises(UsageError, match="wheel_1"):
        declare_channels(CanonicalChannel("wheel_*", "rad/s"))
    with pytest.raises(UsageError, match="declared once"):
        declare_channels(CanonicalChannel("track_1", ""), CanonicalChannel("track_*", ""))


@pytest.mark.parametrize("name", ["", "Speed", "time", "a b", "a-b", "*"])
def test_names_that_cannot_be(name):
    with pytest.raises(UsageError, match="small letters, digits"):
        CanonicalChannel(name, "")


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


@pytest.mark.parametrize(
    "name", ["", "cubic", "square:2", "power", "power:", "power:0", "mixed", "mixed:1.01"]
)
def test_names_of_no_map_are_refused(name):
    with pytest.raises(UsageError, match=r"Expected an? .*; received"):
        input_map(name)
