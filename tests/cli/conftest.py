"""The command line as a user meets it: called in this process, or in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import polars
import pytest
import typer

from coarse_search import identified_once
from eivor.cli.main import app

COMMAND = typer.main.get_command(app)  # as each call of `app` makes it


@dataclass(frozen=True)
class Run:
    code: int
    out: str
    err: str


Caller = Callable[..., Run]


@pytest.fixture(autouse=True)
def results_once():
    """A flight of one test is that of another: commands identify it once."""
    with identified_once():
        yield


@pytest.fixture
def eivor(capsys, monkeypatch):
    """Call in this process."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.delenv("EIVOR_DEBUG", raising=False)

    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            COMMAND([str(argument) for argument in arguments], prog_name="eivor")
        captured = capsys.readouterr()
        return Run(int(left.value.code or 0), captured.out, captured.err)

    return call


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
        return Run(done.returncode, done.stdout, done.stderr)

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
