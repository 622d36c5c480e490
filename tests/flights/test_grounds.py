"""Grounds that any motion may have."""

from __future__ import annotations

import math

import pytest

from eivor.flights.quantity import QuantityEstimate
from eivor.flights.verdict import unbounded_reasons
from eivor.inference.verdict import Reason, Status


@pytest.mark.parametrize("interval", [(-math.inf, math.inf), (0.0, math.inf), (-math.inf, 1.0)])
def test_an_interval_without_an_end_tells_nothing(interval: tuple[float, float]) -> None:
    quantity = QuantityEstimate(1.0, "s", 0.1, interval)
    (reason,) = unbounded_reasons(quantity, "input gain", ())
    assert reason.status is Status.REFUSED
    assert reason.sentence.startswith("The input gain has no interval with two ends")
    assert not unbounded_reasons(quantity, "input gain", (Reason(Status.REFUSED, "It is said already."),))


@pytest.mark.parametrize("interval", [(0.5, 1.5), (math.nan, math.nan)])
def test_other_intervals_are_left_to_the_motion(interval: tuple[float, float]) -> None:
    assert not unbounded_reasons(QuantityEstimate(1.0, "s", 0.1, interval), "input gain", ())
