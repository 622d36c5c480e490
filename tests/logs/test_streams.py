"""Logs that come through a pipe."""

import io
import os
import subprocess
import sys
import tempfile

import polars as pl
import pytest
from ulog_writer import flight

from eivor.errors import EmptyLogError, InputError, LogTooLargeError, UnknownFormatError, UsageError
from eivor.logs import read_log

TABLE = b"time,velocity_z\n0,1\n0.1,2\n"


class Input(io.TextIOWrapper):
    """A standard input that holds some bytes."""

    def __init__(self, content, *, terminal=False):
        super().__init__(io.BytesIO(content))
        self.terminal = terminal

    def isatty(self):
        return self.terminal


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder for temporary files, empty before and after."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def parquet():
    blob = io.BytesIO()
    pl.DataFrame({"time": [0.0, 0.1], "velocity_z": [1.0, 2.0]}).write_parquet(blob)
    return blob.getvalue()


@pytest.mark.parametrize(
    ("content", "name"), [(TABLE, "csv"), (parquet(), "parquet"), (flight().bytes(), "ulog")]
)
def test_every_format(temporary, monkeypatch, content, name):
    monkeypatch.setattr(sys, "stdin", Input(content))
    r = read_log("-")
    assert (r.format, r.name) == (name, "standard input")
    assert "velocity_z" in r.channels


@pytest.mark.parametrize(
    ("stream", "error", "words"),
    [
        (Input(b""), EmptyLogError, "'standard input', which is empty"),
        (Input(b"words"), UnknownFormatError, "'standard input', whose content"),
        (Input(TABLE * 9), LogTooLargeError, "at most 100 bytes; received more from standard input"),
        (
            Input(TABLE, terminal=True),
            InputError,
            r"nothing that is piped into it. Write `... | eivor identify -`",
        ),
        (None, InputError, "nothing that is piped into it"),
    ],
)
def test_what_is_not_read(temporary, monkeypatch, stream, error, words):
    monkeypatch.setattr(sys, "stdin", stream)
    with pytest.raises(error, match=words):
        read_log("-", max_bytes=100)


def test_a_file_of_that_name_comes_first(temporary, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", Input(b""))
    (tmp_path / "-").write_bytes(TABLE)
    assert read_log("-").name == "-"


@pytest.mark.skipif(sys.platform == "win32", reason="no such paths there")
def test_pipes_that_were_opened_for_this_process(temporary):
    reading, writing = os.pipe()
    try:
        os.write(writing, TABLE)
        os.close(writing)
        assert read_log(f"/dev/fd/{reading}").channels["velocity_z"].values.tolist() == [1.0, 2.0]
    finally:
        os.close(reading)


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="no such paths there")
@pytest.mark.parametrize("path", ["-", "/dev/stdin"])
def test_the_command_line(tmp_path, path):
    command = [sys.executable, "-c", "from eivor.cli.main import run; run()", "inspect", path]
    done = subprocess.run(command, input=TABLE, capture_output=True, check=False, cwd=tmp_path)
    assert b"standard input" in done.stdout
    assert done.stderr == b""


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("path", [3, None, b"log.csv", ["log.csv"]])
def test_paths_that_are_none(path):
    with pytest.raises(UsageError, match="a path, as a text or a Path"):
        read_log(path)
