"""The study of what decides: logs that are thinned, a delay that is left out, and its page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from eivor.lab.experiments import marks
from eivor.lab.scenario_files import shipped_flight
from eivor.simulation.vertical import simulate_vertical_flights
from validation.choices import study
from validation.choices.study import (
    PART,
    QUANTITIES,
    THINNINGS,
    DelayTrial,
    RateTrial,
    Trial,
    tables,
    thinned,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "studies" / "coverage.md"
SEEDS, CHANCE = 4, 1e-3


def made_up(number: int) -> Trial:
    """Every quantity held at the two highest rates; the gain off by 1 or 3 %."""
    rates = [
        RateTrial("identified" if every < 5 else "weak", (every < 5, True, True, None)) for every in THINNINGS
    ]
    return Trial(tuple(rates), DelayTrial(0.0, True), DelayTrial(0.01 + 0.02 * number, False))


def test_tables_count():
    text = tables([made_up(0), made_up(1)])
    assert "| 50 Hz | 2 of 2 | 1.000 [0.342, 1.000] of 2 | 1.000 [0.342, 1.000] of 2 |" in text
    assert "| 20 Hz | 0 of 2 | 0.000 [0.000, 0.658] of 2 | 1.000 [0.342, 1.000] of 2 |" in text
    assert "| 100 Hz |" in text
    assert "of 2 | - |" in text
    assert "| left out | +2.00 ± 1.41 % | 0.000 [0.000, 0.658] of 2 |" in text


@pytest.mark.thorough
def test_thinned_logs_keep_every_so_many_samples():
    (flight,) = simulate_vertical_flights([shipped_flight()])
    log = thinned(flight.recording, 5)
    for name, channel in log.channels.items():
        whole = flight.recording.channels[name]
        assert (channel.rate_hz, channel.held) == (pytest.approx(20.0), whole.held)
        np.testing.assert_array_equal(channel.values, whole.values[::5])


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
