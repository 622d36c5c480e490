"""`eivor simulate` as a user meets it."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from importlib import resources

import numpy as np
import polars as pl
import pytest

import eivor as ev

FLIGHT = """
viscous_friction = 0.3
input_gain = 20.0
rate_hz = 100.0
samples = 9000
route = "dynamics"
[control]
velocity_gain = 0.15
velocity_integral_gain = 0.05
[excitation]
kind = "filtered_white"
std = 1.0
low_hz = 0.05
high_hz = 0.5
[noise.velocity_z]
kind = "white"
std = 0.02
[noise.acceleration_z]
kind = "fractional"
order = -0.3
std = 0.2
[disturbance]
kind = "dryden"
std = 0.05
length_m = 5.0
airspeed_mps = 3.0
"""


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_log_reads_back_as_simulated(eivor, tmp_path):
    run = eivor("simulate", "rich", "-o", "rich.parquet", "--seed", 5, "--truth", "rich.json")
    assert (run.code, run.err) == (0, "")
    assert run.out == "rich.parquet: 4000 samples at 5 Hz, 800 s\n"
    signals = ev.simulate(ev.shipped_scenario("rich"), np.random.default_rng(5)).signals
    log = ev.read_log(tmp_path / "rich.parquet")
    assert set(log.channels) == {"velocity_z", "acceleration_z", "input"}
    for name in ("acceleration_z", "velocity_z", "input"):
        np.testing.assert_array_equal(log.channel(name).values, signals.channel(name))
    assert log.channel("input").held
    assert not log.channel("velocity_z").held
    truth = json.loads((tmp_path / "rich.json").read_text(encoding="utf-8"))
    assert (truth["viscous_friction"], truth["input_gain"], truth["seed"]) == (0.293, 0.021, 5)
    assert truth["noise"]["velocity_z"] == {"std": signals.noise["velocity_z"].std, "order": -0.4}
    assert truth["disturbance"]["route"] == "equation"


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")  # hundreds of steps of the same shapes
def test_a_whole_vehicle_flies(eivor, tmp_path):
    """All its axes are logged, on the clocks that the file says; the truth has what each axis can tell."""
    shipped = resources.files("eivor.lab").joinpath("scenario_flights", "quadrotor.toml")
    text = shipped.read_text(encoding="utf-8").replace("duration = 40.0", "duration = 0.5")
    text = text.replace("high_hz = 0.4", "high_hz = 4.0")
    (tmp_path / "all.toml").write_text(text, encoding="utf-8")
    run = eivor("simulate", "all.toml", "-o", "all.parquet", "--truth", "all.json")
    assert (run.code, run.err) == (0, "")
    assert run.out == "all.parquet: 250 samples at 500 Hz, 0.5 s\n"
    log = ev.read_log(tmp_path / "all.parquet")
    names = {"angular_rate_x", "attitude_w", "torque_setpoint_z", "rotor_command_4", "input"}
    assert names <= set(log.channels)
    truth = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
    assert (truth["lag_up"], truth["torque_gains"][0]) == (0.035, pytest.approx(1.39e-5 / 0.0153))
    (tmp_path / "slow.toml").write_text(text + "[logged]\nsetpoint_hz = 50.0\n", encoding="utf-8")
    assert eivor("simulate", "slow.toml", "-o", "slow.parquet").code == 0
    assert ev.read_log(tmp_path / "slow.parquet").channel("input").rate_hz == pytest.approx(50.0)


FLOWN = """
kind = "flight"
viscous_friction = 0.4
trajectory = "multisine"
duration = 20.0
[noise]
kind = "heavy-tailed"
velocity = 0.05
"""
LOST = "gust_rms = 5.0\ngust_correlation = 5.0\nquickness = 0.05\nintegral_share = 0.0"


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
def file(tmp_path, monkeypatch):
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
    assert (document["schema"], document["study"]["runs"]) == ("eivor.study/1", 30)
    giv = document["methods"][1]
    assert (giv["label"], giv["trials"], giv["failed"], giv["weak"]) == ("generalized_iv", 30, 0, 0)
    table = pl.read_parquet(document["trials"])
    mean = table["generalized_iv.input_lag_1"].mean()
    assert giv["parameters"]["input_lag_1"]["mean"] == pytest.approx(mean)
    assert giv["parameters"]["input_lag_1"]["coverage"]["count"] == 30
    again = eivor("study", file, "--json", tmp_path / "found.json", "--out", tmp_path / "x")
    assert json.loads((tmp_path / "found.json").read_text(encoding="utf-8")) == document
    assert "together" in again.out


@pytest.mark.thorough
def test_failures_are_told(eivor, file):
    file.write_text(STUDY + BLIND, encoding="utf-8")
    run = eivor("study", file, "--workers", 1)
    assert run.code == 0
    assert re.search(r"blind +30 failed", run.out)
    text = " ".join(run.out.split())
    assert "blind failed in 30 of 30 trials; 0: MissingNoiseError: Expected a declared noise of chan" in text
    file.write_text(STUDY.split("[[methods]]", 1)[0] + BLIND, encoding="utf-8")
    assert eivor("study", file, "--workers", 1, "--out", "other").code == 1


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_on_a_terminal(file, tmp_path, workers):
    """Ctrl-C reaches every process of the terminal; complete shards stay and the same command goes on."""
    file.write_text(STUDY.replace("runs = 30", "runs = 2000"), encoding="utf-8")
    command = [sys.executable, "-c", "from eivor.cli.main import run; run()", "study", str(file)]
    command += ["--workers", str(workers)]
    screen, stream = pty.openpty()
    streams = {"stdout": subprocess.PIPE, "stderr": stream}
    process = subprocess.Popen(command, **streams, cwd=tmp_path, start_new_session=True)
    os.close(stream)
    shards = tmp_path / "small-study" / "shards"
    while len(list(shards.glob("0*.parquet"))) < 2:
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    displayed = b""
    with contextlib.suppress(OSError):  # the terminal ends with its last process
        while part := os.read(screen, 65536):
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
