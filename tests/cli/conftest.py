"""The command line as a user meets it: called in this process, or in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import resources
from types import SimpleNamespace

import polars
import pytest

from coarse_search import identified_once


@pytest.fixture(autouse=True)
def results_once():
    """A flight of one test is that of another: commands identify it once."""
    with identified_once():
        yield


@pytest.fixture
def eivor(command_line, monkeypatch):
    """Call in this process, in a wider terminal."""
    monkeypatch.setenv("COLUMNS", "100")
    return command_line


@pytest.fixture
def shell(tmp_path):
    """Run in a process of its own, in an empty folder."""

    def call(*arguments, encoding="utf-8", **environment):
        done = subprocess.run(
            [sys.executable, "-c", "from eivor.cli.main import run; run()", *map(str, arguments)],
            capture_output=True,
            encoding=encoding,
            check=False,
            cwd=tmp_path,
            env={**os.environ, **environment},
        )
        return SimpleNamespace(code=done.returncode, out=done.stdout, err=done.stderr)

    return call


@pytest.fixture(scope="session")
def flight():
    """The first 30 s of the example flight, as a table with canonical columns."""
    with resources.as_file(resources.files("eivor.data").joinpath("example_flight.parquet")) as path:
        return polars.read_parquet(path).head(3000)


@pytest.fixture
def log(flight, tmp_path):
    """That table as a CSV file."""
    path = tmp_path / "flight.csv"
    flight.write_csv(path)
    return path
