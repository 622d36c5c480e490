from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.quantity import Choice, Quantity, Wording
from eivor.inference.verdict import Status
from eivor.motions.vertical.motion import Vertical
from eivor.report.document import printable
from eivor.report.flight import NO_NUMBER, numbers

NAN, INFINITY = float("nan"), float("inf")
PLAIN = Wording("x", "x", "")


def _quantity(value: float, low: float, high: float) -> Quantity:
    return Quantity(value, "", NAN, (low, high), Status.WEAK)


@pytest.mark.parametrize(
    ("value", "low", "high", "shown"),
    [
        (0.18596, 0.1623, 0.2096, ("0.186", "[0.162, 0.210]")),
        (69.29, 64.03, 75.67, ("69.3", "[64.0, 75.7]")),
        (0.119812, 0.115812, 0.1232, ("0.1198", "[0.1158, 0.1232]")),
        (1787.79, 1786.85, 1788.74, ("1787.79", "[1786.85, 1788.74]")),
        (3.068e-6, 3.056e-6, 3.081e-6, ("3.068e-6", "[3.056e-6, 3.081e-6]")),
        (-0.0001, -0.04, 0.04, ("0.000", "[-0.040, 0.040]")),
        (12.0, -5870.0, 7012.0, ("0", "[-5900, 7000]")),
        (0.0, 0.0, 0.0, ("0", "[0, 0]")),
        (0.5, 0.5, 0.5, ("0.5000", "[0.5000, 0.5000]")),
        (NAN, -INFINITY, INFINITY, (NO_NUMBER, NO_NUMBER)),
        (0.5136, -INFINITY, INFINITY, ("0.5136", NO_NUMBER)),
        (2.5e7, 2.4e7, 2.6e7, ("2.50e7", "[2.40e7, 2.60e7]")),
    ],
)
def test_the_interval_decides_the_digits(
    value: float, low: float, high: float, shown: tuple[str, str]
) -> None:
    assert numbers(_quantity(value, low, high), PLAIN) == shown


def test_lags_are_in_milliseconds() -> None:
    assert numbers(_quantity(0.0718, 0.0703, 0.0733), Vertical.wording["effective_lag"])[0] == "71.8"


@pytest.mark.parametrize(
    ("fitting", "shown"),
    [
        ((0.0,), "0 (3 tried)"),
        ((0.0, 0.01), "0 or 10 (3 tried)"),
        ((0.0, 0.01, 0.02), "0, 10 or 20 (3 tried)"),
    ],
)
def test_a_choice_is_no_interval(fitting: tuple[float, ...], shown: str) -> None:
    chosen = Quantity(
        0.01, "s", NAN, (fitting[0], fitting[-1]), Status.WEAK, Choice(fitting, (0.0, 0.01, 0.02))
    )
    assert numbers(chosen, Vertical.wording["delay"]) == ("10", shown)
    alone = replace(chosen, choice=Choice((0.0,), (0.0,)))
    assert numbers(alone, Vertical.wording["delay"]) == ("10", NO_NUMBER)


def test_any_size_gives_short_text() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        centre = rng.choice([-1, 1]) * 10 ** rng.uniform(-12, 12)
        width = abs(centre) * 10 ** rng.uniform(-8, 8)
        value, interval = numbers(_quantity(centre, centre - width, centre + width), PLAIN)
        assert float(value) == pytest.approx(centre, abs=0.051 * width + 1e-9 * abs(centre))
        low, high = (float(end) for end in interval.strip("[]").split(","))
        assert high - low == pytest.approx(2 * width, rel=0.11, abs=1e-9 * abs(centre))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("flight.ulg", "flight.ulg"),
        ("Übung 飛行.csv", "Übung 飛行.csv"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("a\nb\tc\r\x07", "a\\nb\\tc\\r\\x07"),
        ("\u202egnp.exe", "\\u202egnp.exe"),
        ("\udcff", "\\udcff"),
        ("\x9b31m", "\\x9b31m"),
    ],
)
def test_nothing_that_acts_on_a_terminal_passes(text: str, shown: str) -> None:
    assert printable(text) == shown
