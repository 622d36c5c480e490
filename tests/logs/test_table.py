"""The tables that pyulog's `ulog2csv` makes of a flight are read as its ULog is."""

from __future__ import annotations

import datetime
import os
import subprocess
import sys
from contextlib import suppress

import bag_writer
import h5py
import numpy as np
import polars as pl
import pytest
from dataflash_writer import simulated, told
from pyulog.ulog2csv import convert_ulog2csv
from scipy.io import savemat

import eivor as ev
from eivor.errors import ChannelMapError, EivorError, EmptyLogError, InputError
from eivor.signals import channels


def csv(tmp_path, text, **options):
    path = tmp_path / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return ev.read_log(path, **options)


def names(recording):
    return [finding.name for finding in recording.findings]


def test_canonical_names_need_no_map(tmp_path):
    r = csv(tmp_path, "time,velocity_z,rotor_command_1,rotor_command_2,junk\n0,1,2,3,a\n0.1,2,3,4,b\n")
    assert (r.format, r.input_map) == ("csv", "")
    assert list(r.channels) == ["velocity_z", "rotor_command_1", "rotor_command_2"]
    assert [c.held for c in r.channels.values()] == [False, True, True]
    assert [c.unit for c in r.channels.values()] == ["m/s", "", ""]
    assert any(f.name == "ignored_columns" and "'junk'" in f.message for f in r.findings)
    with pytest.raises(Exception, match="column input"):
        r.channel("input")


@pytest.mark.parametrize(
    "text",
    [
        "time;velocity_z\n0;1,5\n0,1;2,5\n",
        "time\tvelocity_z\r\n0\t1.5\r\n0.1\t2.5\r\n",
        "time|velocity_z\n0|1.5\n0.1|2.5\n",
        '"time","velocity_z"\n"0","1.5"\n"0.1","2.5"',
        "time,velocity_z,\n0,1.5,\n0.1,2.5,",
        'time,velocity_z,5" prop\n0,1.5,5" prop\n0.1,2.5,7"\n',
        'time,velocity_z,"a\nnote"\n0,1.5,"one\ntwo, ""three"""\n0.1,2.5,x\n',
        "time;velocity_z;note\n0;1.5;a,b\n0.1;2.5;c\n",
        "time;velocity_z;rotor_speed_1\n0;1,5;10\n0.1;2.5;11\n",
        "\ufefftime,velocity_z\n0,1.5\n0.1,2.5\n",
        '"time","velocity_z"\n"0","1.5"\n"0.1","2.5"\n',
        "\n\n time , velocity_z \n 0 , 1.5 \n\n 0.1 , 2.5 \n\n",
        "time,velocity_z\n0,1.5,\n0.1,2.5,\n",
        'time,velocity_z,note\n0,1.5,"a,b"\n0.1,2.5,""\n',
    ],
)
def test_dialects(tmp_path, text):
    z = csv(tmp_path, text).channels["velocity_z"]
    np.testing.assert_allclose(z.values, [1.5, 2.5])
    np.testing.assert_allclose(z.time_s, [0.0, 0.1])


def test_missing_and_unreadable_cells(tmp_path):
    r = csv(
        tmp_path,
        "time,velocity_z,landed\n0,1,true\n1,,False\n2,NaN,TRUE\n3,oops,false\n4,NA,1\n5,-inf,0\n6,3e0,0\n",
    )
    np.testing.assert_array_equal(r.channels["velocity_z"].values, [1, *[np.nan] * 5, 3])
    np.testing.assert_array_equal(r.channels["landed"].values, [1, 0, 1, 0, 1, 0, 0])
    assert any(f.name == "unreadable_text" and "'velocity_z' 1" in f.message for f in r.findings)
    assert r.channels["velocity_z"].quality.missing_values == 5


def test_stamps(tmp_path):
    r = csv(tmp_path, "time,velocity_z\n0,1\n1,2\n1,3\n0.5,4\n,5\n2,6\n")
    z = r.channels["velocity_z"]
    np.testing.assert_array_equal(z.values, [1, 2, 6])
    assert (z.quality.duplicated_stamps, z.quality.backward_stamps) == (1, 1)
    assert names(r).count("time_stamps") == 2


def test_calendar_stamps_start_at_zero(tmp_path):
    rows = "".join(f"{1772421798.5 + 0.01 * k:.3f},{k % 7}\n" for k in range(50))
    r = csv(tmp_path, "time,velocity_z\n" + rows)
    assert r.span_s[0] == 0.0
    assert r.span_s[1] == pytest.approx(0.49, abs=1e-6)
    assert "epoch_time" in names(r)


def test_units_in_brackets_are_read(tmp_path):
    r = csv(tmp_path, "time [ms],velocity_z (ft/s),specific_force_z [g]\n0,1,1\n10,2,1\n")
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, [0.0, 0.01])
    np.testing.assert_allclose(r.channels["velocity_z"].values, [0.3048, 0.6096])
    np.testing.assert_allclose(r.channels["specific_force_z"].values, 9.80665)


def test_units_in_a_line_below_the_names_are_read(tmp_path):
    rows = "time,velocity_z,position_z,input\n[ms],(ft/s),yards,counts\n0,1,5,7\n10,2,5,7\n"
    r = csv(tmp_path, rows)
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, [0.0, 0.01])
    np.testing.assert_allclose(r.channels["velocity_z"].values, [0.3048, 0.6096])
    np.testing.assert_allclose(r.channels["input"].values, 7.0)
    assert "position_z" not in r.channels
    (finding,) = (f for f in r.findings if f.name == "units_row")
    assert "time ms, velocity_z ft/s, position_z yards, input counts" in finding.message
    with pytest.raises(ChannelMapError) as caught:
        csv(tmp_path, "T,Altitude,Vz\nms,ft,ft/s\n0,1,1\n")
    with pytest.raises(ChannelMapError) as suffixed:
        csv(tmp_path, "t_ms,vz,z_sp\n0,1,1\n")
    assert suffixed.value.__notes__[3:5] == ['column = "t_ms"', 'unit = "ms"']
    assert [line for line in caught.value.__notes__ if "unit" in line] == [
        'unit = "ms"',
        'unit = "ft"',
        'unit = "ft/s"',
    ]


def test_channels_of_a_machine_are_proposed_for_columns_written_like_them(tmp_path, monkeypatch):
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))
    declared = {"heave": "m/s", "thrust": ev.input("1"), "depth_goal": ev.reference("m")}
    ev.machine("auv", channels=declared, response="ddt(heave)", terms={"gain": "thrust"})
    text = "t,Heave,thrust,Depth goal\n0,1,2,3\n0.1,2,3,4\n"
    with pytest.raises(ChannelMapError, match="Save the lines below") as caught:
        csv(tmp_path, text)
    own = tmp_path / "own.toml"
    own.write_text("\n".join(caught.value.__notes__), encoding="utf-8")
    assert [*csv(tmp_path, text, channel_map=own).channels] == ["heave", "thrust", "depth_goal"]


def test_a_table_with_names_of_its_own_is_answered_with_the_map_that_reads_it(tmp_path):
    text = (
        "Time (ms);Altitude (ft);Vz (ft/s);Acc Z (g);Roll (deg);Pitch (deg);Motor 1 (us);Target alt (ft);"
        "Vz_ref\n"
        "0;10;1,5;1;60;0;1500;11;2\n10;10;2;1;60;0;1600;11;3\n"
    )
    with pytest.raises(ChannelMapError, match="Save the lines below") as caught:
        csv(tmp_path, text)
    own = tmp_path / "own.toml"
    own.write_text("\n".join(caught.value.__notes__), encoding="utf-8")
    r = csv(tmp_path, text, channel_map=own)
    assert {name: channel.values[0] for name, channel in r.channels.items()} == pytest.approx(
        {
            "position_z": 3.048,
            "velocity_z": 0.4572,
            "specific_force_body_z": 9.80665,
            "cos_tilt": 0.5,
            "rotor_command_1": 1500.0,
            "reference_position_z": 3.3528,
            "reference_velocity_z": 2.0,
        }
    )


def test_decimal_commas_in_any_row(tmp_path):
    r = csv(tmp_path, "time;velocity_z;input\n0;0;0\n1;1,5;10\n2;-,5e1;20\n")
    assert (r.channels["velocity_z"].values.tolist(), r.findings) == ([0.0, 1.5, -5.0], ())


def test_thousands_are_not_taken_for_fractions(tmp_path):
    r = csv(tmp_path, "time;rotor_speed_1;velocity_z\n0;1,234;0.5\n1;999;0.6\n2;12,345,678;0.7\n")
    np.testing.assert_array_equal(r.channels["rotor_speed_1"].values, [np.nan, 999.0, np.nan])
    assert any(f.name == "unreadable_text" and "'rotor_speed_1' 2" in f.message for f in r.findings)


@pytest.mark.parametrize("cut", range(1, 8))
def test_a_file_cut_inside_its_last_number(tmp_path, cut):
    """A number that is not there beats one that is wrong; the line break makes it whole."""
    text = "time,velocity_z\n0,1.5\n0.5,2.5\n1.25,31.4159\n"
    r = csv(tmp_path, text[:-cut])
    z = r.channels["velocity_z"]
    assert z.time_s.tolist() == [0.0, 0.5, 1.25]
    np.testing.assert_array_equal(z.values, [1.5, 2.5, np.nan])
    assert any(f.name == "truncated" and "the last cell, of 'velocity_z'" in f.message for f in r.findings)
    assert csv(tmp_path, text).findings == ()


@pytest.mark.parametrize("end", ['0.2,3,"', '0.2,3,"x', '0.2,3,"x,'])
def test_a_file_cut_inside_a_quoted_cell(tmp_path, end):
    r = csv(tmp_path, 'time,velocity_z,note\n0,1,"a\nb"\n0.1,2,"b"\n' + end)
    assert r.channels["velocity_z"].values.tolist() == [1.0, 2.0]
    assert names(r)[0] == "truncated"


@pytest.mark.parametrize(
    "cell", ["=1+1", "=cmd|' /C calc'!A0", "{0.__class__}", "[red]x[/red]", "%s%n", "<b>"]
)
def test_contents_are_never_interpreted(tmp_path, cell):
    r = csv(tmp_path, f'time,velocity_z,"{cell}"\n0,1,1\n0.1,"{cell}",1\n0.2,2,1\n')
    assert np.isnan(r.channels["velocity_z"].values[1])
    with pytest.raises(ChannelMapError) as caught:
        csv(tmp_path, f'a,"{cell}"\n0,1\n')
    assert repr(cell) in str(caught.value)


def test_units_that_cannot_be(tmp_path):
    t = np.arange(200) * 0.01
    wave = np.sin(t)
    frame = pl.DataFrame(
        {
            "time": t * 1000.0,
            "specific_force_body_x": 0 * t,
            "specific_force_body_y": 0 * t,
            "specific_force_body_z": 1 + 0.01 * wave,
            "attitude_w": 2 + 0 * t,
            "attitude_x": 0 * t,
            "attitude_y": 0 * t,
            "attitude_z": 0 * t,
            "cos_tilt": 10 + wave,
            "angular_rate_x": 50 + wave,
            "position_z": wave,
            "velocity_z": -np.cos(t) * 1e-3,
        }
    )
    frame.write_parquet(tmp_path / "t.parquet")
    r = ev.read_log(tmp_path / "t.parquet")
    doubts = " ".join(f.message for f in r.findings if f.name == "mixed_units")
    for words in ("value in g", "norm of 2", "leaves [-1, 1]", "deg/s", "velocity_z is -1 times"):
        assert words in doubts
    assert "time_unit" in names(r)
    assert r.channels["specific_force_body_z"].values[0] == 1.0  # told, not corrected


def test_a_climb_that_no_rotorcraft_makes_is_doubted():
    time_s = np.arange(100) * 0.1
    r = ev.recording_from_columns({"time": time_s, "velocity_z": 57.0 * np.sin(time_s), "input": time_s})
    (finding,) = (f for f in r.findings if f.name == "mixed_units")
    assert finding.message.startswith("velocity_z reaches 57 m/s: its estimator has diverged")


def test_rows_that_a_resampler_made_up(tmp_path):
    rng = np.random.default_rng(1)
    t = np.arange(400) * 0.01
    columns = {"time": t, "position_z": rng.normal(size=400)}
    for i in range(1, 5):
        values = rng.normal(size=400)
        values[300:] = values[299] + 3.0 * i * (t[300:] - t[299])
        columns[f"rotor_command_{i}"] = values
    pl.DataFrame(columns).write_csv(tmp_path / "t.csv")
    r = ev.read_log(tmp_path / "t.csv")
    assert "extrapolated" in names(r)
    assert np.flatnonzero(np.isnan(r.channels["rotor_command_2"].values))[0] in (299, 300)
    assert np.isfinite(r.channels["position_z"].values).all()


def test_ramps_are_not_taken_for_made_up_rows(tmp_path):
    t = np.arange(400) * 0.01
    ramps = {f"rotor_command_{i}": i * t for i in range(1, 5)}
    pl.DataFrame({"time": t, "velocity_z": np.sin(9 * t), **ramps}).write_csv(tmp_path / "t.csv")
    assert "extrapolated" not in names(ev.read_log(tmp_path / "t.csv"))
    ramps = {f"rotor_command_{i}": np.maximum(t, 2.0) for i in range(1, 5)}
    pl.DataFrame({"time": t, "velocity_z": np.sin(9 * t), **ramps}).write_csv(tmp_path / "t.csv")
    assert "extrapolated" not in names(ev.read_log(tmp_path / "t.csv"))


def test_parquet_types(tmp_path):
    start = datetime.datetime(2026, 1, 1)
    frame = pl.DataFrame(
        {
            "time": [start + datetime.timedelta(milliseconds=10 * k) for k in range(4)],
            "velocity_z": pl.Series([1, 2, None, 4], dtype=pl.Int8),
            "landed": [True, False, True, None],
            "input": ["1.5", " 2 ", "x", None],
            "position_z": [[1], [2], [3], [4]],
        }
    )
    frame.write_parquet(tmp_path / "t.parquet")
    r = ev.read_log(tmp_path / "t.parquet")
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, [0, 0.01, 0.02, 0.03], atol=1e-6)
    np.testing.assert_array_equal(r.channels["velocity_z"].values, [1, 2, np.nan, 4])
    np.testing.assert_array_equal(r.channels["landed"].values, [1, 0, 1, np.nan])
    np.testing.assert_array_equal(r.channels["input"].values, [1.5, 2, np.nan, np.nan])
    assert "position_z" not in r.channels
    assert {"never_valid", "unreadable_text"} <= set(names(r))


PARAMETERS = "IMU_ACCEL_CUTOFF"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "flight_1.ulg").write_bytes(bag_writer.ulog(simulated(seed=3, duration=2.0)))
    made = tmp_path / "tables"
    made.mkdir()
    convert_ulog2csv(str(tmp_path / "flight_1.ulg"), "", str(made), ",", None, None)
    return made


def test_the_same_channels(folder):
    expected = ev.read_log(folder.parent / "flight_1.ulg")
    r = ev.read_log(folder)
    assert (r.format, r.name, r.frame, r.vehicle) == ("ulog2csv", "tables", expected.frame, "rotary wing")
    assert set(r.channels) == set(expected.channels)
    for name, channel in expected.channels.items():
        np.testing.assert_allclose(r.channels[name].time_s, channel.time_s, atol=1e-9)
        np.testing.assert_allclose(r.channels[name].values, channel.values, rtol=1e-6, atol=1e-7)
        assert r.channels[name].source == channel.source
    assert PARAMETERS in told(r, "sensor_delay")


def test_tables_that_are_damaged_or_of_another_log(folder):
    (folder / "flight_1_vehicle_attitude_0.csv").write_text("timestamp,q[0]\n1,2,3\n")
    (folder / "flight_1_vehicle_status_0.csv").write_text("timestamp,nav_state\nx,2\n")
    r = ev.read_log(folder)
    assert "attitude_w" not in r.channels
    assert "whose line 2 has 3 fields" in told(r, "corrupt_parts")
    assert "vehicle_status" in told(r, "time_stamps")
    (folder / "other_vehicle_attitude_0.csv").write_text("timestamp,q[0]\n1,2\n")
    with pytest.raises(InputError, match="one log; received 'tables' with those of 2: flight_1, other"):
        ev.read_log(folder)


ROWS = 40
VECTORS = np.arange(3.0 * ROWS).reshape(ROWS, 3) / 8.0
TIMES = np.arange(ROWS) * 0.02
MAP = """
name = "lists"
[time]
column = "t"
[channels.velocity_z]
column = "v"
index = 2
[channels.position_z]
column = "v"
index = 0
[channels.rotor_command_1]
expression = '"v[1]" / 2'
"""


@pytest.fixture
def mapped(tmp_path):
    def mapped(path, text=MAP):
        (tmp_path / "m.toml").write_text(text)
        return ev.read_log(path, channel_map=tmp_path / "m.toml")

    return mapped


def written(path, cells):
    lines = [f"{time:g};{cell}" for time, cell in zip(TIMES, cells, strict=True)]
    path.write_text("t;v\n" + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("form", ["[{}, {}, {}]", "({}; {}; {})", "[{} {}  {}]", "array([{}, {}, {}])"])
def test_elements_of_texts(tmp_path, mapped, form):
    quote = '"' if ";" in form else ""
    cells = [f"{quote}{form.format(*row)}{quote}" for row in VECTORS]
    r = mapped(written(tmp_path / "t.csv", cells))
    np.testing.assert_array_equal(r.channels["velocity_z"].values, VECTORS[:, 2])
    np.testing.assert_array_equal(r.channels["rotor_command_1"].values, VECTORS[:, 1] / 2)


@pytest.mark.parametrize(
    "kind", [pl.List(pl.Float32), pytest.param(pl.Array(pl.Float64, 3), marks=pytest.mark.thorough)]
)
def test_elements_of_nested_columns(tmp_path, mapped, kind):
    frame = pl.DataFrame({"t": TIMES, "v": pl.Series(VECTORS.tolist(), dtype=kind)})
    frame.write_parquet(tmp_path / "t.parquet")
    r = mapped(tmp_path / "t.parquet")
    np.testing.assert_array_equal(r.channels["velocity_z"].values, VECTORS[:, 2])
    np.testing.assert_array_equal(r.channels["position_z"].values, VECTORS[:, 0])


def test_what_is_no_element_is_missing(tmp_path, mapped):
    cells = [f"[{row[0]}, {row[1]}, {row[2]}]" for row in VECTORS]
    cells[3], cells[4], cells[5] = "[1, 2]", "nothing", "[1, 2, x]"
    channel = mapped(written(tmp_path / "t.csv", cells)).channels["velocity_z"]
    assert np.flatnonzero(np.isnan(channel.values)).tolist() == [3, 4, 5]


def test_lists_are_told_from_empty_columns(tmp_path):
    cells = [f"[{row[0]}, {row[1]}, {row[2]}]" for row in VECTORS]
    path = written(tmp_path / "t.csv", [cell.replace(",", "") for cell in cells])
    path.write_text(path.read_text().replace("t;v", "time;velocity_z", 1))
    with pytest.raises(EmptyLogError, match=r"lists.*'velocity_z' \(\[0.0 0.125 0.25\]\).*`index`"):
        ev.read_log(path)
    frame = pl.DataFrame({"time": TIMES, "velocity_z": VECTORS.tolist(), "position_z": TIMES})
    frame.write_parquet(tmp_path / "t.parquet")
    r = ev.read_log(tmp_path / "t.parquet")
    assert "List(Float64)" in next(finding.message for finding in r.findings if finding.name == "lists")


RIG = """
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
            text = isinstance(value, str)
            letters = np.frombuffer(value.encode("utf-16-le"), "<u2")[:, None] if text else None
            made = group.create_dataset(name, data=letters if text else np.atleast_2d(value.T).T)
            made.attrs["MATLAB_class"] = np.bytes_("char" if text else "double")
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
    (tmp_path / "rig.toml").write_text(RIG)
    mapped = ev.read_log(
        write(tmp_path / "b.dat", kind, flight, tree=True), channel_map=tmp_path / "rig.toml"
    )
    assert len(mapped.channels) == 5
    for name, channel in mapped.channels.items():
        sign = -1.0 if name.endswith("_z") else 1.0
        np.testing.assert_array_equal(sign * channel.values, flight.channels[name].values, err_msg=name)


def test_variables_without_a_space_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = file["velocity_z"] = np.arange(50.0)
        file["input"] = h5py.Empty("f8")
        file.create_dataset("rows", (50,), dtype=h5py.vlen_dtype("f8"))
    assert set(ev.read_log(tmp_path / "a.h5").channels) == {"velocity_z"}


T = np.linspace(0.0, 2.0, 201)
COLUMNS = {
    "time": T,
    "velocity_z": np.sin(T) / 3,
    "input": np.where(T < 1, np.nan, 0.1),
    "rotor_command_2": T**2,
}


@pytest.mark.parametrize("make", [dict, pl.DataFrame, lambda c: {k: list(v) for k, v in c.items()}])
def test_from_columns(make):
    r = ev.recording_from_columns(
        make(COLUMNS), name="sim", frame=ev.Frame.NED, input_map="square", parameters={"mass": 1.0}
    )
    assert (r.name, r.format, r.frame, r.input_map, r.parameters) == (
        "sim",
        "frame",
        ev.Frame.NED,
        "square",
        {"mass": 1.0},
    )
    np.testing.assert_array_equal(r.channels["input"].values, COLUMNS["input"])
    assert r.channels["input"].held
    assert r.sha256 == ""


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
    r = ev.read_log(tmp_path / "r.parquet")
    assert r.frame is ev.Frame.Z_UP
    assert "metadata" in [f.name for f in r.findings]


@pytest.mark.parametrize(
    "stamps",
    [np.arange(200) * 1e298, 1e300 + np.arange(200), np.arange(200) * 1e-320, np.r_[np.arange(199.0), 1e300]],
)
def test_stamps_at_the_edge_of_numbers_are_dropped(tmp_path, stamps):
    """Before they were read, with rates of infinity, or ended in a raw error."""
    values = np.sin(np.arange(200.0))
    pl.DataFrame({"time": stamps, "velocity_z": values, "input": values}).write_csv(tmp_path / "t.csv")
    channel = ev.read_log(tmp_path / "t.csv").channels["velocity_z"]
    assert channel.values.size in (0, 1, 199)
    assert np.isfinite(channel.rate_hz)
    with suppress(EivorError):
        ev.identify_flight(ev.read_log(tmp_path / "t.csv"))


@pytest.mark.parametrize(
    ("stamps", "left"), [(np.zeros(51), (1, 0.0)), (np.r_[1e-18 * np.arange(50), 1.0], (2, 1.0))]
)
def test_stamps_of_matlab_that_are_as_good_as_equal_are_one(whole, tmp_path, stamps, left):
    """Their rate was a division by zero."""
    savemat(tmp_path / "t.mat", {"time": stamps, "velocity_z": np.arange(51.0)})
    channel = ev.read_log(tmp_path / "t.mat").channels["velocity_z"]
    assert (channel.values.size, channel.rate_hz) == left


FORKED = """
import os, sys
import eivor as ev
ev.read_log(sys.argv[1])
if os.fork():
    sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
try:
    ev.read_log(sys.argv[1])
except Exception as error:
    sys.stdout.write(str(error))
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no such system call there")
def test_a_forked_process_refuses_tables_in_place_of_waiting_for_ever(tmp_path):
    (tmp_path / "t.csv").write_text("time,velocity_z\n0,1\n1,2\n")
    command = [sys.executable, "-W", "ignore", "-c", FORKED, str(tmp_path / "t.csv")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "forked from a process that had read one" in done.stdout
    assert "get_context('spawn')" in done.stdout
