"""`eivor export` as it is called."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import polars
import polars as pl
import pytest

import eivor as ev
from coarse_search import full
from exports.documents import document, refused, written
from planning.test_plan import planned as plan_of

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def test_what_is_not_identified_leaves_with_code_3(eivor, tmp_path):
    fit, file = written(refused(document(), "viscous_friction"), tmp_path), tmp_path / "model.json"
    run = eivor("export", fit, "--to", "statespace", "-o", file)
    assert run.code == 3
    assert "--prior viscous_friction=VALUE:STD" in run.err
    assert not file.exists()
    given = eivor("export", fit, "--to", "statespace", "--prior", "viscous_friction=0.3:0.1", "-o", file)
    assert given.code == 0
    assert json.loads(file.read_text())["numbers"]["viscous_friction"]["source"] == "given"


def test_draws_are_a_table(eivor, tmp_path):
    fit, file = written(document(), tmp_path), tmp_path / "draws.parquet"
    assert eivor("export", fit, "--draws", 50, "--mass", "1.53:0.02", "-o", file).code == 0
    table = pl.read_parquet(file)
    assert table.columns == ["viscous_friction", "input_gain", "actuator_lag", "delay", "mass"]
    assert table.height == 50
    assert table["mass"].std() == pytest.approx(0.02, rel=0.3)
    partly = written(refused(document(), "viscous_friction"), tmp_path)
    run = eivor("export", partly, "--draws", 50, "-o", file)
    assert run.code == 3
    assert "viscous_friction" in run.err
    assert pl.read_parquet(file)["input_gain"].to_list() == table["input_gain"].to_list()


@pytest.mark.thorough
def test_json_has_the_documented_keys(eivor, log, tmp_path):
    run = eivor("inspect", f"{log}@5:20", "--json", "-")
    document = json.loads(run.out)
    described = (
        (Path(__file__).parents[2] / "docs" / "json.md").read_text().partition("## `eivor.inspect/1`")[2]
    )
    assert document["schema"] == "eivor.inspect/1"
    assert all(f"| `{key}` |" in described for key in document)
    assert all(f"`{key}`" in described for channel in document["channels"] for key in channel)
    assert document["airborne"]["used"] == [pytest.approx([5.0, 20.0], abs=0.02)]
    assert eivor("inspect", log, "--json", tmp_path / "x.json").code == 0
    assert json.loads((tmp_path / "x.json").read_text())["verdict"]


def test_the_example_is_read_with_what_its_file_says(eivor):
    document = json.loads(eivor("inspect", "--example", "--json", "-").out)
    assert [finding["name"] for finding in document["findings"]] == []


def test_a_log_that_identify_cannot_use_is_inspected(eivor, flight, tmp_path):
    path = tmp_path / "blind.csv"
    flight.drop("velocity_z", "position_z").write_csv(path)
    run = eivor("inspect", path)
    assert run.code == 0
    assert "velocity_z (needed)" in run.out
    assert "cannot begin" in run.out
    assert "Add a column 'velocity_z'" in run.out
    assert json.loads(eivor("inspect", path, "--json", "-").out)["verdict"] == "unusable"


@pytest.mark.thorough
def test_dirt_is_counted(eivor, flight, tmp_path):
    path = tmp_path / "dirty.csv"
    table = polars.concat([flight.head(1000), flight.slice(990, 10), flight.slice(1300, 1700)])
    table.write_csv(path)
    document = json.loads(eivor("inspect", path, "--json", "-").out)
    velocity = next(channel for channel in document["channels"] if channel["name"] == "velocity_z")
    assert velocity["duplicated_stamps"] + velocity["backward_stamps"] == 10
    assert len(velocity["gaps"]) == 1
    assert "1 gap of 3" in eivor("inspect", path).out


@pytest.mark.thorough
@pytest.mark.parametrize(
    "arguments",
    [
        ("--example",),
        ("--example", "--window", "0:12"),
        ("LOG", "--max-tilt", "4"),
        ("LOG", "--input", "rotor_command_1"),
        ("LOG", "--input-map", "linear"),
        ("LOG@0:14", "--max-tilt", "4", "--input-map", "power:2"),
    ],
)
def test_it_foretells_what_identify_says(eivor, log, arguments):
    """With the same arguments."""
    typed = [argument.replace("LOG", str(log)) for argument in arguments]
    foretold = json.loads(eivor("inspect", *typed, "--json", "-").out)
    sentence = json.loads(eivor("identify", *typed, "--json", "-").out)["motions"]["vertical"]
    assert (foretold["verdict"], foretold["reasons"]) == (sentence["verdict"], sentence["reasons"])


@pytest.mark.thorough
def test_a_log_of_several_windows_is_read_once(eivor, log, monkeypatch):
    read: list[Path] = []
    read_log = ev.read_log

    def counted(path, **options):
        read.append(path)
        return read_log(path, **options)

    monkeypatch.setattr("eivor.cli.parsing.read_log", counted)
    document = json.loads(eivor("identify", f"{log}@0:14", f"{log}@14:29", "--json", "-").out)
    assert len(document["provenance"]["logs"]) == 2
    assert read == [log]


@pytest.fixture
def asked(monkeypatch):
    """What the command asks for; it gets a plan without simulations."""
    calls: list[dict[str, Any]] = []

    def made(vehicle, **options):
        calls.append({"vehicle": vehicle, **options})
        return plan_of(options["shape"] or "multisine")

    monkeypatch.setattr("eivor.report.other_results.make_plan", made)
    return calls


def test_every_form_is_written(eivor, asked, tmp_path):
    files = {name: tmp_path / f"flight{ending}" for name, ending in (("csv", ".csv"), ("mavsdk", ".py"))}
    files |= {"rotorpy": tmp_path / "trajectory.py", "qgc": tmp_path / "flight.plan"}
    options = [text for name, path in files.items() for text in (f"--{name}", path)]
    run = eivor("plan", "--for", "friction", "--home", "47.4,8.5", "--json", tmp_path / "plan.json", *options)
    assert run.code == 3  # identified in one of two simulated flights
    assert "identified in 1 of 2" in " ".join(run.out.split())
    assert "is not identified in most" in run.err
    assert all(path.stat().st_size > 500 for path in files.values())
    assert json.loads((tmp_path / "plan.json").read_text())["schema"] == "eivor.plan/1"
    assert asked[0]["shape"] == "steps"  # a mission has levels only


def test_rough_numbers_and_limits_reach_the_plan(eivor, asked):
    limits = ("--height", "2:4", "--speed", "1", "--time", "90", "--tilt", "15", "--acceleration", "2")
    run = eivor("plan", "--hover", "0.4", "--lag", "80", "--gusts", "0.6", *limits, "--json", "-")
    assert json.loads(run.out)["target"] == "friction"
    assert asked[0]["vehicle"] == ev.VehicleGuess(hover_input=0.4, lag_s=0.08, gust_rms=0.6)
    result = asked[0]["limits"]
    assert (result.height_m, result.speed, result.duration_s) == ((2.0, 4.0), 1.0, 90.0)
    assert (result.tilt_deg, result.acceleration) == (15.0, 2.0)


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


PAGE = (Path(__file__).parents[2] / "docs" / "getting-started.md").read_text(encoding="utf-8")
COMMANDS = re.compile(r"^```console\n(.*?)^```(?:\n\n```text\n(.*?)^```)?", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
CLOSE = {"rel": 1e-2, "abs": 2e-3}


def masked(text):
    return NUMBER.sub("#", text).split()


def numbers(text):
    return [float(number) for number in NUMBER.findall(text)]


def same(displayed, lines):
    printed = "\n".join(lines)
    return masked(displayed) == masked(printed) and numbers(displayed) == pytest.approx(
        numbers(printed), **CLOSE
    )


def check(displayed, printed):
    """Every part of what is shown, between lines of three dots, stands in what is printed, in this order."""
    left = [line for line in printed.splitlines() if line.strip()]
    for part in re.split(r"^\.\.\.\n", displayed, flags=re.MULTILINE):
        rows = [line for line in part.splitlines() if line.strip()]
        count = len(rows)
        positions = (
            index for index in range(len(left) - count + 1) if same(part, left[index : index + count])
        )
        position = next(positions, None)
        assert position is not None, f"not printed:\n{part}\nbut\n{printed}"
        left = left[position + count :]


@pytest.mark.thorough
def test_every_command_prints_what_is_shown(eivor, recordings, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    cache.mkdir()
    monkeypatch.setenv("EIVOR_CACHE", str(cache))
    monkeypatch.chdir(tmp_path)
    steps = [(line, item) for block, item in COMMANDS.findall(PAGE) for line in block.splitlines()]
    assert len(steps) == PAGE.count("\n$ ") > 10
    for line, entry in steps:
        fetched = re.fullmatch(r'\$ cp "\$\((eivor example fetch (\w+))\)" \.', line)
        words = shlex.split(fetched[1] if fetched else line.removeprefix("$ "))
        assert words[0] == "eivor"
        if fetched:  # as if it had been downloaded before
            (origin,) = recordings.rglob(f"{fetched[2]}.*[gv]")
            shutil.copy(origin, cache)
        with full():
            ran = eivor(*words[1:])
        if fetched:
            shutil.copy(ran.out.strip(), tmp_path)
        check(entry, ran.out + ran.err)
        if "hover.html" in line:
            assert f"The exit code is {ran.code}," in PAGE
    assert (tmp_path / "hover.html").stat().st_size > 100_000
