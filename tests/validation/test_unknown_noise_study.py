"""The study of noises that nobody declared: its suite, its judgement, and its page."""

from pathlib import Path

import numpy as np
import pytest

from eivor.lab.experiments import marks
from validation.studies import NOT_MET, WRONG, read_as
from validation.unknown_noise.study import PART, SUITE, Suite, Told, main, requirements

PAGE = Path(__file__).resolve().parents[2] / "docs" / "efficiency.md"
SMALL = """
name = "small"
runs = 2
seed = 1

[cases.short]
scenario = "rich-high"
samples = 400
order = 0.0
methods = ["generalized_iv_unknown_noise", "frisch_scheme"]
"""


def test_a_small_suite_runs_and_fills_a_page(tmp_path, capsys):
    begin, end = marks(PART)
    suite, page = tmp_path / "small.toml", tmp_path / "page.md"
    suite.write_text(SMALL, encoding="utf-8")
    page.write_text(f"{begin}\n{end}\n", encoding="utf-8")
    assert main([str(suite), "--page", str(page)]) in (0, NOT_MET)
    text = page.read_text(encoding="utf-8")
    assert "| short | frisch_scheme | noise_variance_velocity_z |" in text
    assert "2 records of each case" in text
    capsys.readouterr()
    assert main([str(suite), "--page", str(suite)]) == WRONG


def test_coverage_is_judged_of_what_is_not_refused():
    def told(parameter, held, refused=0, case="rich"):
        return Told(case, "m", parameter, np.zeros(100), np.arange(100) < held, refused)

    good = [
        told("viscous_friction", 95),
        told("noise_variance_input", 91),
        told("input_gain", 20, refused=100),
    ]
    assert all(item.met for item in requirements(good))
    assert [item.met for item in requirements([told("viscous_friction", 90), told("noise_x", 90)])] == [
        False,
        True,
    ]
    assert not requirements([told("input_gain", 95, refused=50, case="white")])[-1].met


@pytest.mark.parametrize(("path", "least"), [(SUITE, 1000), (SUITE.with_name("spectral.toml"), 1000)])
def test_the_published_suites_and_their_page_belong_together(path, least):
    suite = read_as(Suite, path)
    runs, seed, cases = suite.runs, suite.seed, suite.cases
    begin, end = marks(suite.part)
    text = PAGE.read_text(encoding="utf-8").partition(begin)[2].partition(end)[0]
    assert runs >= least
    assert f"{runs} records of each case, seed {seed}" in text
    for name, case in cases.items():
        for method in case.methods:
            assert f"| {name} | {method} |" in text
