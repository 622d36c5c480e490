"""Files are whole or not there."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import pytest

import eivor
from eivor.atomic_file import (
    ABANDONED_S,
    PREFIX,
    SUFFIX,
    atomic_write,
    check_writable,
    remove_abandoned,
    write_atomically,
)

PACKAGE = Path(eivor.__file__).parent


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def half_written(path: Path, error: BaseException) -> None:
    with atomic_write(path) as file:
        file.write(b"half")
        raise error


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    write_atomically(path, "Größe")
    assert path.read_text(encoding="utf-8") == "Größe"
    assert names(tmp_path) == ["x"]


@pytest.mark.parametrize("error", [OSError(28, "full"), KeyboardInterrupt(), ValueError("x")])
def test_an_error_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "x"
    for before in ([], ["x"]):
        with pytest.raises(type(error)):
            half_written(path, error)
        assert names(tmp_path) == before
        path.write_bytes(b"old")
    assert path.read_bytes() == b"old"


def test_permissions_are_those_of_the_user_or_of_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "x"
    before = os.umask(0o027)
    try:
        write_atomically(path, b"")
        assert path.stat().st_mode & 0o777 == 0o640
        path.chmod(0o606)
        write_atomically(path, b"")
        assert path.stat().st_mode & 0o777 == 0o606
    finally:
        os.umask(before)


def test_what_is_no_file_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        check_writable(pipe)
        write_atomically(pipe, b"through")
        assert os.read(reader, 100) == b"through"
        assert pipe.is_fifo()
    finally:
        os.close(reader)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(Path("/dev/full"), b"x")
    with pytest.raises(IsADirectoryError):
        write_atomically(tmp_path, b"x")


def test_a_file_that_is_protected_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    path.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # for the superuser nothing is protected
    for attempt in (lambda: write_atomically(path, b"new"), lambda: check_writable(path)):
        with pytest.raises(PermissionError):
            attempt()
    assert path.read_bytes() == b"old"


def test_a_place_is_tried_without_a_trace(tmp_path: Path) -> None:
    check_writable(tmp_path / "x")
    assert names(tmp_path) == []
    with pytest.raises(FileNotFoundError):
        check_writable(tmp_path / "no" / "x")
    with pytest.raises(OSError, match="too long"):
        check_writable(tmp_path / ("x" * 300))


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    old, young, other = (tmp_path / name for name in (f"{PREFIX}1{SUFFIX}", f"{PREFIX}2{SUFFIX}", ".mine"))
    for path in (old, young, other):
        path.touch()
    past = time.time() - 2.0 * ABANDONED_S
    for path in (old, other):
        os.utime(path, (past, past))
    remove_abandoned(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([young, other])


def test_nothing_else_in_the_package_writes_files() -> None:
    """Other ways to write a file would leave half of one behind."""
    formulas = re.compile(
        r"\.write_(text|bytes)\(|\.(write_csv|write_parquet|savefig)\((?!\s*(?:file|buffer)\b|\))"
        r"|mkstemp|open\([^)]*[\"'][wax]"
    )
    results = {
        str(file.relative_to(PACKAGE))
        for file in PACKAGE.rglob("*.py")
        if formulas.search(file.read_text(encoding="utf-8"))
    }
    assert results - {"logs/common.py"} == {"atomic_file.py"}  # a copy of a pipe, in a folder that goes again
