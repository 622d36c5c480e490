"""The study of what decides: logs that are thinned, a delay that is left out, and its page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from eivor.lab.experiments import marks
from validation.choices import study
from validation.choices.study import (
    PART,
    QUANTITIES,
    THINNINGS,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "studies" / "coverage.md"
SEEDS, CHANCE = 4, 1e-3


def test_the_page_holds_a_run():
    begin, end = marks(PART)
    displayed = PAGE.read_text(encoding="utf-8").partition(begin)[2].partition(end)[0]
    assert f"{study.FLIGHTS} flights, seeds 0 to {study.FLIGHTS - 1}" in displayed
    assert displayed.count(f" of {study.FLIGHTS} |") >= len(THINNINGS) * len(QUANTITIES)


def test_wrong_calls_are_told(capsys):
    assert study.main(["--flights", "1"]) == 2
    assert "Expected two flights or more; received 1" in capsys.readouterr().err


@pytest.mark.calibration
def test_quick_logs_are_identified_and_a_delay_belongs_into_the_model():
    """What the page is for; the seeds are its first ones."""
    trials = study.run(SEEDS, workers=1)
    full = [trial.rates[0] for trial in trials]
    assert sum(rate.verdict == "identified" for rate in full) >= binom.ppf(CHANCE, SEEDS, 0.95)
    assert all(trial.rates[item].verdict != "identified" for trial in trials for item in (2, 3))
    held = [all_held for rate in full for all_held in rate.held]
    assert sum(held) >= binom.ppf(CHANCE, len(held), 0.93)
    shift = np.array([[trial.with_delay.error, trial.without_delay.error] for trial in trials]).mean(axis=0)
    assert abs(shift[0]) < 0.005
    assert shift[1] > 0.01
