"""The README's examples run, and say what they say."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from importlib import resources
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of a language, without a list's indentation."""
    match = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, flags=re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", body, flags=re.MULTILINE) for indent, body in match]


@pytest.mark.usefixtures("unchecked_shapes")  # a reader's run checks none
@pytest.mark.parametrize("number", range(len(blocks(README, "python"))))
def test_python_example(number, tmp_path, monkeypatch, capsys):
    """Each block runs on its own; the example flight stands in for the reader's log."""
    monkeypatch.chdir(tmp_path)
    example = resources.files("eivor.data") / "example_flight.parquet"
    shutil.copy(str(example), tmp_path / "flight.ulg")
    scope: dict[str, object] = {}
    exec(compile(blocks(README, "python")[number], f"README.md, block {number + 1}", "exec"), scope)  # noqa: S102
    printed = capsys.readouterr().out
    assert "viscous_friction" in printed
    if number == 0:
        assert scope["fit"].verdict.status.value == "identified"
    else:
        claims = re.findall(r"input_gain in \[([\d.]+), ([\d.]+)\]", blocks(README, "python")[number])
        for fit, claim in zip((scope["biased"], scope["fit"]), claims, strict=True):
            assert fit.interval("input_gain") == pytest.approx([float(end) for end in claim], abs=6e-5)
        assert not within(0.021, scope["biased"].interval("input_gain"))
        assert scope["biased"].status.value == "weak"
        assert scope["fit"].status.value == "identified"
        (match,) = re.findall(r"reasons\[0\].sentence  # (.*), \.\.\.", blocks(README, "python")[number])
        assert scope["biased"].reasons[0].sentence.startswith(match)
        truth = {"viscous_friction": 0.293, "input_gain": 0.021}
        code = blocks(README, "python")[number]
        assert all(f"{value} * " in code for value in truth.values())
        assert all(within(value, scope["fit"].interval(name)) for name, value in truth.items())


def within(value: float, interval: tuple[float, float]) -> bool:
    return interval[0] <= value <= interval[1]


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def test_sample_output_is_what_is_printed():
    """The words are the same; the last digit of a number may differ from machine to machine."""
    run = subprocess.run(
        [sys.executable, "-c", "from eivor.cli.main import run; run()", "identify", "--example"],
        capture_output=True,
        text=True,
        check=True,
        env={"COLUMNS": "100", "PATH": "", "NO_COLOR": "1"},
    )
    block = blocks(README, "text")[0]
    number = r"-?\d[\d.]*(e-?\d+)?"
    assert re.sub(number, "#", block).split() == re.sub(number, "#", run.stdout).split()
    assert numbers(block) == pytest.approx(numbers(run.stdout), rel=1e-2, abs=2e-3)


def test_intervals_of_the_sample_output_hold_the_truth():
    """What the README prints beside a truth that it states."""
    match = re.search(r"a friction of ([\d.]+) 1/s, a lag of ([\d.]+) ms", README)
    assert match is not None
    block = blocks(README, "text")[0]
    for row, truth in zip(("viscous friction", "actuator lag"), match.groups(), strict=True):
        interval = re.search(rf"^{row}.*\[(.+), (.+)\]", block, flags=re.MULTILINE)
        assert interval is not None
        assert within(float(truth), (float(interval[1]), float(interval[2]))), row


def test_channel_maps_in_the_pages_are_valid():
    from eivor.logs.channel_map import parse_channel_map

    pages = [page for page in PAGES if page.parent != ROOT / "docs" / "studies"]
    vehicles = ROOT / "docs" / "rigid-body.md"
    maps = [
        block
        for page in pages
        if page != vehicles
        for block in blocks(page.read_text(encoding="utf-8"), "toml")
    ]
    assert len(maps) >= 2
    for block in maps:
        assert parse_channel_map(block, "the documentation").rules


def test_vehicle_files_in_the_pages_are_valid(tmp_path):
    from eivor.motions.rigid_body.vehicle import load_vehicle

    page = (ROOT / "docs" / "rigid-body.md").read_text(encoding="utf-8")
    result = blocks(page, "toml")
    assert result
    for block in result:
        file = tmp_path / "vehicle.toml"
        file.write_text(block, encoding="utf-8")
        assert len(load_vehicle(file).spins) == 4


def test_the_study_in_the_pages_is_valid(tmp_path):
    from eivor.lab.scenario_files import read_study

    page = (ROOT / "docs" / "studies" / "scenarios.md").read_text(encoding="utf-8")
    page = page.partition("## Running a study")[2]
    path = tmp_path / "study.toml"
    path.write_text(blocks(page, "toml")[0], encoding="utf-8")
    assert read_study(path).runs == 200


def test_the_citation_is_of_this_version():
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"cff-version", "message", "title", "authors"} <= set(cited)  # what the format asks for
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    assert cited["authors"] == project["authors"]
    (paper,) = cited["references"]
    assert paper["title"] in words((ROOT / "docs" / "paper.md").read_text(encoding="utf-8"))


def words(text: str) -> str:
    """Text in one line, without emphasis."""
    return " ".join(text.replace("*", "").split())


def test_first_command_is_one_line_each():
    """`.ci/run` takes its set-up and its tests from these lines."""
    commands = [line for line in README.splitlines() if line.startswith("python3 -m venv .venv && ")]
    assert [line.rpartition(" && ")[2] for line in commands] == [
        ".venv/bin/eivor identify --example",
        ".venv/bin/python -m pytest",
    ]
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert commands[1] in contributing
    assert commands[0] in (ROOT / "docs" / "getting-started.md").read_text(encoding="utf-8")


def test_links_between_files_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            made = target == "options.schema.json"  # by docs/hooks.py
            assert made or (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_channel_and_every_unit_is_documented():
    from eivor.signals.channels import BUILT_IN

    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    section = page.partition("## Channels")[2].partition("## PX4")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    for channel in BUILT_IN:
        row = [line for line in rows if f"`{channel.name}`" in line.split("|")[1]]
        assert len(row) == 1, channel
        assert channel.unit in row[0].split("|")[2], channel


def test_every_error_is_an_eivor_error_or_a_warning():
    from eivor import errors

    here = [kind for kind in vars(errors).values() if getattr(kind, "__module__", "") == errors.__name__]
    kinds = [kind for kind in here if isinstance(kind, type)]
    assert len(kinds) > 10
    assert all(issubclass(kind, errors.EivorError | Warning) for kind in kinds)
