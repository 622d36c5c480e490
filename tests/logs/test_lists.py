"""Columns whose cells are lists: a map names an element, and without one they are told from empty ones."""

import numpy as np
import polars as pl
import pytest

from eivor.errors import ChannelMapError, EmptyLogError
from eivor.logs import read_log

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
        return read_log(path, channel_map=tmp_path / "m.toml")

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
        read_log(path)
    frame = pl.DataFrame({"time": TIMES, "velocity_z": VECTORS.tolist(), "position_z": TIMES})
    frame.write_parquet(tmp_path / "t.parquet")
    r = read_log(tmp_path / "t.parquet")
    assert "List(Float64)" in next(finding.message for finding in r.findings if finding.name == "lists")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("index = 2", "index = -1", "a place from 0.*index"),
        ("index = 2", "index = 1.5", "a whole number"),
        ('column = "v"\nindex = 2', 'column = "w"\nindex = 2', r"a column 'w\[2\]'.*'v'"),
    ],
)
def test_maps_that_are_wrong(tmp_path, mapped, old, new, words):
    path = written(tmp_path / "t.csv", ["[1, 2, 3]"] * ROWS)
    with pytest.raises(ChannelMapError, match=f"(?s){words}"):
        mapped(path, MAP.replace(old, new))
