"""The table of formats, and a format of somebody else in it."""

import codecs
import struct
from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import CorruptLogError, UnknownFormatError, UsageError
from eivor.logs import log_format, logging_advice, read, read_log, recording_from_columns
from eivor.logs.common import LogFormat, begins_with
from eivor.logs.read import declare_format, log_formats, readable_formats
from eivor.report.flight import logging_advice_for


@pytest.fixture
def table(monkeypatch):
    """The table of formats, which is as it was after the test."""
    monkeypatch.setattr(read, "_DECLARED", {})


# A new format is one file like this part, and one line: declare_format(WHEELS).


def read_wheels(file, options):
    body = file.read_bytes()[4:]
    if len(body) % 16:
        raise CorruptLogError("pairs of doubles", f"'{file.name}' of {len(body)} bytes", "Copy it again.")
    time_s, speed = np.frombuffer(body, dtype="<f8").reshape(-1, 2).T
    recording = recording_from_columns({"time": time_s, "velocity_z": speed}, name=file.name)
    return replace(recording, format=WHEELS.name, sha256=options.sha256)


WHEELS = LogFormat(
    "wheels",
    "Wheels log",
    begins_with(b"WHL1"),
    read_wheels,
    advice=lambda channel: (f"Turn on {channel}.",) if channel else ("Turn on everything.",),
    setpoints="the steering",
)


def test_a_format_from_outside(table, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"WHL1" + struct.pack("<4d", 0.0, 1.0, 0.1, 2.0))
    with pytest.raises(UnknownFormatError, match=r"MCAP, MATLAB, HDF5, CSV"):
        read_log(path)
    declare_format(WHEELS)
    r = read_log(path)
    assert (r.format, len(r.sha256)) == ("wheels", 64)
    assert r.channels["velocity_z"].values.tolist() == [1.0, 2.0]
    assert logging_advice("wheels") == ("Turn on everything.",)
    assert logging_advice_for(r, "input") == ("Turn on input.",)
    with pytest.raises(UsageError, match="a channel map with the Wheels log"):
        read_log(path, channel_map="rotorpy")
    path.write_bytes(b"nothing")
    with pytest.raises(UnknownFormatError, match=r"MCAP, MATLAB, HDF5, Wheels log, CSV"):
        read_log(path)


def test_declared_formats_do_not_take_the_place_of_others(table):
    declare_format(WHEELS)
    declare_format(WHEELS)
    assert [row.name for row in log_formats()].count("wheels") == 1
    for name in ("ulog", "gzip", "wheels"):
        taken = LogFormat(name, "Another", begins_with(b"WHL1"), read_wheels)
        with pytest.raises(UsageError, match=f"name of its own; received '{name}'"):
            declare_format(taken)
    assert [row.name for row in readable_formats()] == [
        "ulog",
        "ulog2csv",
        "parquet",
        "crazyflie",
        "dataflash",
        "ros1",
        "ros2",
        "mcap",
        "matlab",
        "hdf5",
        "wheels",
        "csv",
    ]


def test_names_are_unique_and_looked_up():
    names = [row.name for row in log_formats()]
    assert len(set(names)) == len(names)
    assert all(log_format(row.name) is row for row in log_formats())
    assert log_format("frame") is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (codecs.BOM_UTF16_LE + "time,vz\n0,1\n".encode("utf-16-le"), "a table in UTF-16.*-f UTF-16 "),
        (codecs.BOM_UTF16_BE + "time;vz\n0;1\n".encode("utf-16-be"), "a table in UTF-16"),
        ("time,vz,høj\n0,1,2\n".encode("utf-16-le"), "a table in UTF-16"),
        ("time\tvz\n0\t1\n".encode("utf-16-be"), "a table in UTF-16"),
        ("time,temp°C\n0,20\n".encode("latin-1"), "letters that are not UTF-8.*-f WINDOWS-1252 -t UTF-8"),
        ("time;größe\r\n0;1\r\n".encode("cp1252"), "letters that are not UTF-8"),
    ],
)
def test_tables_in_other_encodings(tmp_path, content, words):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(UnknownFormatError, match=rf"(?s)in UTF-8; received 't.csv', .*{words}"):
        read_log(path)


@pytest.mark.parametrize(
    "content",
    [
        "only words: høj\n".encode("latin-1"),
        codecs.BOM_UTF16_LE + "only words".encode("utf-16-le"),
        b"\xff\xfe",
        b"\xff\xfe\x00",
        b"a,\xe9\x01,b\n",
    ],
)
def test_what_only_resembles_them(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(UnknownFormatError, match="content is that of none of them"):
        read_log(path)
