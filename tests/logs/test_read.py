import gzip
import os
import sys
from pathlib import Path

import pytest

from eivor.errors import (
    EmptyLogError,
    InputError,
    LogTooLargeError,
    MissingReaderError,
    UnknownFormatError,
    UsageError,
)
from eivor.logs import logging_advice, read_log


def written(tmp_path, content, name="log"):
    path = tmp_path / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (gzip.compress(b"time,velocity_z\n0,1\n", mtime=0), "gzip archive.*Unpack"),
        (b"PK\x03\x04" + bytes(100), "zip archive"),
        (b"H Product:Blackbox flight data recorder", "Betaflight"),
    ],
)
def test_known_formats_without_a_reader(tmp_path, content, words):
    with pytest.raises(MissingReaderError, match=f"(?s){words}"):
        read_log(written(tmp_path, content, "misleading.csv"))


@pytest.mark.parametrize(
    "content",
    [
        b"hello world\n",
        b"\x00" * 100,
        bytes(range(256)),
        b"\n\n\n",
    ],
)
def test_unknown_formats(tmp_path, content):
    with pytest.raises(UnknownFormatError, match="content is that of none of them"):
        read_log(written(tmp_path, content))


def test_empty(tmp_path):
    with pytest.raises(EmptyLogError, match="0 bytes"):
        read_log(written(tmp_path, b""))


def test_too_large_is_told_before_reading(tmp_path):
    path = tmp_path / "huge.ulg"
    with path.open("wb") as stream:
        stream.truncate(5 << 30)  # sparse
    with pytest.raises(LogTooLargeError, match="at most 1073741824 bytes"):
        read_log(path)
    with pytest.raises(LogTooLargeError):
        read_log(written(tmp_path, b"time,velocity_z\n0,1\n"), max_bytes=5)


def test_paths(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_log(tmp_path / "nothing.ulg")
    with pytest.raises(InputError, match="a directory"):
        read_log(tmp_path)
    with pytest.raises(InputError, match=r"can be opened|null"):
        read_log("a\x00b")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        read_log(tmp_path / "pipe")
    with pytest.raises(InputError):
        read_log("x" * 5000)


def test_permission(tmp_path):
    path = written(tmp_path, b"time,velocity_z\n0,1\n")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(InputError, match="permission"):
        read_log(path)


def test_file_names_with_glob_characters(tmp_path):
    import polars as pl

    frame = pl.DataFrame({"time": [0.0, 0.1], "velocity_z": [1.0, 2.0]})
    frame.write_csv(tmp_path / "a[1]*?.csv")
    frame.write_parquet(tmp_path / "a[1]*?.parquet")
    for name in ("a[1]*?.csv", "a[1]*?.parquet"):
        assert read_log(tmp_path / name).channels["velocity_z"].values.tolist() == [1.0, 2.0]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_file_names_that_are_not_text(tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.csv")
    Path(path).write_text("time,velocity_z\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r"Expected a path in UTF-8; received b'.*\\x[0-9a-f]{2}"):
        read_log(path)


def test_advice():
    assert any("SDLOG_PROFILE" in sentence for sentence in logging_advice())
    assert "bit 4 (high rate)" in logging_advice("ulog", "input")[0]
    assert "10 Hz." in logging_advice("ulog", "velocity_z")[0]
    assert logging_advice("ulog", "nonsense") == ()
    assert logging_advice("csv")
    assert "'input'" in logging_advice("parquet", "input")[0]
    assert "vehicle_thrust_setpoint" in logging_advice("mcap", "input")[0]
    with pytest.raises(UsageError, match="'gzip'"):
        logging_advice("gzip")


def test_starts_fast():
    import subprocess
    import sys

    code = "import sys, eivor.logs; print([m for m in ('polars', 'pyulog', 'pandas') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
