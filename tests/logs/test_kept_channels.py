"""Channels that do not fit into memory together, and what a long DataFlash log takes of it."""

import tracemalloc

import numpy as np
import pytest
from dataflash_writer import flight_log, simulated

from eivor.flights.frames import upward
from eivor.logs import findings, read_log
from eivor.logs.dataflash import messages, reading, turning
from eivor.logs.dataflash import places as places_of_messages
from eivor.logs.kept_channels import KeptChannels
from eivor.signals.recording import Channel, Frame, Recording


def channel(name, count=100, clock=None):
    time = np.arange(float(count)) if clock is None else clock
    return Channel(name, time, np.ones(count), "")


def test_as_many_as_fit_are_kept():
    channels, made = KeptChannels(2500), []
    clock = np.arange(100.0)
    for name in ("velocity_z", "position_z", "input"):  # 1600 bytes, and 800 for each that shares the clock
        channels.put(channel(name, clock=clock), lambda name=name: made.append(name) or channel(name))
    assert list(channels) == ["velocity_z", "position_z", "input"]
    assert channels["velocity_z"] is channels["velocity_z"]
    assert made == []
    assert channels["input"] is not channels["input"]
    assert made == ["input", "input"]
    assert channels.settled() is channels
    channels.put(channel("input", count=1), lambda: channel("input"))
    assert isinstance(channels.settled(), dict)
    assert list(channels.settled()) == ["velocity_z", "position_z", "input"]
    with pytest.raises(KeyError):
        channels["landed"]


def test_what_is_not_kept_is_made_only_when_it_is_asked_for():
    channels, made = KeptChannels(0), []
    for name in ("position_z", "velocity_z"):
        channels.put(channel(name), lambda name=name: made.append(name) or channel(name))
    log = Recording("long", "dataflash", channels.settled(), Frame.NED)
    risen = upward(log)
    assert "velocity_z" in log.channels
    assert "velocity_z" in risen.channels
    assert "landed" not in risen.channels
    assert list(risen.channels) == list(log.channels)
    assert len(risen.channels) == 2
    assert "velocity_z" not in made  # the checks of annotations look at the first of a mapping
    np.testing.assert_array_equal(risen.channels["velocity_z"].values, -log.channels["velocity_z"].values)
    assert made.count("velocity_z") == 2


def test_sizes_of_long_channels_are_told_of_some_of_their_values(monkeypatch):
    monkeypatch.setattr(findings, "ENOUGH", 10)
    channels = {f"specific_force_body_{axis}": channel(f"specific_force_body_{axis}") for axis in "xyz"}
    (told,) = findings.channel_findings(channels)
    assert "has a median of 1.73 m/s^2, where about 9.8 is expected" in told.message
    assert findings.look(channels["specific_force_body_x"]).values.size == 10


@pytest.mark.parametrize("dialect", ["3.4", "4.6"])
def test_a_log_that_does_not_fit_is_the_same(tmp_path, monkeypatch, dialect):
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=2.0), dialect).bytes())
    whole = read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    made = read_log(path)
    assert isinstance(whole.channels, dict)
    assert isinstance(made.channels, KeptChannels)
    assert made.findings == whole.findings
    assert list(made.channels) == list(whole.channels)
    for name, one in whole.channels.items():
        np.testing.assert_array_equal(made.channels[name].time_s, one.time_s)
        np.testing.assert_array_equal(made.channels[name].values, one.values)
        assert made.channels[name].quality == one.quality


def limited(begin, limit):
    """The beginning of channels of which less is kept."""
    return lambda self: begin(self, limit)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_memory_of_a_long_log(tmp_path, monkeypatch):
    """What is kept, and some arrays of one channel: less than a third of a log that is all needed."""
    path, writer = tmp_path / "flight.bin", flight_log(simulated(seed=3, duration=60.0), "4.6")
    once = np.frombuffer(b"".join(message for _, message in writer.messages), dtype=np.uint8)
    places = 3 + np.cumsum([0, *(len(message) for _, message in writer.messages)])[:-1]
    ticks = once[places[:, None] + np.arange(8)].copy().view("<u8")[:, 0]
    with path.open("wb") as log:
        log.write(writer.head)
        for copy in range(5):
            again = once.copy()
            again[places[:, None] + np.arange(8)] = (ticks + copy * 70_000_000)[:, None].view(np.uint8)
            log.write(again.tobytes())
    whole = peak_of(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 0))
    monkeypatch.setattr(messages, "LONG_FILE_BYTES", 0)
    monkeypatch.setattr(messages, "COPIED_ROWS", 1000)
    monkeypatch.setattr(turning, "PASSED_ROWS", 1000)
    monkeypatch.setattr(findings, "ENOUGH", 1000)
    monkeypatch.setattr(reading, "LONG_BYTES", 0)
    monkeypatch.setattr(places_of_messages, "BLOCK", 1 << 16)
    size = path.stat().st_size
    assert peak_of(path) < size / 3 < whole


def peak_of(path):
    """Most memory that reading takes [bytes]."""
    tracemalloc.start()
    read_log(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak
