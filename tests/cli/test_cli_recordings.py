"""The command line on real recordings that nobody here made."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from coarse_search import coarse
from eivor.logs.read import readable_formats

CLEAN = (
    "B2_circle_fast_rep1",
    "B3_figure8_medium_rep1",
    "B5_helix_fast_rep1",
    "B9_trefoil_fast_rep14",
    "B9_trefoil_slow_rep13",
)


def _document(run):
    document: dict[str, Any] = json.loads(run.out)["motions"]["vertical"]
    return document


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_of_a_hover_the_hover_input_alone_is_identified(eivor, recordings):
    run = eivor("identify", recordings / "px4" / "battery_brownout.ulg", "--for", "hover,friction")
    assert run.code == 3
    assert "MPC_THR_HOVER 0.58 -> 0.5" in run.out
    assert "Not identified" in run.out
    assert "--card" in run.out
    document = json.loads(eivor("identify", recordings / "px4" / "battery_brownout.ulg", "--json", "-").out)
    assert document["identified"] == ["hover_input"]
    card = eivor("identify", recordings / "px4" / "battery_brownout.ulg", "--card")
    assert "SDLOG_PROFILE" in card.out


@pytest.mark.thorough
def test_a_given_lag_tells_the_friction_of_a_flight(eivor, recordings):
    """Alone it is not known to a quarter of a second: with 65 ms, to 15 ms, the friction has an interval."""
    path = recordings / "nanobench" / "B9_trefoil_fast_rep14.csv"
    given = _document(eivor("identify", path, "--lag", "65:15", "--json", "-"))
    friction = given["parameters"]["viscous_friction"]
    assert friction["verdict"] == "weak"
    assert 0.15 < friction["value"] < 0.7
    # by its random part it is above 0.1; what is systematic takes a part of that, not its sign
    ((low, _),), ((profile, _),) = (friction["sets"][name] for name in ("wald", "profile"))
    assert min(low, profile) > 0.1
    assert 0.0 < friction["interval"][0] < profile
    low, high = given["given_lag"]["alone_interval"]
    assert high - low > 3 * 2 * 0.015
    low, high = _document(eivor("identify", path, "--json", "-"))["derived"]["effective_lag"]["interval"]
    assert high is None or high - low > 0.2  # longer than any that is searched


@pytest.mark.thorough
def test_a_hover_input_that_is_not_identified_is_not_held_against_the_autopilot_s(eivor, recordings):
    """Nor is the time after a crash a flight, where motors idle and the land detector says that it flies."""
    path = recordings / "px4" / "ekf_failure.ulg"
    run = eivor("identify", path, "--json", "-")
    document = _document(run)
    assert run.code == 3
    assert document["window"][1] < 68.0
    assert document["parameters"]["viscous_friction"]["verdict"] == "refused"
    assert 0.10 < document["derived"]["hover_input"]["value"] < 0.14
    # its interval is wider than ±5 %: it is not held against the autopilot's parameter
    hover = document["derived"]["hover_input"]
    low, high = hover["interval"]
    assert (high - low) / 2.0 > 0.05 * hover["value"]
    assert hover["verdict"] == "refused"
    assert "it needs ±5%" in hover["reasons"][0]
    sentence = {finding["name"]: finding["message"] for finding in document["findings"]}
    assert "hover_estimate" not in sentence
    assert "lower limit, 0.15 (MPC_THR_HOVER - HTE_THR_RANGE)" in sentence["hover_estimate_at_limit"]
    with coarse():
        inspected = eivor("inspect", path)
    assert inspected.code == 0
    assert "MPC_THR_HOVER = 0.35" in inspected.out
    assert "land detector" in inspected.out


@pytest.mark.thorough
def test_thrust_that_a_pilot_sets_is_its_own_instrument(eivor, recordings):
    with coarse():
        document = _document(
            eivor("identify", f"{recordings / 'px4' / 'ekf_failure.ulg'}@4:61", "--json", "-")
        )
    assert document["instruments"] == "input"
    assert any(item["name"] == "open_loop_input" for item in document["findings"])
    assert document["diagnostics"]["first_stage_F_viscous_friction"] > 10.0
    assert not any("feedback" in reason for reason in document["reasons"])


@pytest.mark.thorough
def test_a_flight_that_never_takes_off(eivor, recordings, tmp_path):
    run = eivor(
        "identify", recordings / "nanobench" / "B6_linear_ramp_rep1.csv", "--figure", tmp_path / "x.png"
    )
    assert run.code == 3
    assert "never takes off" in run.out


def test_vehicles_of_different_maps_are_not_pooled(eivor, recordings):
    run = eivor(
        "identify", recordings / "px4" / "ekf_failure.ulg", recordings / "nanobench" / f"{CLEAN[0]}.csv"
    )
    assert run.code == 2
    assert "one vehicle" in run.err


@pytest.mark.thorough
def test_a_log_of_ardupilot(eivor, recordings):
    log = recordings / "ardupilot" / "log_0036_mechanical_failure.bin"
    run = eivor("inspect", log)
    assert run.code == 0
    assert "NKF1.VD" in run.out
    run = eivor("identify", log)
    assert run.code == 3  # its lag by turning is known to 21 ms, where 20 are identified
    output = " ".join(run.out.split())
    assert "The command is logged every 100 ms and was issued every 2.5 ms" in output
    assert "log command and acceleration at 50 Hz or more" in output


@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("px4/sample_appended_multiple.ulg", "Never in the air"),
        ("nanobench/B2_circle_medium_rep3.csv", "overflowed"),
    ],
)
def test_what_an_inspection_finds(eivor, recordings, log, words):
    run = eivor("inspect", recordings / log)
    assert (run.code, words in run.out) == (0, True)


@pytest.mark.thorough
def test_a_reader_that_goes_away_is_no_error_message(tmp_path):
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' identify --example | true"
    run = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert run.stderr == ""


@pytest.mark.thorough
def test_help_names_every_format_and_replaces_letters_that_an_encoding_lacks(shell):
    help_text = shell("identify", "--help", encoding="ascii", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert "+- Options ---" in help_text.out
    words = " ".join(help_text.out.replace("|", " ").split())
    assert [item.label for item in readable_formats() if item.label not in words] == []
    error = shell("identify", "fläche τ.csv", encoding="ascii", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert "'fl?che ?.csv', which does not exist" in error.err


@pytest.mark.thorough
@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", "--example"),
        ("identify", "--example", "--json", "-"),
        ("example", "list"),
        ("--help",),
        ("--version",),
    ],
)
def test_a_full_disk_behind_standard_output_is_one_message(arguments):
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        run = subprocess.run(
            [sys.executable, "-c", "from eivor.cli.main import run; run()", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert run.returncode == 1
    assert run.stderr.startswith("eivor: Expected a standard output that can be written to; received one for")
    assert "No space left on device" in run.stderr
    assert run.stderr.count("\n") == 1


@pytest.mark.thorough
@pytest.mark.parametrize(("stream", "code"), [(1, 1), (2, 0)])
def test_a_stream_that_is_closed(stream, code):
    """Without standard output the numbers cannot be printed; without standard error nothing is missing."""
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' identify --example {stream}>&-"
    run = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert run.returncode == code
    if stream == 1:
        assert "received one that is closed" in run.stderr
    else:
        assert "viscous friction" in run.stdout
    assert "mistake" not in run.stderr


#: Each is loaded with the part of NumPy that it belongs to.
WITHIN = ("numpy.f2py.crackfortran", "numpy.testing._private.utils")


def printed(code):
    """What a fresh interpreter prints."""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_scipy_does_not_load_them():
    code = (
        "import sys\n"
        "from eivor.__main__ import load_late\n"
        "load_late()\n"
        "import scipy.linalg, scipy.special\n"
        f"print([name for name in {WITHIN!r} if name in sys.modules])"
    )
    assert printed(code) == "[]"
