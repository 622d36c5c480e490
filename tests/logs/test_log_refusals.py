"""Logs, maps and columns that are refused: each with the reason and the remedy."""

from __future__ import annotations

import codecs
import gzip
import json
import os
import re
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import polars as pl
import pytest
import test_damage as damage
import test_table as tables
from bag_writer import blank, header, stores, write_ros2
from blackbox_writer import blackbox_log
from dataflash_writer import DataflashWriter
from scipy.io import savemat
from test_bags import MAP, mapped, rig
from test_blackbox import ONE_BYTE, walks
from test_channel_map import HEAD, PWM, read, telemetry, write_table
from test_crazyflie import head
from test_read import COLUMNS
from test_reader_parts import layout
from ulog_writer import UlogWriter, flight, message
from usd_writer import flight as crazyflie_flight

import eivor as ev
from eivor.errors import (
    ChannelMapError,
    CorruptLogError,
    DataError,
    EmptyLogError,
    InputError,
    LogTooLargeError,
    MissingChannelError,
    MissingReaderError,
    ShapeError,
    UnknownFormatError,
    UsageError,
)
from eivor.logs.rosbag.messages import UnsoundMessageError
from eivor.logs.table.columnar import write_recording
from eivor.signals.recording import Channel
from refusal_rows import calls, rows, table, without


def of_content(content, tmp_path, name="flight.log", **options):
    content = content.bytes() if hasattr(content, "bytes") else content
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return ev.read_log(tmp_path / name, **options)


def of_blackbox(old, new, tmp_path):
    content, changes = re.subn(old, new, blackbox_log(walks(3), fields=ONE_BYTE), count=1, flags=re.DOTALL)
    assert changes == 1
    of_content(content, tmp_path)


BLACKBOX = rows("blackbox", None, of_blackbox,
    (b"Field I signed:0,", b"Field I signed:", CorruptLogError, "numbers for"),
    (b"I encoding:1,", b"I encoding:5,", CorruptLogError, "not known"),
    (b"I predictor:0,0", b"I predictor:0,2", CorruptLogError, "not known"),
    (rb",motor\[0\],", b",motor[7],", CorruptLogError, "not known"),
    (b".*", b"H Product:Blackbox flight data recorder\n", CorruptLogError, "what its frames hold"),
    (b"I\x00.*", b"", EmptyLogError, "without a whole frame"),
    (b"E\xff.*", b"P" * 400_000, CorruptLogError, "numbers a byte"),
)  # fmt: skip


def of_map(text, tmp_path):
    write_table(tmp_path)
    read(tmp_path, text)


#: Texts that are no arithmetic over columns.
NO_ARITHMETIC = [
    " ", "1 + 2", "sum(a)", "mean(a)", "count(*)", "a FROM b", "a; drop table b", "read_csv('x')",
    "'text'", "a -- b\n c", "/* a */ a", "a b", "a +", "(a", "a)", "abs a", "abs(a, b)", "pow(a)",
    "CAST(a AS int)", "CASE WHEN a THEN b END", "0 < a < b", "a = b", "a % b", "*", "a.b", '"a\x00"',
    '"unclosed', "1e999 * a", "1a", 'abs(' * 40 + 'a' + ')' * 40, '(' * 400 + 'a' + ')' * 400,
    '-' * 999 + '#', "a # b", "'a'", 'f"{a}"', "9**9**9 * a", "(a := 2)", "[a]", "lambda: a",
    "1j * a", '0x' + 'f' * 900 + ' * a', 'a + ' * 400 + 'a', "row_number() over (order by a)",
    "a OVER b", "a == b", "a**b", "a**9**9", "ddt(a, 1)", "lag(a, a)", "lag(a, -1)", "a if b else a",
]  # fmt: skip
VELOCITY = '[channels.velocity_z]\ncolumn = "v down"\nunit = "cm/s"\n'
MAPS = rows("map", ChannelMapError, of_map,
    (HEAD + PWM + "delay_ms = 1001\n", "between -1000 and 1000 at channels.input.delay_ms .*1001"),
    (HEAD + PWM + "delay_ms = nan\n", "at channels.input.delay_ms"),
    (HEAD + PWM + 'delay_ms = "8"\n', "at channels.input.delay_ms"),
    (HEAD + PWM + 'curve_side = "after"\n', "before.*behind.* at channels.input.curve_side"),
    ('source = "filter"\n' + HEAD + PWM, "sensor.*estimator.*at source of m.toml"),
    (HEAD + PWM + "source = 1\n", "at channels.input.source of m.toml"),
    ("name = ", "a channel map in TOML"),
    ("[" * 5000, "a channel map in TOML"),
    ('[time]\ncolumn = "t"\n[channels.input]\ncolumn = "pwm"\n',
        "a text in quotes at name of m.toml; received nothing"),
    (HEAD, "at least one channel at channels of m.toml; received none"),
    (HEAD + "[channels]\n", "at least one channel"),
    (HEAD + '[channels.pace]\ncolumn = "pwm"\n', "canonical channel name .*at channels.pace of m.toml"),
    (HEAD + PWM + "colour = 1\n", "unknown key 'colour'"),
    (HEAD + '[channels.velocity_z]\nroll_pitch = ["roll", "pitch"]\n', "for cos_tilt only"),
    (HEAD + '[channels.input]\nexpression = "pwn * 2"\n', "key channels.input.*Did you mean 'pwm'"),
    (HEAD + '[columns.pwn]\nvalid=[0,1]\n[channels.input]\ncolumn = "pwm"\n', "key columns.pwn"),
    (HEAD + '[columns]\npwm=3\n[channels.input]\ncolumn = "pwm"\n', "a table .* at columns.pwm of m.toml"),
    (HEAD.replace('"t"', '"tt"') + PWM, "key time.column"),
    (HEAD + '[channels.input]\ncolumn = "t"\n',
        "time column that no channel is made of.*received 't' as both"),
    (HEAD + '[channels.input]\ncolumn = "absent"\noptional = true\n', "at least one channel of m.toml"),
    (HEAD + PWM + "scale = 1e300\n", "1e-30 to 1e\\+30 in size"),
    (HEAD + f'[columns.pwm]\nvalid=[0,{"9" * 400}]\n[channels.input]\ncolumn = "pwm"\n', "64 bits"),
    ('input_map = "sqare"\n' + HEAD + PWM, "at input_map of m.toml.*'sqare'"),
    ('input_map = "power:-1"\n' + HEAD + PWM, "positive exponent .*at input_map"),
    ('input_map = "mixed:2"\n' + HEAD + PWM, "between 0 and 1 at input_map"),
    (HEAD + VELOCITY + "noise = -1.0\n", "velocity_z"),
    (HEAD + VELOCITY + "noise = 1.0\nquantisation = 1.0\n", "velocity_z"),
    (HEAD + VELOCITY + "quantisation = -1.0\n", "velocity_z"),
    *(
        (
            f"{HEAD}[channels.input]\nexpression = {json.dumps(text)}\n",
            "arithmetic over columns.*at channels.input",
        )
        for text in NO_ARITHMETIC
    ),
)  # fmt: skip


def by_map(name, content, tmp_path):
    """The map is no file, or one of some content."""
    write_table(tmp_path)
    if content is not None:
        (tmp_path / name).write_bytes(content)
        name = tmp_path / name
    ev.read_log(tmp_path / "t.csv", channel_map=tmp_path if name == "." else name)


FILES_OF_MAPS = rows("file of a map", ChannelMapError, by_map,
    ("nanobensch", None, "nanobench, rotorpy.*is no file"),
    (".", None, "unreadable"),
    ("x" * 5000, None, "is no file"),
    ("a\x00b", None, "is no file"),
    ("big.toml", b"#" * (2 << 20), "larger than"),
    ("latin.toml", b"\xff", "unreadable"),
    ("rotorpy", None, "a column 't'|a column"),
)  # fmt: skip


def of_bag_map(old, new, tmp_path):
    assert old in MAP
    mapped(rig(tmp_path), tmp_path, MAP.replace(old, new))


def of_crazyflie_map(rule, tmp_path):
    text = f'name = "m"\n[time]\ncolumn = "timestamp"\n[channels.velocity_z]\n{rule}\n'
    (tmp_path / "m.toml").write_text(text)
    of_content(crazyflie_flight(), tmp_path, channel_map=tmp_path / "m.toml")


MAP_OF_A_BAG = rows("map of a bag", ChannelMapError, of_bag_map,
    ('column = "stamp"', 'column = "t"', "the clock of a bag, 'stamp'.*received 't'"),
    ("/motors.", "/motor.", "a topic '/motor'.*'/motors'.*Did you mean '/motors'"),
    ("angular_velocities[1]", "angular_velocities[7]", r"Did you mean.*angular_velocities\[1\]"),
    (".point.z\" / 2'", ".header.frame_id\" / 2'", "column|field"),
    (".point.z\" / 2'", '.point.z" / "/motors.normalized"\'', "columns of one topic"),
)  # fmt: skip
MAP_OF_A_CRAZYFLIE = rows("map of a crazyflie", ChannelMapError, of_crazyflie_map,
    ('column = "acc.y"', "a column 'acc.y'.*Did you mean 'acc.z'"),
    ('expression = \'"acc.z" - "pm.vbat"\'', "one type of events for .*velocity_z.*no type of 'flight"),
)  # fmt: skip
CRAZYFLIE = rows("crazyflie", None, of_content,
    (head(2), CorruptLogError, "ends in its head"),
    (head(7, 1), CorruptLogError, "version 1 or 2.*version 7.*newer"),
    (head(2, 65535) + bytes(90), CorruptLogError, "65535 types"),
    (head(2, 1, 5, b"e\x00", 65535), CorruptLogError, "65535 variables"),
    (head(2, 1, 5, b"e\x00", 9, b"acc.x(f)\x00"), CorruptLogError, "ends in its head"),
    (head(2, 1, 5, b"e\x00", 1, b"acc.x(z)\x00"), CorruptLogError, r"'acc.x\(z\)', whose type is not"),
    (head(2, 2, 5, b"e\x00", 0, 5, b"f\x00", 0), CorruptLogError, "same id"),
    (head(2, 1, 5, b"e\x00", 1, b"acc.x(f)\x00"), EmptyLogError, "a whole record.*types of events: 1"),
    (head(2, 1, 5, b"e\x00", 1, b"odd(B)\x00", 5, bytes(9)), EmptyLogError, "with 'odd'.*channel map"),
    (head(2, 0) + crazyflie_flight(2).bytes()[5:], EmptyLogError, ""),  # which announces no types
)  # fmt: skip
TELEMETRY = rows("telemetry", MissingReaderError, of_content,
    (telemetry(), "telemetry log.*the vehicle's card: .bin of ArduPilot, .ulg of PX4"),
    (telemetry(magic=0xFE), "telemetry log"),
    (bytes(16) + b"BUILD" + bytes(300), "DJI.*no commands"),
    (bytes(242) + b"DJI_LOG_V3" + bytes(300), "DJI"),
    ((500).to_bytes(8, "little") + b"\x90\x01\x0e" + bytes(1000), "flight record of DJI"),
)  # fmt: skip
CONTENT = rows("content", None, partial(of_content, name="misleading.csv"),
    (gzip.compress(b"time,velocity_z\n0,1\n", mtime=0), MissingReaderError, "gzip archive.*Unpack"),
    (b"PK\x03\x04" + bytes(100), MissingReaderError, "zip archive"),
    *((item, UnknownFormatError, "content is that of none of them")
        for item in (b"hello world\n", b"\x00" * 100, bytes(range(256)), b"\n\n\n")),
    (b"", EmptyLogError, "0 bytes"),
)  # fmt: skip
ENCODINGS = rows("encoding", UnknownFormatError, partial(of_content, name="t.csv"),
    (codecs.BOM_UTF16_LE + "time,vz\n0,1\n".encode("utf-16-le"),
        "in UTF-8; received 't.csv', .*a table in UTF-16.*-f UTF-16 "),
    (codecs.BOM_UTF16_BE + "time;vz\n0;1\n".encode("utf-16-be"),
        "in UTF-8; received 't.csv', .*a table in UTF-16"),
    ("time,vz,høj\n0,1,2\n".encode("utf-16-le"), "in UTF-8; received 't.csv', .*a table in UTF-16"),
    ("time\tvz\n0\t1\n".encode("utf-16-be"), "in UTF-8; received 't.csv', .*a table in UTF-16"),
    ("time,vz\n0,1\n".encode("utf-32"), "in UTF-8; received 't.csv', .*a table in UTF-32.*-f UTF-32 "),
    ("time,temp°C\n0,20\n".encode("latin-1"),
        "in UTF-8; received 't.csv', .*letters that are not UTF-8.*-f WINDOWS-1252 -t UTF-8"),
    ("time;größe\r\n0;1\r\n".encode("cp1252"), "in UTF-8; received 't.csv', .*letters that are not UTF-8"),
)  # fmt: skip
CSV = rows("csv", None, partial(of_content, name="t.csv"),
    ("time,velocity_z\n", EmptyLogError, "header only"),
    ("0,1\n0.1,2\n", UnknownFormatError, "numbers only"),
    ("time,velocity_z\n0,1\n1\n2,3\n", CorruptLogError, "line 3 has 1 fields where the header has 2"),
    (b"time,velocity_z\n0,1\n\x00\x00\n", CorruptLogError, "NUL bytes in line 3"),
    ("time,velocity_z\n0,a\n1,b\n", EmptyLogError, "every mapped column is empty"),
    ("time,velocity_z\na,0\nb,1\n", EmptyLogError, "'time', in which it holds no number|holds no number"),
    ("velocity_z,speed\n0,1\n", ChannelMapError, "canonical column names"),
    ("time,velocity_z,velocity_z\n0,1,2\n", ChannelMapError, "two columns called 'velocity_z'"),
    (",".join(f"c{i}" for i in range(5000)) + "\n1\n", CorruptLogError, "5000 columns"),
    ("time,velocity_z\n0," + "1" * (2 << 20) + "\n", CorruptLogError, "longer than"),
    ('time,velocity_z,n\n0,1,"a"\n1,2,b" c\n', CorruptLogError, "line 3 has a quote inside a cell"),
    ('time,velocity_z,n\n0,1,"a\n1,2,b\n2,3,c\n', CorruptLogError, "line 2 opens a quote that is not clo"),
    (b"time,velocity_z\n" + b"0,1\n" * 20000 + b"\xff\xfe,2\n", CorruptLogError, "UTF-8"),
)  # fmt: skip


def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    ev.read_log(tmp_path / "pipe")


def sparse(tmp_path):
    with (tmp_path / "huge.ulg").open("wb") as stream:
        stream.truncate(5 << 30)
    ev.read_log(tmp_path / "huge.ulg")


def cut_parquet(tmp_path):
    pl.DataFrame({"time": [0.0, 1.0], "velocity_z": [0.0, 1.0]}).write_parquet(tmp_path / "t.parquet")
    of_content((tmp_path / "t.parquet").read_bytes()[:-10], tmp_path, "t.parquet")


def empty_parquet(tmp_path):
    pl.DataFrame({"time": [], "velocity_z": []}).write_parquet(tmp_path / "t.parquet")
    ev.read_log(tmp_path / "t.parquet")


def matlab(tmp_path, **variables):
    savemat(tmp_path / "t.mat", variables)
    ev.read_log(tmp_path / "t.mat")


def more_than_it_holds(file):
    file.create_dataset("time", (1 << 36,), "f8", chunks=(1 << 20,))
    file["velocity_z"] = np.arange(50.0)


def of_messages(messages, tmp_path, kind="", **values):
    """A bag of one message, or of none."""
    store = stores()[1]
    made = [(topic, kind, 0.0, store.types[kind](**(blank(store, kind) | values))) for topic in messages]
    ev.read_log(write_ros2(tmp_path / "flight", made, store))


def wind_bag(tmp_path):
    stamp = header(stores()[1], 0.0)
    of_messages(["/wind"], tmp_path, kind="geometry_msgs/msg/Vector3Stamped", header=stamp)


def vtol(tmp_path):
    fields = {"vehicle_type": np.repeat([1, 2, 1], 10), "nav_state": np.full(30, 2)}
    fields = {f"{name}__uint8_t": values for name, values in fields.items()}
    log = UlogWriter().topic("vehicle_status", 0.1 * np.arange(30.0), **fields)
    ev.identify_flight(of_content(log, tmp_path))


def unknown_flags(tmp_path):
    log = flight()
    log.definitions = message("B", bytes(8) + b"\x02" + bytes(31)) + log.definitions[43:]
    of_content(log, tmp_path)


def list_map(old, new, tmp_path):
    path = tables.written(tmp_path / "t.csv", ["[1, 2, 3]"] * tables.ROWS)
    (tmp_path / "m.toml").write_text(tables.MAP.replace(old, new))
    ev.read_log(path, channel_map=tmp_path / "m.toml")


def of_parquet(patches, tmp_path, monkeypatch):
    """The child dies as a decoder does that asks for too much memory; this process goes on."""
    damage.canonical().write_parquet(tmp_path / "t.parquet")
    for name, value in patches.items():
        monkeypatch.setattr(f"eivor.logs.{name}", value)
    ev.read_log(tmp_path / "t.parquet")


def of_hdf5(write, tmp_path):
    with h5py.File(tmp_path / "t.h5", "w") as file:
        write(file)
    ev.read_log(tmp_path / "t.h5")


def nested(file):
    for _ in range(20):
        file = file.create_group("g")


def in_one_chunk(file):
    for name in ("time", "velocity_z"):
        sizes = {"maxshape": (None,), "chunks": (12_000_000,)}
        file.create_dataset(name, data=np.arange(9.0), compression="gzip", **sizes)


def of_database(statements, sound, tmp_path):
    (tmp_path / "flight.db3").write_bytes(sound["db3"])
    with closing(sqlite3.connect(tmp_path / "flight.db3")) as database:
        database.executescript(statements)
    ev.read_log(tmp_path / "flight.db3")


def of_other_schemas(sound, tmp_path):
    of_content(sound["mcap"].replace(b"ros2msg", b"jsonsch"), tmp_path, "flight.mcap")


def without_descriptions(tmp_path):
    content, number = damage.writer().bytes(), damage.writer().numbers["XKF1"]
    of_content(content[content.index(b"\xa3\x95" + bytes([number])) :], tmp_path)


def of_no_text(tmp_path):
    of_content("time,velocity_z\n0,1\n1,2\n", tmp_path, os.fsdecode(b"\xff\xfe.csv"))


LENGTHS = r"'velocity_z' 60|'time' 50.*'velocity_z' 60"
UNSTAMPED = r"/imu without a stamp that can be, .*: 1\. Write a channel map"
OUT_OF = r"channels out of time, .*received 'vz'"
ANY_NAMES = "only with logs whose columns have any names"
DATAFLASH = DataflashWriter().text("ArduCopter V4.6.2").parameters(SYSID=1.0)
WIND = UlogWriter().topic("wind", [0.0, 1.0], windspeed_north=np.zeros(2))
CELLS = np.array([[1], "a"], dtype=object)
FILES = calls("file", None,
    (sparse, LogTooLargeError, "at most 1073741824 bytes"),
    (partial(of_content, "time,velocity_z\n0,1\n", max_bytes=5), LogTooLargeError, ""),
    (lambda tmp_path: ev.read_log(tmp_path / "nothing.ulg"), InputError, "does not exist"),
    (lambda tmp_path: ev.read_log(tmp_path.parent), InputError, "a directory"),
    (lambda: ev.read_log("a\x00b"), InputError, "can be opened|null"),
    (pipe, InputError, "not a regular file"),
    (lambda: ev.read_log("x" * 5000), InputError, "that can be opened"),
    *(
        (lambda path=path: ev.read_log(path), UsageError, "a path, as a text or a Path")
        for path in (3, None, b"log.csv", ["log.csv"])
    ),
    (empty_parquet, EmptyLogError, "without one"),
    (cut_parquet, CorruptLogError, "Parquet file that cannot be decoded"),
    (partial(matlab, time=np.arange(50.0), velocity_z=np.arange(60.0)), ChannelMapError, LENGTHS),
    (partial(matlab, name="flight", cells=CELLS), EmptyLogError,
        r"objects \(timeseries, tables\) are not read"),
    (partial(of_hdf5, more_than_it_holds), LogTooLargeError, "repeats itself"),
    (partial(of_messages, []), EmptyLogError, r"with no messages\. Nothing was recorded"),
    (partial(of_messages, ["/imu"], kind="sensor_msgs/msg/Imu"), EmptyLogError, UNSTAMPED),
    (wind_bag, EmptyLogError, r"/wind \(geometry_msgs/Vector3Stamped\).*TOPIC.FIELD"),
    (vtol, InputError, r"START:END\. The vehicle is on its rotors in 0:1, 2:"),
    (partial(of_content, WIND), EmptyLogError, "a ULog with flight data"),
    (partial(of_content, WIND.bytes()[:12]), CorruptLogError, "header of 16 bytes"),
    (unknown_flags, CorruptLogError, "incompatible flags"),
    (partial(of_content, flight(), channel_map="nanobench"), UsageError, ANY_NAMES),
    (partial(of_content, DATAFLASH), EmptyLogError, "LOG_BITMASK"),
    (lambda: ev.recording_from_columns(tables.COLUMNS, estimated=("vz",)), UsageError, OUT_OF),
    (without_descriptions, EmptyLogError, "where messages are described"),
    (of_no_text, InputError, r"Expected a path in UTF-8; received b'.*\\x[0-9a-f]{2}"),
)  # fmt: skip
PARQUET = rows("parquet", InputError, of_parquet,
    ({"table.columnar._PARQUET_CODE": "import os; os.abort()"}, "makes the decoder fail"),
    ({"table.columnar._PARQUET_CODE": "import time; time.sleep(9)", "table.columnar.PARQUET_TIMEOUT_S": 0.1},
        "not decoded within"),
    ({"table.columnar.MAX_ROWS": 50}, "at most 50 rows"),  # instead of writing half a gigabyte
    ({"common.MAX_CELLS": 50}, "at most 50 numbers.*with 400"),
)  # fmt: skip
MANY = "10000 groups and variables, or 16 in each other"
HDF5 = rows("hdf5", InputError, of_hdf5,
    (nested, MANY),
    (lambda file: [file.create_group(f"g{n}") for n in range(10_010)], MANY),
    (in_one_chunk, "at most 10000000 numbers"),
    marks=pytest.mark.thorough,
)  # fmt: skip
DATABASE = rows("database", (CorruptLogError, EmptyLogError), of_database,
    *((f"DROP TABLE schema; {statement}", "more than plain tables") for statement in (
        "CREATE VIEW schema AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) SELECT x FROM c",
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END",
        "CREATE TABLE more(a INTEGER, b BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))",
    )),
    ("UPDATE message_definitions SET encoded_message_definition = "
        "'float64 x\nfloat64 y \"__import__(''os'').abort()\"\n'", "where its type takes"),
)  # fmt: skip
PACKAGES = calls("package", MissingReaderError,
    (without("rosbags.rosbag1", partial(of_content, b"#ROSBAG V2.0\n")), r"pip install 'eivor\[ros\]'"),
    (without("h5py", partial(of_content, b"\x89HDF\r\n\x1a\n" + bytes(600))), r"pip install 'eivor\[hdf5\]'"),
    (of_other_schemas, r"sensor_msgs/msg/Imu \(jsonsch\).*mcap cat"),
)  # fmt: skip
MAP_OF_LISTS = rows("map of lists", ChannelMapError, list_map,
    ("index = 2", "index = -1", "a place from 0.*index"),
    ("index = 2", "index = 1.5", "a whole number"),
    ('column = "v"\nindex = 2', 'column = "w"\nindex = 2', r"a column 'w\[2\]'.*'v'"),
)  # fmt: skip
COLUMNS_GIVEN = rows("columns", None, ev.recording_from_columns,
    ({"velocity_z": [1.0]}, UsageError, "a column 'time'"),
    ({"time": [1.0], "velocity_zz": [1.0]}, UsageError, "Did you mean 'velocity_z'"),
    ({"time": [1.0, 2.0], "velocity_z": [1.0]}, ShapeError, "length of 'time', 2"),
    ({"time": [1.0, 2.0], "velocity_z": ["a", "b"]}, DataError, "numbers in column 'velocity_z'"),
    ({"time": [], "velocity_z": []}, EmptyLogError, "length 0"),
    ({"time": [1.0], "velocity_z": [np.nan]}, EmptyLogError, "empty"),
)  # fmt: skip
CHANNELS = rows("channel", MissingChannelError,
    lambda columns: ev.identify_flight(ev.recording_from_columns(columns)),
    (COLUMNS | {"velocity_z": np.full(1000, np.nan)}, "velocity_z, which is there and holds no number"),
    ({name: column[::-1] for name, column in COLUMNS.items()},
        r"999 were dropped, because their stamp .* goes backward"),
)  # fmt: skip
OF_BAG = b"\0\1\0\0" + struct.pack("<IIII", 1 << 31, 0, 0, 0)
DEFINITION = rows("definition", UnsoundMessageError, lambda text: layout(OF_BAG, text),
    ("uint8[1000000000] many", "goes on after them"),
    ("string words", "goes on after them"),
    ("B again", "nested too deep"),
    ("C other", "type a/C is not known"),
    ("C[] other\n" + "=" * 80 + "\nMSG: a/C\nuint8[0] nothing\n", "more than 4096 fields"),
    ("uint8 one", "where its type takes 5"),
)  # fmt: skip
LANDED = Channel("landed", np.array([0.5, 1.5]), np.array([0.0, np.nan]), "")
STAMPED_CHANNELS = {"input": Channel("input", np.arange(2.0), np.zeros(2), ""), "landed": LANDED}
STAMPED = ev.Recording(name="r", format="", channels=STAMPED_CHANNELS)
WRITTEN = rows("written", UsageError,
    lambda recording, name, tmp_path: write_recording(recording, tmp_path / name),
    (ev.recording_from_columns(tables.COLUMNS), "r.txt", "ends in"),
    (STAMPED, "r.parquet", r"all stamps of 'landed'.*NaN among them"),
    (replace(STAMPED, channels={}), "r.parquet", "a recording with channels"),
)  # fmt: skip


test_refused = table(
    *(BLACKBOX, MAPS, FILES_OF_MAPS, MAP_OF_A_BAG, MAP_OF_A_CRAZYFLIE, CRAZYFLIE, TELEMETRY, CONTENT),
    *(ENCODINGS, CSV, FILES, PARQUET, HDF5, DATABASE, PACKAGES),
    *(MAP_OF_LISTS, COLUMNS_GIVEN, CHANNELS, DEFINITION, WRITTEN),
)
