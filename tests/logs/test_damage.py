"""Damaged files: every reader answers with a Recording or an `InputError`, in bounded time."""

from __future__ import annotations

import contextlib
import csv
import re
import sqlite3
import struct
import sys
import time
import tracemalloc
from io import BytesIO

import numpy as np
import polars as pl
import pytest
from backports import zstd
from bag_writer import inertial, write_ros1, write_ros2
from damage import damaged, seeds, walks
from dataflash_writer import FIRMWARES, KINDS, DataflashWriter, fmt, told
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lz4 import frame as lz4_frame
from rosbags.rosbag2 import StoragePlugin
from scipy import io as scipy_io
from ulog_writer import flight
from usd_writer import flight as crazyflie_flight

import eivor as ev
from eivor.errors import CorruptLogError, InputError

COLUMNAR = "eivor.logs.table.columnar"
QUICK = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)


def survives(path, blob, limit_s=10.0):
    """Raise unless a file is read or refused within so much time of this processor."""
    path.write_bytes(blob)
    started = time.process_time()
    try:
        recording = ev.read_log(path)
    except InputError as error:
        text = str(error)
    else:
        text = " ".join(finding.message for finding in recording.findings)
        assert isinstance(recording, ev.Recording)
        assert recording.channels
    assert len(text) < 20_000
    assert time.process_time() - started < limit_s


def canonical():
    t = np.arange(100) * 0.01
    return pl.DataFrame({"time": t, "velocity_z": np.sin(t), "input": np.cos(t), "landed": t > 0.5})


#: How many cuts of each kind are tried; the decoder of Parquet is a process of its own.
CUTS = {
    **dict.fromkeys(("csv", "ulg"), 150),
    **dict.fromkeys(("usd1", "usd2"), 300),
    **dict.fromkeys(("bag", "db3", "mcap", "bin", "log"), 60),
    "parquet": 12,
}


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(("name", "cuts"), CUTS.items())
def test_files_cut_anywhere(tmp_path, name, cuts):
    blob = seeds()[name]
    for length in range(0, len(blob), max(1, len(blob) // cuts)):
        survives(tmp_path / f"t.{name}", blob[:length])


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("name", ["csv", "ulg", "usd1", "bbl", "bag", "db3", "mcap", "bin", "log"])
def test_a_few_damaged_files(tmp_path, sound, sound_dataflash, name):
    made = {
        "csv": lambda: canonical().write_csv().encode(),
        "ulg": lambda: flight().bytes(),
        "usd1": lambda: crazyflie_flight(1).bytes(),
        "bbl": walks,
        "bin": lambda: sound_dataflash,
        "log": lambda: writer().lines(),
    }
    blob, rng = made[name]() if name in made else sound[name], np.random.default_rng(9)
    for _ in range(10):
        survives(tmp_path / f"t.{name}", damaged(blob, rng))


#: Beginnings of files, which any bytes follow.
HEADS = {
    "": b"",
    "ulog": b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + bytes(8),
    "csv": b"time,velocity_z\n",
    "quotes": b'time,velocity_z,n\n0,1,2\n"',
    **{f"crazyflie {size}": crazyflie_flight(count=20).bytes()[:size] for size in (1, 6, 8, 21, 61, 151)},
}


@settings(QUICK, max_examples=80)
@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode), st.sampled_from(sorted(HEADS)))
def test_any_bytes_after_a_head(tmp_path, blob, head):
    survives(tmp_path / "file", HEADS[head] + blob)


@settings(QUICK, max_examples=10)
@given(st.binary(max_size=300))
def test_any_bytes_in_a_parquet(tmp_path, blob):
    survives(tmp_path / "p", b"PAR1" + blob + b"PAR1")


NOTES = st.text(alphabet=st.sampled_from("ab1.;,|\t\"\n\r 'é"), max_size=8)


@pytest.mark.thorough
@settings(QUICK, max_examples=150)
@given(st.lists(NOTES, min_size=1, max_size=12), st.sampled_from(",;\t|"), st.sampled_from(["\n", "\r\n"]))
def test_notes_of_any_kind_change_no_number(tmp_path, notes, delimiter, end):
    """A column that holds delimiters, quotes and line breaks, as Python writes it, beside the numbers."""
    with (tmp_path / "t.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, delimiter=delimiter, lineterminator=end)
        table.writerow(["time", "note", "velocity_z"])
        table.writerows([0.5 * row, note, -0.25 * row] for row, note in enumerate(notes))
    z = ev.read_log(tmp_path / "t.csv").channels["velocity_z"]
    np.testing.assert_array_equal(z.time_s, 0.5 * np.arange(len(notes)))
    np.testing.assert_array_equal(z.values, -0.25 * np.arange(len(notes)))


@QUICK
@given(st.text(max_size=200))
def test_any_text_as_a_map(tmp_path, text):
    (tmp_path / "m.toml").write_bytes(b'name = "m"\n[time]\ncolumn = "time"\n' + text.encode())
    (tmp_path / "t.csv").write_text("time,velocity_z\n0,1\n1,2\n")
    with contextlib.suppress(InputError):
        ev.read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # the checks of a million calls take most of the time
@pytest.mark.parametrize("filler", [b"\x00", b"\xff", b"D", b"\x01\x00D"])
def test_long_runs_of_nonsense_take_bounded_time(tmp_path, filler):
    blob = flight().bytes() + filler * (1_000_000 // len(filler))
    survives(tmp_path / "long.ulg", blob, limit_s=5.0)


def test_a_parquet_where_no_decoder_can_be_started(tmp_path, monkeypatch):
    canonical().write_parquet(tmp_path / "t.parquet")
    monkeypatch.setattr(sys, "executable", "")  # embedded: there is no interpreter to start
    assert ev.read_log(tmp_path / "t.parquet").channels


def test_a_parquet_that_repeats_itself_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    rows = 6_000_000
    frame = pl.DataFrame({"time": np.arange(rows) // 1000, "velocity_z": np.ones(rows), "x": np.ones(rows)})
    frame.write_parquet(tmp_path / "t.parquet")
    assert (tmp_path / "t.parquet").stat().st_size < 200_000
    monkeypatch.setattr(f"{COLUMNAR}.decode_in_child", None)
    with pytest.raises(InputError, match=f"at most 10000000 numbers.*with {2 * rows}. Such a file repeats"):
        ev.read_log(tmp_path / "t.parquet")


@pytest.mark.thorough
def test_numbers_of_matlab_have_a_budget_and_cells_are_not_decoded(tmp_path):
    flight = {"time": np.arange(50.0), "velocity_z": np.ones(50)}
    scipy_io.savemat(tmp_path / "t.mat", flight | {"zeros": np.zeros(11_000_000)}, do_compression=True)
    with pytest.raises(InputError, match=r"at most 10000000 numbers.*with 11000100"):
        ev.read_log(tmp_path / "t.mat")
    cells = np.array([[np.zeros(1)] * 100] * 10, dtype=object)
    scipy_io.savemat(tmp_path / "t.mat", flight | {"cells": cells})
    assert ev.read_log(tmp_path / "t.mat").channels["velocity_z"].values.size == 50


def test_max_bytes_bounds_what_content_becomes(read, tmp_path, sound):
    pl.concat([canonical()] * 100).write_parquet(tmp_path / "t.parquet")
    with pytest.raises(InputError, match=r"at most 12500 numbers.*with 40000"):
        ev.read_log(tmp_path / "t.parquet", max_bytes=100_000)
    r = read(sound["mcap"], "flight.mcap", max_bytes=len(sound["mcap"]))
    assert "its messages take more memory than max_bytes" in told(r, "corrupt_parts")


def test_blank_lines_have_a_budget(tmp_path, monkeypatch):
    monkeypatch.setattr("eivor.logs.table.delimited.MAX_BLANK", 100)
    for lines, words in ((100, ""), (101, "line 103 is blank, as 100 before it")):
        (tmp_path / "t.csv").write_text("time,velocity_z\n0,1\n" + "\n" * lines + "1,2\n")
        with pytest.raises(InputError, match=words) if words else contextlib.nullcontext():
            ev.read_log(tmp_path / "t.csv")


@pytest.mark.parametrize("cell", ["1", "-.5e3", "", " 2 ", "true", "NaN", "x", '"3"', "1e400"])
def test_numbers_of_a_table_are_the_same_read_at_once_or_as_texts(tmp_path, cell):
    """A cell that is no number has the whole table read as texts: all other cells keep their numbers."""
    rows = [f"{0.5 * row},{-0.25 * row},{cell if row == 3 else row}" for row in range(9)]
    for name, note in (("numbers", "7"), ("texts", "note")):
        text = "time,velocity_z,input,landed\n" + "".join(f"{row},{note}\n" for row in rows)
        (tmp_path / name).write_text(text)
    one, other = (ev.read_log(tmp_path / name).channels for name in ("numbers", "texts"))
    for name in ("velocity_z", "input"):
        np.testing.assert_array_equal(one[name].values, other[name].values)


@pytest.mark.thorough
def test_only_needed_columns_of_a_parquet_are_decoded(tmp_path):
    """The others are damaged, which nobody notices. Lists, which hold no number, are not decoded either."""
    notes = pl.Series([[b"not to be decoded" * 50, b"x"]] * 100)
    frame = canonical().with_columns(note=notes, position_z=notes.reverse())
    frame.write_parquet(tmp_path / "t.parquet", compression="uncompressed", statistics=False)
    blob = bytearray((tmp_path / "t.parquet").read_bytes())
    starts = [column.start() for column in re.finditer(b"not to be decoded" * 50, blob)]
    assert len(starts) > 1
    for start in starts:
        blob[start - 4 : start] = b"\xff\xff\xff\x7f"
    (tmp_path / "t.parquet").write_bytes(blob)
    with pytest.raises((pl.exceptions.PolarsError, pl.exceptions.PanicException)):
        pl.read_parquet(tmp_path / "t.parquet")
    r = ev.read_log(tmp_path / "t.parquet")
    assert set(r.channels) == {"velocity_z", "input", "landed"}
    assert any(f.name == "unreadable_text" and "'position_z' 100" in f.message for f in r.findings)


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit what a process maps")
def test_the_decoder_has_so_much_memory_and_no_more(tmp_path, monkeypatch):
    rows = 4_000_000
    time_s = np.cumsum(np.random.default_rng(0).random(rows))
    pl.DataFrame({"time": time_s, "velocity_z": time_s}).write_parquet(tmp_path / "t.parquet")
    monkeypatch.setattr(f"{COLUMNAR}.PARQUET_DECODER_BYTES", 32 << 20)
    monkeypatch.setattr(f"{COLUMNAR}.ROW_BYTES", 0)
    with pytest.raises(InputError, match=r"makes the decoder fail .*it may use 32 MiB"):
        ev.read_log(tmp_path / "t.parquet")


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
def test_file_names_of_several_lines(tmp_path):
    canonical().write_parquet(tmp_path / "a\nb.parquet")
    assert ev.read_log(tmp_path / "a\nb.parquet").channels


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("ending", "remedy"), [("bag", "rosbag reindex"), ("mcap", "mcap recover"), ("db3", "-wal")]
)
def test_a_bag_that_is_cut_says_how_it_is_mended(read, sound, ending, remedy):
    assert read(sound[ending], f"flight.{ending}").channels["specific_force_body_y"].values.size == 60
    with pytest.raises(CorruptLogError, match=remedy):
        read(sound[ending][: len(sound[ending]) // 2], f"flight.{ending}")


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_part_that_is_damaged_is_left_out(tmp_path, store, sound):
    folder = write_ros2(tmp_path / "flight", inertial(store["ros2"]), store["ros2"])
    (folder / "flight.db3").rename(folder / "flight_0.db3")
    (folder / "flight_1.db3").write_bytes(b"SQLite format 3\0 and nothing")
    r = ev.read_log(folder)
    assert r.channels["specific_force_body_y"].values.size == 60
    assert "'flight_1.db3'" in told(r, "corrupt_parts")
    (folder / "other.mcap").write_bytes(sound["mcap"])
    with pytest.raises(InputError, match="the files of one bag"):
        ev.read_log(folder)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_messages_that_a_bag_declares_and_does_not_give(tmp_path, store, kind):
    """Messages of another channel, a chunk that says more than it has, rows that are gone: counted."""
    if kind == "bag":
        path = write_ros1(tmp_path / "flight.bag", inertial(store["ros1"]), store["ros1"])
        whole = path.read_bytes()
        index = whole.rindex(struct.pack("<II", 0, 60))  # of the information on the chunk
        path.write_bytes(whole[:index] + struct.pack("<II", 0, 80) + whole[index + 8 :])
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        path = write_ros2(tmp_path / "flight", inertial(store["ros2"]), store["ros2"], plugin)
    if kind == "db3":
        database = sqlite3.connect(path / "flight.db3")
        database.execute("DELETE FROM messages WHERE id > 40")
        database.commit()
        database.close()
        assert "/imu 20 of 60" in told(ev.read_log(path / "flight.db3"), "lost_messages")
    if kind == "mcap":
        content = bytearray((path / "flight.mcap").read_bytes())
        starts = [item.start() for item in re.finditer(rb"\x05.{8}\x01\x00", content, re.DOTALL)]
        for start in starts[:20]:
            content[start + 9] = 7
        (path / "flight.mcap").write_bytes(content)
    r = ev.read_log(path)
    assert f"/imu 20 of {80 if kind == 'bag' else 60}" in told(r, "lost_messages")
    assert r.channels["specific_force_body_y"].values.size == (60 if kind == "bag" else 40)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_one_large_chunk_that_says_nothing_is_refused(read, sound, kind):
    """A chunk of zeros in a thousandth of its size: neither read nor kept in memory."""
    index = sound["mcap"].index(b"\x04\0\0\0zstd") + 8
    bomb = (zstd if kind == "zstd" else lz4_frame).compress(bytes(1 << 27))
    said = struct.pack("<I", len(kind)) + kind.encode()
    start = index - 8 - 28 - 9
    record = struct.pack("<QQQI", 0, 1 << 62, 1 << 27, 0) + said + struct.pack("<Q", len(bomb)) + bomb
    content = BytesIO()
    content.write(sound["mcap"][:start] + b"\x06" + struct.pack("<Q", len(record)) + record)
    content.write(b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + b"\x89MCAP0\r\n")
    tracemalloc.start()
    with pytest.raises(CorruptLogError, match=r"repeats itself|larger than"):
        read(content.getvalue(), "flight.mcap")
    assert tracemalloc.get_traced_memory()[1] < 200 << 20
    tracemalloc.stop()


@pytest.mark.usefixtures("unchecked_shapes")
def test_names_of_files_that_mean_something_in_addresses(tmp_path, sound):
    path = tmp_path / "flight #1?mode=rwc%20.db3"
    path.write_bytes(sound["db3"])
    assert ev.read_log(path).channels["specific_force_body_z"].values.size == 60


def writer(n=60):
    t = np.arange(n) * 0.02
    wave = np.sin(t)
    parameters = DataflashWriter().text(FIRMWARES["4.6"]).parameters(MOT_PWM_MIN=1000.0, MOT_PWM_MAX=2000.0)
    parameters.add("MODE", 0.0, "MB", Mode=3, ModeNum=3).add("EV", [0.0, 0.1], "B", Id=[10, 28])
    parameters.add("XKF1", t, "Bfff", C=0, VN=wave, VD=wave, PD=wave)
    parameters.add("RATE", t, "ff", R=wave, AOut=0.5 + 0.1 * wave)
    parameters.add("IMU", t, "Bfff", I=0, AccX=0.0, AccY=0.0, AccZ=-9.8 + wave)
    parameters.add("ATT", t, "ccC", Roll=wave, Pitch=wave, Yaw=10.0)
    parameters.add("RCOU", t[::5], "HHHH", C1=1500, C2=1500, C3=1500, C4=1500)
    return parameters.add("PSCD", t[::5], "ff", DPD=wave[::5], DVD=wave[::5])


@pytest.fixture(scope="module")
def sound_dataflash():
    return writer().bytes()


def test_layouts_that_cannot_be(read, sound_dataflash):
    index = sound_dataflash.index(b"XKF1") - 5
    assert "left out: 1" in told(
        read(sound_dataflash[: index + 4] + b"\0" + sound_dataflash[index + 5 :]), "message_formats"
    )
    names = sound_dataflash.index(b"C,VN,VD")
    r = read(sound_dataflash[:names] + b"C,VN;VD" + sound_dataflash[names + 7 :])
    assert "disagree: XKF1" in told(r, "message_formats")
    assert "velocity_z" not in r.channels
    assert r.channels["input"].values.size == 60


def test_bytes_that_look_like_a_layout_by_chance_are_no_damage(read):
    item = writer()
    position = next(n for n, pair in enumerate(item.messages) if pair[1][2] == item.numbers["IMU"]) + 20
    time, row = item.messages[position]
    item.messages[position] = (time, row[:-4] + b"\xa3\x95\x80\x41")
    r = read(item.bytes())
    assert not told(r, "message_formats")
    assert r.channels["specific_force_body_z"].values.size == 60


@pytest.mark.parametrize("before", [b"\0" * 512, b"\x80FMT\0BBnNZ", b""])
def test_a_log_whose_beginning_is_lost(read, sound_dataflash, before):
    lost = read(before + sound_dataflash[37:])
    whole = read(sound_dataflash)
    assert list(lost.channels) == list(whole.channels)
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(lost.channels[name].values, channel.values, err_msg=name)
    assert f"left out: {len(before) + 52} bytes" in told(lost, "corrupt_parts")


@pytest.mark.parametrize(
    ("name", "codes", "changed"),
    [
        ("PARM", "QNf", (1, "Zaf", 2, "an")),
        ("IMU", "QBfff", (1, "nZa", 4, "nZa")),
        ("XKF1", "QBfff", (0, "naZ", 1, "naZ", 3, "naZ")),
        ("ATT", "QccC", (0, "na", 1, "na", 3, "na")),
        ("MODE", "QMB", (0, "na", 2, "na")),
        ("RCOU", "QHHHH", (0, "na", 1, "na")),
        ("MSG", "QZ", (0, "na", 1, "fa")),
    ],
)
def test_texts_and_lists_where_numbers_belong(read, name, codes, changed):
    for item, others in zip(changed[::2], changed[1::2], strict=True):
        for code in others:
            if code == codes[item]:
                continue
            entry = writer()
            columns = entry.columns[name]
            made = codes[:item] + code + codes[item + 1 :]
            length = 3 + sum(np.dtype(KINDS[each]).itemsize for each in made)
            number = entry.numbers[name]
            index = entry.head.index(name.encode().ljust(4, b"\0"), 89) - 5
            entry.head = (
                entry.head[:index]
                + fmt(number, length, name, made, ",".join(columns))
                + entry.head[index + 89 :]
            )
            entry.messages = [
                (time, row[:3] + (row[3:] + b"\x31" * length)[: length - 3] if row[2] == number else row)
                for time, row in entry.messages
            ]
            r = read(entry.bytes())
            if not (code == "Z" and name == "PARM"):
                assert f"{name}.{columns[item]}" in told(r, "message_formats"), (name, item, code)


def test_a_layout_is_said_again(read):
    item = writer()
    number = item.numbers["XKF1"]
    again = item.head[item.head.index(b"XKF1") - 5 :][:89]
    item.messages.append((100.5, again))
    r = read(item.bytes())
    assert r.channels["velocity_z"].values.size == 60
    assert not told(r, "message_formats")
    item.messages[-1] = (100.5, fmt(number, 20, "XKF1", "QBd", "TimeUS,C,VD"))
    r = read(item.bytes())
    assert r.channels["velocity_z"].values.size == 60
    assert "the first counts: XKF1" in told(r, "message_formats")


def test_many_breaks_end_the_search(read, sound_dataflash, monkeypatch):
    monkeypatch.setattr("eivor.logs.dataflash.messages.MAX_BREAKS", 20)
    r = read(sound_dataflash + b"\xa3\x95\x80" * 2000)
    assert told(r, "corrupt_parts") or told(r, "truncated")
