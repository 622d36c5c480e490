"""Channels that do not fit into memory together, and what a long DataFlash log takes of it."""

from __future__ import annotations

import sys
import tracemalloc

import h5py
import numpy as np
import pytest
from dataflash_writer import flight_log, simulated
from scipy.io import savemat

from eivor.errors import ChannelMapError, EivorError, EmptyLogError, LogTooLargeError, MissingReaderError
from eivor.flights.grid import upward
from eivor.logs import common, read_log
from eivor.logs.common import KeptChannels
from eivor.logs.dataflash import channels, messages, sources
from eivor.logs.dataflash import messages as places_of_messages
from eivor.logs.table import columnar
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
    assert channels.finished() is channels
    channels.put(channel("input", count=1), lambda: channel("input"))
    assert isinstance(channels.finished(), dict)
    assert list(channels.finished()) == ["velocity_z", "position_z", "input"]
    with pytest.raises(KeyError):
        channels["landed"]


def test_what_is_not_kept_is_made_only_when_it_is_asked_for():
    channels, made = KeptChannels(0), []
    for name in ("position_z", "velocity_z"):
        channels.put(channel(name), lambda name=name: made.append(name) or channel(name))
    log = Recording("long", "dataflash", channels.finished(), Frame.NED)
    risen = upward(log)
    assert "velocity_z" in log.channels
    assert "velocity_z" in risen.channels
    assert "landed" not in risen.channels
    assert list(risen.channels) == list(log.channels)
    assert len(risen.channels) == 2
    assert "velocity_z" not in made  # the checks of annotations look at the first of a mapping
    np.testing.assert_array_equal(risen.channels["velocity_z"].values, -log.channels["velocity_z"].values)
    assert made.count("velocity_z") == 2


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
    for name, item in whole.channels.items():
        np.testing.assert_array_equal(made.channels[name].time_s, item.time_s)
        np.testing.assert_array_equal(made.channels[name].values, item.values)
        assert made.channels[name].quality == item.quality


def long_log(tmp_path, monkeypatch, **spec):
    """A log of a flight of half a minute, read whole and as one that does not fit into memory."""
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=30.0, **spec), "4.6").bytes())
    whole = read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    return whole, read_log(path)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_part_of_a_long_log_is_its_samples_and_what_is_in_force(tmp_path, monkeypatch):
    whole, made = long_log(tmp_path, monkeypatch)
    part = made.part(10.0, 12.0)
    assert whole.part(10.0, 12.0) is whole
    assert part.span_s == made.span_s == whole.span_s
    assert list(part.channels) == list(whole.channels)
    for name, item in whole.channels.items():
        cut = part.channels[name]
        inside = (item.time_s >= 10.0) & (item.time_s <= 12.0)
        if name in ("landed", "pilot_in_control", "input_open_loop", "pilot_sets_attitude"):
            np.testing.assert_array_equal(cut.values, item.values)
            continue
        taken = (cut.time_s >= 10.0) & (cut.time_s <= 12.0)
        np.testing.assert_array_equal(cut.time_s[taken], item.time_s[inside])
        assert 9.8 < cut.time_s[0] < 10.0
        assert 12.0 < cut.time_s[-1] < 13.2
        if not name.startswith(("attitude", "feedback_reference_yaw")):  # turns are counted from the first
            np.testing.assert_array_equal(cut.values[taken], item.values[inside])
    thin = made.part(*made.span_s, 0.05)
    assert 20.0 <= thin.channels["input"].rate_hz < 30.0
    assert thin.channels["reference_position_z"].rate_hz == pytest.approx(10.0, rel=0.05)


def limited(begin, limit):
    """The beginning of channels of which less is kept."""
    return lambda self: begin(self, limit)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_memory_of_a_long_log(tmp_path, monkeypatch):
    """What is kept, and some arrays of one channel: less than a third of a log that is all needed."""
    path, writer = tmp_path / "flight.bin", flight_log(simulated(seed=3, duration=60.0), "4.6")
    once = np.frombuffer(b"".join(message for _, message in writer.messages), dtype=np.uint8)
    positions = 3 + np.cumsum([0, *(len(message) for _, message in writer.messages)])[:-1]
    ticks = once[positions[:, None] + np.arange(8)].copy().view("<u8")[:, 0]
    with path.open("wb") as log:
        log.write(writer.head)
        for copy in range(5):
            again = once.copy()
            again[positions[:, None] + np.arange(8)] = (ticks + copy * 70_000_000)[:, None].view(np.uint8)
            log.write(again.tobytes())
    whole = peak_of(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 0))
    monkeypatch.setattr(messages, "LONG_FILE_BYTES", 0)
    monkeypatch.setattr(messages, "COPIED_ROWS", 1000)
    monkeypatch.setattr(channels, "PASSED_ROWS", 1000)
    monkeypatch.setattr(common, "ENOUGH", 1000)
    monkeypatch.setattr(sources, "LONG_BYTES", 0)
    monkeypatch.setattr(places_of_messages, "BLOCK_BYTES", 1 << 16)
    size = path.stat().st_size
    assert peak_of(path) < size / 3 < whole


def peak_of(path):
    """Most memory that reading takes [bytes]."""
    tracemalloc.start()
    read_log(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


MAP = """
name = "rig"
frame = "ned"
input_map = "square"
[time]
column = "log.t"
[channels.velocity_z]
column = "log.v"
index = 2
[channels.rotor_command_1]
column = "log.u"
[channels.specific_force_z]
column = "log.f"
[channels.cos_tilt]
column = "log.tilt"
[channels.reference_position_z]
column = "log.r"
"""


@pytest.fixture
def whole(monkeypatch):
    """The files are whole: no child need decode them first."""
    for module in (columnar, columnar):
        monkeypatch.setattr(module, "decode_in_child", lambda *_, **__: None)


def columns(flight):
    values = {name: channel.values for name, channel in flight.channels.items()}
    return {"time": flight.channels["position_z"].time_s, **values}


def nested(flight):
    """The same, z down, in a structure with a matrix."""
    table = columns(flight)
    down = np.stack([0.0 * table["time"], 0.0 * table["time"], -table["velocity_z"]], 1)
    return {
        "t": table["time"][:, None],
        "v": down,
        "u": table["rotor_command_1"],
        "f": -table["specific_force_z"],
        "tilt": table["cos_tilt"],
        "r": -table["reference_position_z"],
        "note": "a flight",
    }


def matlab_73(path, tree):
    """Write as MATLAB 7.3 does: HDF5 after 512 bytes of text, vectors as rows, letters as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, value in tree.items():
            if isinstance(value, str):
                create_dataset = group.create_dataset(
                    name, data=np.frombuffer(value.encode("utf-16-le"), "<u2")[:, None]
                )
                create_dataset.attrs["MATLAB_class"] = np.bytes_("char")
            else:
                create_dataset = group.create_dataset(
                    name, data=np.atleast_2d(value).T if value.ndim == 1 else value.T
                )
                create_dataset.attrs["MATLAB_class"] = np.bytes_("double")
        file["#refs#/a"] = np.zeros(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(508) + b"\0\0\x02IM"[:4])
    return path


def write(path, kind, flight, *, tree):
    content = nested(flight) if tree else columns(flight)
    if kind == "matlab":
        savemat(path, {"log": content} if tree else content, do_compression=tree)
    elif tree:
        matlab_73(path, content)
    else:
        with h5py.File(path, "w") as file:
            for name, value in content.items():
                file.create_dataset(name, data=value, compression="gzip")
    return path


@pytest.mark.parametrize("kind", ["matlab", "hdf5"])
def test_channels_by_their_names_and_by_a_map(whole, tmp_path, kind):
    flight = simulated(seed=3, duration=2.0)
    plain = read_log(write(tmp_path / "a.dat", kind, flight, tree=False))
    assert plain.format == kind
    for name, channel in flight.channels.items():
        np.testing.assert_array_equal(plain.channels[name].values, channel.values, err_msg=name)
    (tmp_path / "rig.toml").write_text(MAP)
    mapped = read_log(write(tmp_path / "b.dat", kind, flight, tree=True), channel_map=tmp_path / "rig.toml")
    assert len(mapped.channels) == 5
    for name, channel in mapped.channels.items():
        sign = -1.0 if name.endswith("_z") else 1.0
        np.testing.assert_array_equal(sign * channel.values, flight.channels[name].values, err_msg=name)


def test_variables_of_several_lengths_are_told(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"time": np.arange(50.0), "velocity_z": np.arange(60.0)})
    with pytest.raises(ChannelMapError, match=r"'velocity_z' 60|'time' 50.*'velocity_z' 60"):
        read_log(tmp_path / "a.mat")


def test_files_of_nothing_that_is_read(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"name": "flight", "cells": np.array([[1], "a"], dtype=object)})
    with pytest.raises(EmptyLogError, match=r"objects \(timeseries, tables\) are not read"):
        read_log(tmp_path / "a.mat")


def test_variables_without_a_space_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = file["velocity_z"] = np.arange(50.0)
        file["input"] = h5py.Empty("f8")
        file.create_dataset("rows", (50,), dtype=h5py.vlen_dtype("f8"))
    assert set(read_log(tmp_path / "a.h5").channels) == {"velocity_z"}


def test_a_variable_that_says_far_more_than_the_file_holds(whole, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("time", (1 << 36,), "f8", chunks=(1 << 20,))
        file["velocity_z"] = np.arange(50.0)
    with pytest.raises(LogTooLargeError, match="repeats itself"):
        read_log(tmp_path / "a.h5")


def test_without_h5py_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingReaderError, match=r"pip install 'eivor\[hdf5\]'"):
        read_log(tmp_path / "a.h5")


@pytest.mark.parametrize("kind", ["hdf5", pytest.param("matlab", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("count", [1, pytest.param(100, marks=pytest.mark.long)])
def test_damaged_files(tmp_path, kind, count):
    content = write(tmp_path / "a.dat", kind, simulated(seed=3, duration=2.0), tree=True).read_bytes()
    refused = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        data = bytearray(content)
        for integer in rng.integers(128, len(data), size=40).tolist():
            data[integer] = int(rng.integers(256))
        (tmp_path / "b.dat").write_bytes(data[: len(data) // 2] if seed % 2 == 0 else data)
        try:
            read_log(tmp_path / "b.dat")
        except EivorError:
            refused += 1
    assert refused >= count // 2
