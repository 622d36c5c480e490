"""Damaged files: every reader answers with a Recording or an `InputError`, in bounded time.

The time is that of the processor: it does not grow when others use the machine too.
"""

import contextlib
import csv
import re
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ulog_writer import flight
from usd_writer import flight as crazyflie_flight

from eivor.errors import InputError
from eivor.logs import read_log
from eivor.logs.channel_map import parse_channel_map, parse_expression
from eivor.logs.table import columnar
from eivor.signals.recording import Recording

QUICK = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)


def damaged(blob, rng):
    """One of the ways in which files break: changed bytes, a cut, a block twice, a block gone, zeros."""
    data = bytearray(blob)
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(6)
        index = int(rng.integers(len(data))) if data else 0
        length = int(rng.integers(1, 200))
        if kind == 0:
            for integer in rng.integers(0, max(len(data), 1), rng.integers(1, 20)):
                data[integer : integer + 1] = rng.bytes(1)
        elif kind == 1:
            del data[index:]
        elif kind == 2:
            data[index:index] = data[int(rng.integers(len(data) + 1)) :][:length]
        elif kind == 3:
            del data[index : index + length]
        elif kind == 4:
            data[index : index + length] = bytes(length)
        else:
            data[index:index] = rng.bytes(length)
    return bytes(data)


def survives(path, blob, limit_s=10.0):
    """Raise unless a file is read or refused within so much time of this processor."""
    path.write_bytes(blob)
    started = time.process_time()
    try:
        recording = read_log(path)
    except InputError as error:
        text = str(error)
    else:
        text = " ".join(finding.message for finding in recording.findings)
        assert isinstance(recording, Recording)
        assert recording.channels
    assert len(text) < 20_000
    assert time.process_time() - started < limit_s


def canonical():
    t = np.arange(100) * 0.01
    return pl.DataFrame({"time": t, "velocity_z": np.sin(t), "input": np.cos(t), "landed": t > 0.5})


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    canonical().write_csv(folder / "t.csv")
    canonical().write_parquet(folder / "t.parquet", metadata={"eivor": "{}"})
    canonical().write_parquet(folder / "plain.parquet", compression="uncompressed", row_group_size=20)
    (folder / "t.ulg").write_bytes(flight().bytes())
    for version in (1, 2):
        (folder / f"crazyflie{version}").write_bytes(crazyflie_flight(version).bytes())
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "trials"),
    [
        ("t.csv", 150),
        ("t.ulg", 150),
        ("t.parquet", 15),
        ("plain.parquet", 15),
        ("crazyflie1", 300),
        ("crazyflie2", 300),
    ],
)
def test_synthetic_files(tmp_path, seeds, name, trials):
    rng = np.random.default_rng(7)
    for _ in range(trials):
        survives(tmp_path / "damaged", damaged(seeds[name], rng))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "cuts"),
    [("t.csv", 150), ("t.ulg", 150), ("t.parquet", 10), ("crazyflie1", 300), ("crazyflie2", 300)],
)
def test_every_length(tmp_path, seeds, name, cuts):
    blob = seeds[name]
    for length in range(0, len(blob), max(1, len(blob) // cuts)):
        survives(tmp_path / "cut", blob[:length])


@pytest.mark.thorough
@pytest.mark.recordings
@pytest.mark.parametrize(
    "name",
    [
        "px4/sample_appended_multiple.ulg",
        "px4/sample_px4_events.ulg",
        "nanobench/B2_circle_fast_rep1.csv",
        "arpl-crazyflie/log10",
    ],
)
def test_real_files(tmp_path, recordings, name):
    rng = np.random.default_rng(11)
    blob = (recordings / name).read_bytes()[:600_000]
    for _ in range(12):
        survives(tmp_path / "damaged", damaged(blob, rng))


@pytest.mark.thorough
@QUICK
@given(st.binary(max_size=300))
def test_any_bytes_after_a_ulog_header(tmp_path, blob):
    survives(tmp_path / "u", b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + bytes(8) + blob)


@QUICK
@given(st.binary(max_size=300), st.sampled_from([0, 5, 7, 20, 60, 150]))
def test_any_bytes_in_a_crazyflie_log(tmp_path, blob, sound):
    survives(tmp_path / "c", crazyflie_flight(count=20).bytes()[: 1 + sound] + blob)


@settings(QUICK, max_examples=10)
@given(st.binary(max_size=300))
def test_any_bytes_in_a_parquet(tmp_path, blob):
    survives(tmp_path / "p", b"PAR1" + blob + b"PAR1")


@QUICK
@given(st.text(max_size=200))
def test_any_text_below_a_header(tmp_path, text):
    survives(tmp_path / "c", b"time,velocity_z\n" + text.encode("utf-8", "replace"))


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
    z = read_log(tmp_path / "t.csv").channels["velocity_z"]
    np.testing.assert_array_equal(z.time_s, 0.5 * np.arange(len(notes)))
    np.testing.assert_array_equal(z.values, -0.25 * np.arange(len(notes)))


@pytest.mark.thorough
@QUICK
@given(st.text(alphabet='ab1.,;"\n', max_size=60))
def test_any_quotes_below_a_header(tmp_path, text):
    survives(tmp_path / "q", b"time,velocity_z,n\n0,1,2\n" + text.encode())


@QUICK
@given(st.binary(max_size=200))
def test_any_bytes(tmp_path, blob):
    survives(tmp_path / "b", blob)


@QUICK
@given(st.text(max_size=200))
def test_any_text_as_a_map(text):
    with contextlib.suppress(InputError):
        parse_channel_map('name = "m"\n[time]\ncolumn = "t"\n' + text, "m.toml")


@QUICK
@given(st.text(alphabet="ab12.+-*/(), \"'eE_;\n", max_size=60))
def test_any_text_as_an_expression(text):
    try:
        expression = parse_expression(text, "here")
    except InputError:
        return
    values = {column: np.array([1.0, np.nan, -2.0]) for column in expression.columns}
    assert expression.evaluate(values).shape == (3,)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # the checks of a million calls take most of the time
@pytest.mark.parametrize("filler", [b"\x00", b"\xff", b"D", b"\x01\x00D"])
def test_long_runs_of_nonsense_take_bounded_time(tmp_path, filler):
    blob = flight().bytes() + filler * (1_000_000 // len(filler))
    survives(tmp_path / "long.ulg", blob, limit_s=5.0)


def test_a_parquet_that_aborts_its_decoder(tmp_path, monkeypatch):
    """The child dies as a decoder does that asks for too much memory; this process goes on."""
    canonical().write_parquet(tmp_path / "t.parquet")
    monkeypatch.setattr(columnar, "_PARQUET_CODE", "import os; os.abort()")
    with pytest.raises(InputError, match="makes the decoder fail"):
        read_log(tmp_path / "t.parquet")
    monkeypatch.setattr(columnar, "_PARQUET_CODE", "import time; time.sleep(9)")
    monkeypatch.setattr(columnar, "PARQUET_TIMEOUT_S", 0.1)
    with pytest.raises(InputError, match="not decoded within"):
        read_log(tmp_path / "t.parquet")
    monkeypatch.setattr(sys, "executable", "")  # embedded: there is no interpreter to start
    assert read_log(tmp_path / "t.parquet").channels


def test_a_small_parquet_of_many_rows_is_refused(tmp_path, monkeypatch):
    canonical().write_parquet(tmp_path / "t.parquet")
    monkeypatch.setattr(columnar, "MAX_ROWS", 50)  # instead of writing half a gigabyte
    with pytest.raises(InputError, match="at most 50 rows"):
        read_log(tmp_path / "t.parquet")
    monkeypatch.setattr(columnar, "MAX_ROWS", 500)
    monkeypatch.setattr(columnar, "MAX_CELLS", 50)
    with pytest.raises(InputError, match="at most 50 numbers"):
        read_log(tmp_path / "t.parquet")


def test_a_parquet_that_repeats_itself_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    rows = 6_000_000
    frame = pl.DataFrame({"time": np.arange(rows) // 1000, "velocity_z": np.ones(rows), "x": np.ones(rows)})
    frame.write_parquet(tmp_path / "t.parquet")
    assert (tmp_path / "t.parquet").stat().st_size < 200_000
    monkeypatch.setattr(columnar, "probe_parquet", None)
    with pytest.raises(InputError, match=f"each byte of a Parquet.*{rows} rows of 2 needed columns in"):
        read_log(tmp_path / "t.parquet")


def test_the_package_s_own_file_is_decoded_at_once(tmp_path, monkeypatch):
    path = Path(str(resources.files("eivor.data"))) / "example_flight.parquet"
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    probed = []
    monkeypatch.setattr(columnar, "probe_parquet", lambda file, *_: probed.append(file))
    assert read_log(path).channels.keys() == read_log(copy).channels.keys()
    assert probed == [copy]


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
    r = read_log(tmp_path / "t.parquet")
    assert set(r.channels) == {"velocity_z", "input", "landed"}
    assert any(f.name == "unreadable_text" and "'position_z' 100" in f.message for f in r.findings)


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit what a process maps")
def test_the_decoder_has_so_much_memory_and_no_more(tmp_path, monkeypatch):
    rows = 4_000_000
    time_s = np.cumsum(np.random.default_rng(0).random(rows))
    pl.DataFrame({"time": time_s, "velocity_z": time_s}).write_parquet(tmp_path / "t.parquet")
    monkeypatch.setattr(columnar, "PARQUET_DECODER_BYTES", 32 << 20)
    monkeypatch.setattr(columnar, "ROW_BYTES", 0)
    with pytest.raises(InputError, match=r"makes the decoder fail .*it may use 32 MiB"):
        read_log(tmp_path / "t.parquet")


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
def test_file_names_of_several_lines(tmp_path):
    canonical().write_parquet(tmp_path / "a\nb.parquet")
    assert read_log(tmp_path / "a\nb.parquet").channels
