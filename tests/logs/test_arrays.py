from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from eivor.errors import DataError, EmptyLogError, ShapeError, UsageError
from eivor.logs import read_log, recording_from_columns, write_recording
from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.recording import Channel, Frame, Recording

T = np.linspace(0.0, 2.0, 201)
COLUMNS = {
    "time": T,
    "velocity_z": np.sin(T) / 3,
    "input": np.where(T < 1, np.nan, 0.1),
    "rotor_command_2": T**2,
}


@pytest.mark.parametrize("make", [dict, pl.DataFrame, lambda c: {k: list(v) for k, v in c.items()}])
def test_from_columns(make):
    r = recording_from_columns(
        make(COLUMNS), name="sim", frame=Frame.NED, input_map="square", parameters={"mass": 1.0}
    )
    assert (r.name, r.format, r.frame, r.input_map, r.parameters) == (
        "sim",
        "frame",
        Frame.NED,
        "square",
        {"mass": 1.0},
    )
    np.testing.assert_array_equal(r.channels["input"].values, COLUMNS["input"])
    assert r.channels["input"].held
    assert r.sha256 == ""


@pytest.mark.parametrize(
    ("columns", "error", "words"),
    [
        ({"velocity_z": [1.0]}, UsageError, "a column 'time'"),
        ({"time": [1.0]}, UsageError, "at least one channel"),
        ({"time": [1.0], "velocity_zz": [1.0]}, UsageError, "Did you mean 'velocity_z'"),
        ({"time": [1.0], 3: [1.0]}, UsageError, "canonical names"),
        ({"time": [1.0, 2.0], "velocity_z": [1.0]}, ShapeError, "length of 'time', 2"),
        ({"time": [1.0, 2.0], "velocity_z": [[1.0], [1.0]]}, ShapeError, "shape"),
        ({"time": [1.0, 2.0], "velocity_z": ["a", "b"]}, DataError, "numbers in column 'velocity_z'"),
        ({"time": [], "velocity_z": []}, EmptyLogError, "length 0"),
        ({"time": [1.0], "velocity_z": [np.nan]}, EmptyLogError, "empty"),
    ],
)
def test_wrong_columns(columns, error, words):
    with pytest.raises(error, match=words):
        recording_from_columns(columns)


def same(first, other):
    assert (first.frame, first.input_map, first.parameters) == (
        other.frame,
        other.input_map,
        other.parameters,
    )
    assert list(first.channels) == list(other.channels)
    for name, channel in first.channels.items():
        twin = other.channels[name]
        np.testing.assert_array_equal(channel.time_s, twin.time_s)
        np.testing.assert_array_equal(channel.values, twin.values)
        assert (channel.unit, channel.held, channel.source, channel.quality, channel.estimated) == (
            twin.unit,
            twin.held,
            twin.source,
            twin.quality,
            twin.estimated,
        )


def test_parquet_reads_back_the_same(tmp_path):
    r = recording_from_columns(
        COLUMNS, frame=Frame.NED, input_map="square", parameters={"a": 0.1}, estimated=("velocity_z",)
    )
    assert [name for name, channel in r.channels.items() if channel.estimated] == ["velocity_z"]
    write_recording(r, tmp_path / "r.parquet")
    back = read_log(tmp_path / "r.parquet")
    assert back.name == "r.parquet"
    same(r, back)
    write_recording(back, tmp_path / "again.parquet")
    assert read_log(tmp_path / "again.parquet").sha256 == back.sha256


def test_delays_of_sensors_are_kept(tmp_path):
    r = recording_from_columns(COLUMNS)
    late = replace(
        r, channels={name: replace(channel, delay_s=0.004) for name, channel in r.channels.items()}
    )
    write_recording(late, tmp_path / "r.parquet")
    assert {channel.delay_s for channel in read_log(tmp_path / "r.parquet").channels.values()} == {0.004}
    with pytest.raises(UsageError, match="the delay of"):
        write_recording(late, tmp_path / "r.csv")


def test_csv_reads_back_the_same(tmp_path):
    r = recording_from_columns(COLUMNS)
    write_recording(r, tmp_path / "r.csv")
    same(r, read_log(tmp_path / "r.csv"))


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(UsageError, match=r"z down.*input map 'square'"):
        write_recording(
            recording_from_columns(COLUMNS, frame=Frame.NED, input_map="square"), tmp_path / "r.csv"
        )
    with pytest.raises(UsageError, match="that an estimator made velocity_z"):
        write_recording(recording_from_columns(COLUMNS, estimated=("velocity_z",)), tmp_path / "r.csv")
    with pytest.raises(UsageError, match=r"channels out of time, .*received 'vz'"):
        recording_from_columns(COLUMNS, estimated=("vz",))
    with pytest.raises(UsageError, match="ends in"):
        write_recording(recording_from_columns(COLUMNS), tmp_path / "r.txt")
    channel = Channel("landed", np.array([0.5, 1.5]), np.array([0.0, np.nan]), "")
    recording = Recording(
        name="r",
        format="",
        channels={"input": Channel("input", np.arange(2.0), np.zeros(2), ""), "landed": channel},
    )
    with pytest.raises(UsageError, match=r"all stamps of 'landed'.*NaN among them"):
        write_recording(recording, tmp_path / "r.parquet")
    with pytest.raises(UsageError, match="the stamps of input and others"):
        write_recording(
            replace(
                recording,
                channels=dict(recording.channels) | {"landed": replace(channel, values=np.zeros(2))},
            ),
            tmp_path / "r.csv",
        )
    with pytest.raises(UsageError, match="a recording with channels"):
        write_recording(replace(recording, channels={}), tmp_path / "r.parquet")


def test_channels_of_several_clocks_read_back_the_same(tmp_path):
    quick, slow = np.arange(0.0, 2.0, 0.01), np.arange(0.003, 2.0, 0.02)
    channels = {
        name: Channel(name, time, np.sin(time), unit_of(name), source="x", held=held_by_default(name))
        for name, time in (("velocity_z", quick), ("input", slow), ("position_z", quick))
    }
    r = Recording(name="r", format="simulation", channels=channels)
    write_recording(r, tmp_path / "r.parquet")
    same(r, read_log(tmp_path / "r.parquet"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "metadata",
    [
        "{",
        "[]",
        "{}",
        '{"frame": "UP"}',
        "[" * 100000,
        '{"frame": "NED", "input_map": 3, "parameters": {}, "channels": {}}',
        '{"frame": "NED", "input_map": "", "parameters": {"a": "x"}, "channels": {}}',
        '{"frame": "NED", "input_map": "", "parameters": {}, "channels": {"input": 3}}',
        '{"frame": "NED", "input_map": "", "parameters": {}, "channels": {"input": {"held": 3}}}',
        '{"frame": "NED", "input_map": "", "parameters": {}, "channels": {"input": {"overflowed": -1}}}',
    ],
)
def test_strange_metadata_is_left_out(tmp_path, metadata):
    pl.DataFrame(COLUMNS).write_parquet(tmp_path / "r.parquet", metadata={"eivor": metadata})
    r = read_log(tmp_path / "r.parquet")
    assert r.frame is Frame.Z_UP
    assert "metadata" in [f.name for f in r.findings]
