"""`eivor study`: the table, JSON, exit codes, and how an interrupted study goes on."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

STUDY = """
name = "a [red]small[/red] one"
runs = 30
seed = 3
intervals = true

[scenario]
kind = "difference_equation"
output_coefficients = [0.5]
input_coefficients = [2.0]
samples = 200
excitation = { kind = "white" }
noise.output = { kind = "white", std = 0.3 }
noise.input = { kind = "white", std = 0.3 }

[[methods]]
name = "extended_iv"
lags = [2, 6]

[[methods]]
name = "generalized_iv"
lags = [0, 5]
"""
BLIND = """
[[methods]]
name = "generalized_iv"
label = "blind"
lags = [0, 5]
known_noise = []
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.mark.thorough
def test_table(eivor, file):
    run = eivor("study", file, "--workers", 1)
    assert (run.code, run.err) == (0, "")
    assert "a [red]small[/red] one: 30 trials, seed 3" in run.out
    assert "truth: output_lag_1 = 0.5, input_lag_1 = 2" in run.out
    assert re.search(r"extended_iv +30 weak", run.out)
    assert re.search(r"output_lag_1 +0\.\d+ ± \d", run.out)
    assert re.search(r"extended_iv, output_lag_1 +\d+\.\d % +\d+\.\d to \d+\.\d %", run.out)
    assert "…" not in run.out
    assert run.out.count("together") == 2
    assert "…" not in run.out
    assert pl.read_parquet("small-study/trials.parquet").height == 30
    assert eivor("study", file) == run


@pytest.mark.thorough
def test_json(eivor, file, tmp_path):
    run = eivor("study", file, "--json", "-", "--out", tmp_path / "x", "--workers", 1)
    document = json.loads(run.out)
    assert document["schema"] == "eivor.study/1"
    assert document["study"]["runs"] == 30
    giv = document["methods"][1]
    assert (giv["label"], giv["trials"], giv["failed"], giv["weak"]) == ("generalized_iv", 30, 0, 0)
    table = pl.read_parquet(document["trials"])
    assert giv["parameters"]["input_lag_1"]["mean"] == pytest.approx(
        table["generalized_iv.input_lag_1"].mean()
    )
    assert giv["parameters"]["input_lag_1"]["coverage"]["count"] == 30
    again = eivor("study", file, "--json", tmp_path / "found.json", "--out", tmp_path / "x")
    assert json.loads((tmp_path / "found.json").read_text(encoding="utf-8")) == document
    assert "together" in again.out


@pytest.mark.long
def test_figures_lie_beside_the_trials(eivor, file):
    run = eivor("study", file, "--workers", 1, "--figures")
    assert (run.code, run.err) == (0, "")
    folder = Path("small-study")
    assert {path.name for path in folder.glob("*.*") if path.suffix in {".png", ".svg"}} == {
        *("nrmse.png", "nrmse.svg", "coverage.png", "coverage.svg")
    }
    assert "a [red]small[/red] one" in (folder / "coverage.svg").read_text(encoding="utf-8")
    # The study goes on in a folder with pictures; without intervals there is no coverage to draw.
    assert eivor("study", file, "--workers", 1, "--runs", 31).code == 0
    file.write_text(STUDY.replace("intervals = true", ""), encoding="utf-8")
    assert eivor("study", file, "--workers", 1, "--out", "plain", "--figures").code == 0
    assert {path.stem for path in Path("plain").glob("*.png")} == {"nrmse"}


@pytest.mark.thorough
def test_failures_are_told(eivor, file):
    file.write_text(STUDY + BLIND, encoding="utf-8")
    run = eivor("study", file, "--workers", 1)
    assert run.code == 0
    assert re.search(r"blind +30 failed", run.out)
    text = " ".join(run.out.split())
    assert (
        "blind failed in 30 of 30 trials; 0: MissingNoiseError: Expected a declared noise of channel" in text
    )
    before, blind = STUDY.split("[[methods]]", 1)[0], BLIND
    file.write_text(before + blind, encoding="utf-8")
    assert eivor("study", file, "--workers", 1, "--out", "other").code == 1


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--runs", 0], 2, "Expected runs from 1"),
        (["--runs", -3], 2, "received -3"),
        (["--workers", 0], 2, "Expected one worker or more; received 0"),
        (["--workers", 2, "--dask", "tcp://x:1"], 2, "Expected --workers or --dask; received both"),
        (["--dask", "x"], 2, "the address of a Dask scheduler"),
        (["--json", "absent/x.json"], 1, "whose folder 'absent' does not exist"),
        (["--out", "small.toml"], 2, "which would replace"),
        (["--out", "small.toml/x"], 1, "Not a directory"),
    ],
)
def test_wrong_usage(eivor, file, arguments, code, message):
    run = eivor("study", file, *arguments)
    assert (run.code, run.out) == (code, "")
    assert message in run.err


def test_files_that_are_none(eivor, file):
    assert eivor("study", "absent.toml").code == 1
    file.write_text(STUDY.replace("runs", "rusn"), encoding="utf-8")
    run = eivor("study", file)
    assert run.code == 1
    assert "Is 'rusn' meant to be it?" in run.err


@pytest.mark.thorough
def test_another_study_in_the_folder(eivor, file):
    eivor("study", file, "--workers", 1)
    file.write_text(STUDY.replace("seed = 3", "seed = 4"), encoding="utf-8")
    run = eivor("study", file)
    assert run.code == 2
    assert "Choose another folder with --out" in run.err


@pytest.mark.thorough
def test_more_runs_go_on(eivor, file):
    eivor("study", file, "--workers", 1)
    assert eivor("study", file, "--runs", 31, "--workers", 1).code == 0
    assert pl.read_parquet("small-study/trials.parquet").height == 31
    assert "at least 31 runs" in eivor("study", file).err


@pytest.mark.thorough
def test_help_is_quick(shell):
    run = shell("study", "--help")
    assert run.code == 0
    assert "--dask" in run.out


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_on_a_terminal(file, tmp_path, workers):
    """Ctrl-C reaches every process of the terminal; complete shards stay and the same command goes on."""
    file.write_text(STUDY.replace("runs = 30", "runs = 2000"), encoding="utf-8")
    command = [sys.executable, "-c", "from eivor.cli.main import run; run()", "study", str(file)]
    command += ["--workers", str(workers)]
    screen, stream = pty.openpty()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=stream, cwd=tmp_path, start_new_session=True
    )
    os.close(stream)
    shards = tmp_path / "small-study" / "shards"
    while len(list(shards.glob("0*.parquet"))) < 2:
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    displayed = b""
    while True:
        try:
            part = os.read(screen, 65536)
        except OSError:  # the terminal ends with its last process
            break
        if not part:
            break
        displayed += part
    os.close(screen)
    out, _ = process.communicate()
    assert process.returncode == 130
    assert out == b""
    text = displayed.decode()
    assert "/2000" in text
    assert "eivor: interrupted" in text
    assert "Run the same command again to go on" in text
    assert "Traceback" not in text
    kept = len(list(shards.glob("0*.parquet")))
    assert 2 <= kept < 80
    assert len(list(shards.iterdir())) == kept
