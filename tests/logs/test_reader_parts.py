"""Parts of readers: kept channels, delays, expressions of maps, messages beside a peer's, written files."""

from __future__ import annotations

import mmap
import sys
import tracemalloc
from dataclasses import replace

import h5py
import numpy as np
import pytest
from dataflash_writer import KINDS, DataflashWriter, flight_log, simulated
from scipy.io import savemat
from scipy.signal import butter, group_delay, iirnotch

import eivor as ev
from eivor.errors import (
    ChannelMapError,
    EivorError,
    EmptyLogError,
    LogTooLargeError,
    MissingReaderError,
    UsageError,
)
from eivor.flights.grid import upward
from eivor.logs import common, log_format, logging_advice
from eivor.logs.channel_map import parse_channel_map, parse_expression
from eivor.logs.common import KeptChannels
from eivor.logs.crazyflie.reader import SOURCES, TO_LOG
from eivor.logs.dataflash import channels, messages, sources
from eivor.logs.dataflash import messages as places_of_messages
from eivor.logs.dataflash.messages import Messages, find_offsets, read_layouts
from eivor.logs.table import columnar
from eivor.logs.table.columnar import write_recording
from eivor.logs.ulog.channels import are_pulses, as_shares, attitude_setpoints, motor_outputs, topic_delays
from eivor.logs.ulog.topics import Topic
from eivor.motions.vertical.select import INPUTS
from eivor.signals.channels import CurveSide, canonical_channel, held_by_default, unit_of
from eivor.signals.recording import Channel, DataSheet
from logs.test_table import COLUMNS


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
    log = ev.Recording("long", "dataflash", channels.finished(), ev.Frame.NED)
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
    whole = ev.read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    made = ev.read_log(path)
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
    whole = ev.read_log(path)
    monkeypatch.setattr(KeptChannels, "__init__", limited(KeptChannels.__init__, 2000))
    return whole, ev.read_log(path)


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
    ev.read_log(path)
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
    monkeypatch.setattr(columnar, "decode_in_child", lambda *_, **__: None)


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
    plain = ev.read_log(write(tmp_path / "a.dat", kind, flight, tree=False))
    assert plain.format == kind
    for name, channel in flight.channels.items():
        np.testing.assert_array_equal(plain.channels[name].values, channel.values, err_msg=name)
    (tmp_path / "rig.toml").write_text(MAP)
    mapped = ev.read_log(
        write(tmp_path / "b.dat", kind, flight, tree=True), channel_map=tmp_path / "rig.toml"
    )
    assert len(mapped.channels) == 5
    for name, channel in mapped.channels.items():
        sign = -1.0 if name.endswith("_z") else 1.0
        np.testing.assert_array_equal(sign * channel.values, flight.channels[name].values, err_msg=name)


def test_variables_of_several_lengths_are_told(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"time": np.arange(50.0), "velocity_z": np.arange(60.0)})
    with pytest.raises(ChannelMapError, match=r"'velocity_z' 60|'time' 50.*'velocity_z' 60"):
        ev.read_log(tmp_path / "a.mat")


def test_files_of_nothing_that_is_read(whole, tmp_path):
    savemat(tmp_path / "a.mat", {"name": "flight", "cells": np.array([[1], "a"], dtype=object)})
    with pytest.raises(EmptyLogError, match=r"objects \(timeseries, tables\) are not read"):
        ev.read_log(tmp_path / "a.mat")


def test_variables_without_a_space_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = file["velocity_z"] = np.arange(50.0)
        file["input"] = h5py.Empty("f8")
        file.create_dataset("rows", (50,), dtype=h5py.vlen_dtype("f8"))
    assert set(ev.read_log(tmp_path / "a.h5").channels) == {"velocity_z"}


def test_a_variable_that_says_far_more_than_the_file_holds(whole, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("time", (1 << 36,), "f8", chunks=(1 << 20,))
        file["velocity_z"] = np.arange(50.0)
    with pytest.raises(LogTooLargeError, match="repeats itself"):
        ev.read_log(tmp_path / "a.h5")


def test_without_h5py_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingReaderError, match=r"pip install 'eivor\[hdf5\]'"):
        ev.read_log(tmp_path / "a.h5")


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
            ev.read_log(tmp_path / "b.dat")
        except EivorError:
            refused += 1
    assert refused >= count // 2


COUNT = 8
TIME = np.arange(COUNT, dtype=np.float64)


def quaternion(roll, pitch, yaw):
    """Z, then y, then x."""
    (cr, cp, cy), (sr, sp, sy) = (f(0.5 * np.array([roll, pitch, yaw])) for f in (np.cos, np.sin))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def log(states=(), **attitude):
    rates = {name: np.full(COUNT, value) for name, value in (("roll", 1.0), ("pitch", 2.0), ("yaw", 3.0))}
    topics = {
        "vehicle_attitude_setpoint": Topic("vehicle_attitude_setpoint", 0, attitude),
        "vehicle_rates_setpoint": Topic("vehicle_rates_setpoint", 0, rates),
    }
    clocks = dict.fromkeys(topics, TIME)
    if len(states):
        topics["vehicle_status"] = Topic("vehicle_status", 0, {"nav_state": np.array(states)})
        clocks["vehicle_status"] = TIME[: len(states)] * 2.0
    return topics, clocks


def made(topics, clocks):
    return {name: values for name, _, values, _ in attitude_setpoints(topics, clocks)}


def of(angles):
    parts = np.stack([quaternion(*angle) for angle in angles], axis=1)
    return {f"q_d[{index}]": part for index, part in enumerate(parts)}


def test_quaternions_become_angles_and_yaw_has_no_jumps():
    angles = [(0.1 * k, -0.05 * k, 2.5 + 0.2 * k) for k in range(COUNT)]
    result = made(*log((15, 15, 15, 15), **of(angles)))
    for number, name in enumerate(("roll", "pitch", "yaw")):
        np.testing.assert_allclose(
            result[f"reference_{name}"], [angle[number] for angle in angles], atol=1e-12
        )
        assert np.isnan(result[f"feedback_reference_{name}"]).all()


def test_they_are_told_apart_by_the_mode_in_force():
    # from second 0 stabilized, from 2 position, from 4 acro, from 6 altitude
    result = made(*log((15, 2, 10, 1), **of([(0.3, 0.2, 0.1)] * COUNT)))
    by_sticks = np.isfinite(result["reference_roll"])
    np.testing.assert_array_equal(by_sticks, [True, True, False, False, False, False, True, True])
    np.testing.assert_array_equal(np.isfinite(result["feedback_reference_roll"]), ~by_sticks)
    np.testing.assert_array_equal(
        np.isfinite(result["reference_angular_rate_y"]), [*[False] * 4, True, True, *[False] * 2]
    )
    assert result["reference_angular_rate_y"][4] == 2.0


def test_without_a_mode_a_loop_made_them():
    result = made(*log(**of([(0.3, 0.2, 0.1)] * COUNT)))
    assert np.isnan(result["reference_roll"]).all()
    assert np.isfinite(result["feedback_reference_roll"]).all()
    assert np.isnan(result["reference_angular_rate_x"]).all()


def test_old_logs_hold_angles():
    angles = {
        f"{name}_body": np.full(COUNT, value) for name, value in (("roll", 0.1), ("pitch", 0.2), ("yaw", 0.3))
    }
    never = {f"q_d[{index}]": np.zeros(COUNT) for index in range(4)}
    result = made(*log((0, 0, 0, 0), **angles, **never))
    assert result["reference_pitch"] == pytest.approx(np.full(COUNT, 0.2))


def test_a_setpoint_of_neither_kind_makes_no_channel():
    assert [item for item in made(*log((15,))) if "angular" not in item] == []


def test_every_source_and_every_advice_names_a_channel():
    names = {rule.name for source in SOURCES for rule in source.rules}
    assert all(canonical_channel(name) is not None for name in names | (set(TO_LOG)))
    assert set(TO_LOG) <= names
    assert log_format("crazyflie").takes_map
    assert logging_advice("crazyflie", "battery_voltage") == ("Add pm.vbat to config.txt on the card.",)
    assert logging_advice("crazyflie", "pilot_throttle") == ()
    assert "stateEstimate.z, .vz" in logging_advice("crazyflie")[0]


def test_advice_names_the_bits():
    assert "LOG_BITMASK" in logging_advice("dataflash")[0]
    assert "IMU_FAST" in logging_advice("dataflash", "specific_force_body_z")[0]
    assert logging_advice("dataflash", "nonsense") == ()


def all_messages(path):
    """All messages of a log, by name."""
    with path.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    layouts, _ = read_layouts(content)
    data = np.frombuffer(content, dtype=np.uint8)
    positions = find_offsets(data, layouts, layouts)
    return {layout.name: Messages(layout, data, positions.of(number)) for number, layout in layouts.items()}


def peers_messages(path):
    """All messages of a log as pymavlink reads them, by name."""
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(str(path))
    results = {}
    while (message := log.recv_msg()) is not None:
        results.setdefault(message.get_type(), []).append(message)
    log.filehandle.close()
    return results


def assert_alike(path):
    """Compare all messages; return how many there are."""
    ours, theirs = all_messages(path), peers_messages(path)
    assert {name: our.count for name, our in ours.items() if our.count} == {
        name: len(sent) for name, sent in theirs.items()
    }
    for name, sent in theirs.items():
        for column, field in ours[name].layout.fields.items():
            selected = [getattr(message, column) for message in sent]
            if field.kind.kind == "S":
                assert ours[name].texts(column) == selected, (name, column)
            else:
                values = ours[name].stored(column) if field.kind.subdtype else ours[name].values(column)
                np.testing.assert_allclose(values, selected, rtol=1e-15, err_msg=f"{name}.{column}")
    return sum(map(len, theirs.values()))


def test_every_code_of_a_field(tmp_path):
    rng = np.random.default_rng(0)
    writer = DataflashWriter()
    numbers = {code: rng.integers(-100, 100, size=20) for code in "bhiqcefdgL"}
    numbers |= {code: rng.integers(0, 100, size=20) for code in "BHIQCEM"}
    assert {*numbers, *"nNZa"} == {*KINDS}
    for n, (code, values) in enumerate(numbers.items()):
        writer.add(f"T{n}", np.arange(20.0), code, X=values)
    for code in "nNZ":
        writer.add(f"S{code}", np.arange(20.0), code, X=b"abc")
    writer.add("SA", np.arange(20.0), "a", X=rng.integers(-30000, 30000, size=(20, 32)))
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.bytes())
    assert assert_alike(path) == 20 * 21 + 22


@pytest.mark.thorough
def test_a_real_log(recordings):
    assert assert_alike(recordings / "ardupilot" / "log_0036_mechanical_failure.bin") > 46_000


RATE_HZ = 4000.0


def topic(name, **fields):
    stamps = (1_000_000 + 4000 * np.arange(50)).astype(np.uint64)
    return Topic(name, 0, {"timestamp": stamps, **fields})


def seconds(name, parameters=None, **fields):
    return sum(seconds for seconds, _ in topic_delays(topic(name, **fields), parameters or {}))


def late_at_one_hertz(b, a):
    return float(group_delay((b, a), w=[1.0], fs=RATE_HZ)[1][0]) / RATE_HZ


def test_low_passes_are_late_by_their_group_delay():
    expected = late_at_one_hertz(*butter(2, 30.0, fs=RATE_HZ))
    assert seconds("vehicle_acceleration", {"IMU_ACCEL_CUTOFF": 30.0}) == pytest.approx(expected, rel=0.01)
    assert seconds("vehicle_angular_velocity", {"IMU_GYRO_CUTOFF": 30.0}) == pytest.approx(expected, rel=0.01)
    # the one's parameter says nothing of the other, and zero turns a filter off
    assert seconds("vehicle_acceleration", {"IMU_GYRO_CUTOFF": 30.0, "IMU_ACCEL_CUTOFF": 0.0}) == 0.0


@pytest.mark.parametrize("name", ["IMU_GYRO_NF0", "IMU_GYRO_NF1", "IMU_GYRO_NF"])
def test_notches_are_late_by_their_group_delay(name):
    frequency = f"{name}_FREQ" if name.endswith("NF") else f"{name}_FRQ"
    result = seconds("vehicle_angular_velocity", {frequency: 80.0, f"{name}_BW": 20.0})
    assert result == pytest.approx(late_at_one_hertz(*iirnotch(80.0, 80.0 / 20.0, fs=RATE_HZ)), rel=0.02)


@pytest.mark.parametrize("length", [np.full(50, 5000, dtype=np.uint32), np.full(50, 0.005)])
def test_a_mean_is_late_by_half_of_its_interval(length):
    cutoff = {"IMU_ACCEL_CUTOFF": 30.0}
    assert seconds("sensor_combined", cutoff, accelerometer_integral_dt=length) == pytest.approx(0.0025)


def test_what_says_when_it_was_sampled_is_late_by_the_way_to_its_stamp():
    stamps = topic("x").fields["timestamp"]
    assert seconds("vehicle_local_position", timestamp_sample=stamps - np.uint64(1400)) == pytest.approx(
        0.0014
    )
    # of another clock, or in the future: not known
    assert seconds("vehicle_local_position", timestamp_sample=stamps - np.uint64(900_000)) == 0.0
    assert seconds("vehicle_local_position", timestamp_sample=stamps + np.uint64(5000)) == 0.0
    # a setpoint is in force from when it is published
    assert seconds("vehicle_thrust_setpoint", timestamp_sample=stamps - np.uint64(1400)) == 0.0


RISING = np.linspace(1100.0, 1900.0, 5)


def test_what_is_no_pulse_width_stays():
    assert are_pulses([RISING, 0.0 * RISING], {})
    assert not are_pulses([RISING / 2000.0], {})
    assert not are_pulses([RISING - 900.0], {})
    assert not are_pulses([], {})
    assert not are_pulses([RISING], {"PWM_MAIN_TIM0": -3.0})
    assert not are_pulses([RISING], {"DSHOT_CONFIG": 600.0})
    assert are_pulses([RISING], {"PWM_MAIN_TIM0": 400.0, "DSHOT_CONFIG": 0.0})


def test_outputs_are_told_by_their_motors():
    functions = {"PWM_AUX_FUNC1": 102.0, "PWM_AUX_FUNC2": 101.0, "PWM_AUX_FUNC3": 201.0}
    assert motor_outputs([0, 1, 2], functions) == ("PWM_AUX", {1: 1, 0: 2})
    assert motor_outputs([0, 2], {}) == ("PWM_MAIN", {0: 1, 2: 2})


def test_a_range_that_no_parameter_tells_is_said():
    values, finding = as_shares({0: RISING}, {})
    assert values[0] is RISING
    assert finding.name == "pulse_range_unknown"
    assert "no parameter gives their range (PWM_MAIN_MIN1 and PWM_MAIN_MAX1" in finding.message


def test_shares_of_outputs_are_the_last_choice_of_an_input():
    assert (INPUTS[-1].name, INPUTS[-1].measured) == ("actuator_output", False)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + b * 2", 8.0),
        ("-(a - b)", 1.0),
        ("- - a", 2.0),
        ("a - -b", 5.0),
        ("a / b", 2.0 / 3.0),
        ("1/2*a", 1.0),
        ("pow(a, 3) + sqrt(b+1)", 10.0),
        ("greatest(a, b) - least(a, b)", 1.0),
        ("ABS(a - 4.5e0)", 2.5),
        ("atan2(a, a)", np.pi / 4),
        ("exp(ln(a)) + .5", 2.5),
        ('"select" + a', 6.0),
        ("select + a", 6.0),
        ("sin + a", 7.0),
        ("cos(a*a + 2) - sin(b)", np.cos(6) - np.sin(3)),
        ("asin(a/4)+acos(a/4)+atan(0*a)+tan(0*a)", np.pi / 2),
        ("1e300 * a / 1e300", 2.0),
        ("a * 2.5e-7 / 2.5e-7", 2.0),
        ("a * 123456789012345678 / 123456789012345678", 2.0),
        ("-a**2 + b**-1 * 3 + tanh(0*a) + hypot(b, 2*a)", 2.0),
        ("(a < b and not a >= b) + (a > b or a <= 2) * 10", 11.0),
        ("ddt(a*b) + lag(a, .1)", 2.0),
    ],
)
def test_expressions(text, value):
    columns = {"a": np.full(3, 2.0), "b": np.full(3, 3.0), "select": np.full(3, 4.0), "sin": np.full(3, 5.0)}
    for time in (0.1, np.array([0.0, 0.1, 0.4])):
        np.testing.assert_allclose(parse_expression(text, "here").evaluate(columns, time), value)


def test_a_missing_value_stays_missing():
    columns = {"a": np.array([np.nan, 2.0]), "b": np.array([1.0, 1.0])}
    for text in ("greatest(a, b)", "least(a, b)", "a + b", "b / a", "atan2(a, b)", "a < b", "not a"):
        assert np.isnan(parse_expression(text, "here").evaluate(columns)).tolist() == [True, False]


#: Texts that are no arithmetic over columns.
REFUSED = [
    "", "1 + 2", "sum(a)", "mean(a)", "count(*)", "a FROM b", "a; drop table b", "read_csv('x')",
    "'text'", "a -- b\n c", "/* a */ a", "a b", "a +", "(a", "a)", "abs a", "abs(a, b)", "pow(a)",
    "CAST(a AS int)", "CASE WHEN a THEN b END", "0 < a < b", "a = b", "a % b", "*", "a.b", '"a\x00"',
    '"unclosed', "1e999 * a", "1a", 'abs(' * 40 + 'a' + ')' * 40, '(' * 400 + 'a' + ')' * 400,
    '-' * 999 + '#', "a # b", "'a'", 'f"{a}"', "9**9**9 * a", "(a := 2)", "[a]", "lambda: a",
    "1j * a", '0x' + 'f' * 900 + ' * a', 'a + ' * 400 + 'a', "row_number() over (order by a)",
    "a OVER b", "a == b", "a**b", "a**9**9", "ddt(a, 1)", "lag(a, a)", "lag(a, -1)", "a if b else a",
]  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_refused_expressions(text):
    with pytest.raises(ChannelMapError, match=r"arithmetic over columns.*at here"):
        parse_expression(text, "here")


NOISY = """
name = "noisy"
[time]
column = "t"
[channels.velocity_z]
column = "vz"
unit = "cm/s"
{keys}
"""


@pytest.mark.parametrize(
    ("keys", "noise"),
    [
        ("noise = 2.0", pytest.approx(0.02)),
        ("noise_density = 1.0\nnoise_bandwidth_hz = 50.0", DataSheet(0.01, 50.0)),
        ("quantisation = 10", DataSheet(step=0.1)),
        ("", None),
    ],
)
def test_a_map_states_the_noise_of_a_channel(keys, noise):
    (rule,) = parse_channel_map(NOISY.format(keys=keys), "noisy.toml").rules
    assert rule.noise == noise


@pytest.mark.parametrize("keys", ["noise = -1.0", "noise = 1.0\nquantisation = 1.0", "quantisation = -1.0"])
def test_a_map_whose_noise_is_none(keys):
    with pytest.raises(ChannelMapError, match="velocity_z"):
        parse_channel_map(NOISY.format(keys=keys), "noisy.toml")


def same(first, other):
    for name in ("frame", "input_map", "parameters"):
        assert getattr(first, name) == getattr(other, name)
    assert list(first.channels) == list(other.channels)
    for name, channel in first.channels.items():
        twin = other.channels[name]
        np.testing.assert_array_equal(channel.time_s, twin.time_s)
        np.testing.assert_array_equal(channel.values, twin.values)
        for part in ("unit", "held", "source", "quality", "estimated"):
            assert getattr(channel, part) == getattr(twin, part)


def test_parquet_reads_back_the_same(tmp_path):
    r = ev.recording_from_columns(
        COLUMNS, frame=ev.Frame.NED, input_map="square", parameters={"a": 0.1}, estimated=("velocity_z",)
    )
    assert [name for name, channel in r.channels.items() if channel.estimated] == ["velocity_z"]
    write_recording(r, tmp_path / "r.parquet")
    back = ev.read_log(tmp_path / "r.parquet")
    assert back.name == "r.parquet"
    same(r, back)
    write_recording(back, tmp_path / "again.parquet")
    assert ev.read_log(tmp_path / "again.parquet").sha256 == back.sha256


def test_delays_and_sides_of_the_thrust_curve_are_kept(tmp_path):
    r = ev.recording_from_columns(COLUMNS)
    late = {name: replace(channel, delay_s=0.004) for name, channel in r.channels.items()}
    behind = {"input": replace(r.channels["input"], curve_side=CurveSide.BEHIND)}
    for changed, field, said in (
        (late, "delay_s", "the delay of"),
        (behind, "curve_side", "the curve_side of"),
    ):
        log = replace(r, channels={**r.channels, **changed})
        write_recording(log, tmp_path / "r.parquet")
        same(log, ev.read_log(tmp_path / "r.parquet"))
        back = ev.read_log(tmp_path / "r.parquet").channels
        assert all(getattr(back[name], field) == getattr(item, field) for name, item in changed.items())
        with pytest.raises(UsageError, match=said):
            write_recording(log, tmp_path / "r.csv")


def test_what_cannot_be_written(tmp_path):
    down = ev.recording_from_columns(COLUMNS, frame=ev.Frame.NED, input_map="square")
    landed = Channel("landed", np.array([0.5, 1.5]), np.array([0.0, np.nan]), "")
    channels = {"input": Channel("input", np.arange(2.0), np.zeros(2), ""), "landed": landed}
    stamped = ev.Recording(name="r", format="", channels=channels)
    without = replace(stamped, channels=channels | {"landed": replace(landed, values=np.zeros(2))})
    for recording, name, said in (
        (down, "r.csv", r"z down.*input map 'square'"),
        (ev.recording_from_columns(COLUMNS, estimated=("velocity_z",)), "r.csv", "estimator made velocity_z"),
        (ev.recording_from_columns(COLUMNS), "r.txt", "ends in"),
        (stamped, "r.parquet", r"all stamps of 'landed'.*NaN among them"),
        (without, "r.csv", "the stamps of input and others"),
        (replace(stamped, channels={}), "r.parquet", "a recording with channels"),
    ):
        with pytest.raises(UsageError, match=said):
            write_recording(recording, tmp_path / name)
    with pytest.raises(UsageError, match=r"channels out of time, .*received 'vz'"):
        ev.recording_from_columns(COLUMNS, estimated=("vz",))


def test_channels_of_several_clocks_read_back_the_same(tmp_path):
    quick, slow = np.arange(0.0, 2.0, 0.01), np.arange(0.003, 2.0, 0.02)
    channels = {
        name: Channel(name, time, np.sin(time), unit_of(name), source="x", held=held_by_default(name))
        for name, time in (("velocity_z", quick), ("input", slow), ("position_z", quick))
    }
    r = ev.Recording(name="r", format="simulation", channels=channels)
    write_recording(r, tmp_path / "r.parquet")
    same(r, ev.read_log(tmp_path / "r.parquet"))
