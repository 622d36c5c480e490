"""The study of bands of joint draws: its response, one flight of it, and the page that it makes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from validation.response_band.study import COVERAGE, LEVEL, TIMES_S, climb_rates, main

PAGE = Path(__file__).parents[2] / "docs" / "exports.md"


def test_climb_rates_are_those_of_the_state_space() -> None:
    friction, gain, lag, delay = 0.3, 23.9, 0.05, 0.012
    motion = np.array([[-1.0 / lag, 0.0, 1.0 / lag], [gain, -friction, 0.0], [0.0, 0.0, 0.0]])
    (rates,) = climb_rates(*(np.array([item]) for item in (friction, gain, lag, delay)))
    for time, rate in zip(TIMES_S, rates, strict=True):
        assert rate == pytest.approx(expm(motion * (time - delay))[1, 2], rel=1e-9)
    assert climb_rates(*(np.array([item]) for item in (friction, gain, lag, 0.06)))[0, 0] == 0.0


@pytest.mark.thorough
def test_a_flight_of_the_study_and_its_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid, page, kept = (tmp_path / name for name in ("grid.toml", "page.md", "kept.jsonl"))
    grid.write_text('[[flights]]\nname = "calm"\nsmall = 2\nfull = 2\n', encoding="utf-8")
    page.write_text("<!-- generated: response band -->\n<!-- end: response band -->\n", encoding="utf-8")
    arguments = ["--grid", str(grid), "--kept", str(kept), "--page", str(page)]
    assert main(arguments) in {0, 3}
    first = kept.read_text(encoding="utf-8")
    for item in (json.loads(line) for line in first.splitlines()):
        assert item["verdict"] == "identified"
        assert len(item["held"]) == len(item["held_at_best"]) == len(TIMES_S)
        assert all(0.0 < width < 0.2 for width in item["width"])
    main(arguments)
    assert kept.read_text(encoding="utf-8") == first
    assert "| calm | 2 | 2 |" in capsys.readouterr().out
    assert "| calm | 2 | 2 |" in page.read_text(encoding="utf-8")


def test_the_page_says_what_was_asked() -> None:
    text = PAGE.read_text(encoding="utf-8")
    requested, measured, met = re.findall(r"\| ([\d.]+ to [\d.]+) \| ([\d.]+) \| (yes|no) \|", text)[0]
    low, high = COVERAGE
    assert requested == f"{low:g} to {high:g}"
    assert met == ("yes" if low <= float(measured) <= high else "no")
    assert LEVEL == 0.9
