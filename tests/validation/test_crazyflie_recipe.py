"""What others published of a Crazyflie is found again by their recipe, from the real logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation.crazyflie.study import PUBLISHED, PUBLISHED_LAG_S, Logs, Steps, best_lag, numbers, table


@pytest.fixture(scope="module")
def logs(recordings) -> Logs:
    return Logs.of_folder(recordings / "arpl-crazyflie")


def test_the_published_numbers_come_out(logs):
    result = numbers(logs, Steps())
    assert result.thrust == pytest.approx(PUBLISHED.thrust, abs=1e-4)
    assert result.inertia == pytest.approx(PUBLISHED.inertia, rel=1e-3)


@pytest.mark.thorough
def test_each_step_does_what_the_page_says(logs):
    result = numbers(logs, Steps())
    assert numbers(logs, Steps(gravity=9.81)).inertia[0] / result.inertia[0] == pytest.approx(9.81 / 9.18)
    assert numbers(logs, Steps(torque_has_the_noise=True)).inertia[1] > 1.4 * result.inertia[1]
    assert numbers(logs, Steps(own_thrust=True)).inertia[0] < 0.9 * result.inertia[0]
    lag = best_lag(logs.thrust)
    assert lag == pytest.approx(0.0741, abs=2e-4)
    assert lag > PUBLISHED_LAG_S + 0.002
    assert numbers(logs, Steps(lag_s=lag)).inertia[0] / result.inertia[0] == pytest.approx(0.981, abs=2e-3)


@pytest.mark.thorough
def test_the_page_has_the_table(recordings):
    page = Path(__file__).parents[2] / "docs" / "crazyflie.md"
    text = page.read_text(encoding="utf-8")
    for row in table(recordings / "arpl-crazyflie"):
        assert row in text
