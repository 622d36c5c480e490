"""`eivor paper`: what it prints and writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from eivor.cli.main import app
from eivor.lab import figures
from eivor.lab.experiments import page_with
from eivor.lab.paper import named_readings, run_paper

PARTS = ("run", "readings", "example 1", "example 2", "errata", "figures")
SMALL = ("paper", "--runs", "3", "--workers", "1")


def eivor(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


@pytest.fixture(scope="module")
def two_readings() -> list[figures.PaperResult]:
    chosen = named_readings(("ratios-of-variances", "white-input"))
    return list(run_paper(chosen, runs=3, workers=1))


def test_tables_have_measured_beside_printed():
    run = eivor(*SMALL, "--readings", "two-lags,ratios-of-std")
    assert run.exit_code == 0, run.output
    assert run.output.count("187.2 ± 119.4") == 2
    assert run.output.count("5.739 ± 2.7") == 2
    assert "none" in run.output  # two delayed inputs have no total least squares solution
    assert "No reading gives the printed tables." in run.output
    assert max(map(len, run.output.splitlines())) <= 80


@pytest.mark.thorough
def test_without_names_there_is_an_overview(two_readings, monkeypatch):
    """The nearest reading in full, every reading in a line; a screen or two, not hundreds of lines."""
    monkeypatch.setattr("eivor.lab.cli.run_paper", lambda *_, **__: iter(two_readings))
    short = eivor(*SMALL)
    assert short.exit_code == 0, short.output
    assert "187.2 ± 119.4" in short.output
    assert short.output.count("example 1: NRMSE") == 1
    for name in ("ratios-of-variances", "white-input"):
        assert f"\n{name} " in short.output
    assert "Every reading's tables: eivor paper --readings all" in short.output
    assert len(short.output.splitlines()) < 60
    full = eivor(*SMALL, "--readings", "all")
    assert full.output.count("example 1: NRMSE") == 2


def test_help_names_the_paper():
    text = " ".join(eivor("paper", "--help").output.replace("│", " ").split())
    assert "D. Ivanov, A. Zhdanov and I. Sandler, Identification of dynamical systems with" in text
    assert "(2024)" in text


@pytest.mark.thorough
def test_json_is_finite_and_complete(two_readings):
    run = eivor(*SMALL, "--readings", "two-lags", "--json", "-")
    document = json.loads(run.output)
    assert document["schema"] == "eivor.paper/1"
    example = document["readings"][0]["examples"][1]
    assert example["methods"]["generalized_iv"]["printed"]["viscous_friction"] == {"mean": 5.74, "sd": 2.7}
    assert example["methods"]["extended_iv_tls"]["failed"] == 3
    assert example["methods"]["extended_iv_tls"]["nrmse"]["together"]["mean"] is None
    assert document["readings"][0]["choices"]["lags"] == 2


@pytest.mark.thorough
def test_weak_instruments_are_told(two_readings):
    run = eivor(*SMALL, "--readings", "white-input")
    text = "Weak instruments (first-stage F below 10): of IV in 3 of 3 runs."
    assert " ".join(run.output.split()).count(text) == 2
    assert max(map(len, run.output.splitlines())) <= 80
    assert text not in " ".join(eivor(*SMALL, "--readings", "ratios-of-variances").output.split())
    document = figures.paper_document(two_readings, seconds=1.0)
    counts = [
        item["methods"]["extended_iv"]["weak"] for part in document["readings"] for item in part["examples"]
    ]
    assert counts == [0, 0, 3, 3]
    page = figures.page_parts(two_readings)["example 1"]
    assert page.count("Weak instruments (first-stage F below 10), in runs: `white-input` (3 of 3).") == 1


@pytest.mark.thorough
def test_figures_are_written_in_both_formats(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("eivor.lab.figures.save_figure", lambda _, path: path.touch())
    run = eivor(*SMALL, "--readings", "ratios-of-std", "--out", str(tmp_path / "new" / "folder"))
    assert run.exit_code == 0, run.output
    written = {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    assert written == {f"figure-{number}.{ending}" for number in range(2, 9) for ending in ("svg", "png")}


@pytest.mark.thorough
def test_page_is_filled_between_its_marks(tmp_path: Path, two_readings):
    page = (
        "Before.\n"
        + "\n".join(f"<!-- generated: {n} -->\nold\n<!-- end: {n} -->" for n in PARTS)
        + "\nAfter.\n"
    )
    filled = page_with(page, figures.page_parts(two_readings))
    assert filled.startswith("Before.\n")
    assert filled.endswith("\nAfter.\n")
    assert "old" not in filled
    assert filled.count("| `ratios-of-variances` |") == 1 + 2 * 3
    assert page_with(filled, figures.page_parts(two_readings)) == filled
    file = tmp_path / "page.md"
    file.write_text("no marks\n", encoding="utf-8")
    run = eivor(*SMALL, "--readings", "two-lags", "--page", str(file))
    assert run.exit_code == 1
    assert file.read_text(encoding="utf-8") == "no marks\n"


def test_the_nearest_reading_is_one_that_the_text_allows(two_readings):
    assert figures.nearest(two_readings) == "ratios-of-variances"


def test_readings_are_listed():
    run = eivor("paper", "--list")
    assert run.exit_code == 0
    assert "central-10-lags" in run.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--runs", "1"), "two runs or more"),
        (("--readings", "none-such"), "readings out of"),
        (("--workers", "-1"), "workers of zero or more"),
        (("--json", "/nowhere/at/all.json"), "does not exist"),
    ],
)
def test_wrong_usage_is_told_before_anything_runs(arguments, message, monkeypatch):
    monkeypatch.setattr("eivor.lab.cli.run_paper", None)
    run = eivor("paper", *arguments)
    assert run.exit_code in (1, 2)
    assert message in run.output


def test_a_folder_that_is_a_file_is_told(tmp_path: Path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    run = eivor(*SMALL, "--out", str(tmp_path / "file"))
    assert run.exit_code == 1
    assert "a folder for the figures" in run.output
