"""Quantities before and after they are judged."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eivor.flights.quantity import QuantityEstimate, Wording
from eivor.inference.verdict import Status, Verdict

LAG = Wording("lag", "τ", "s", lowest=0.0)
INFINITY = float("inf")


@pytest.mark.parametrize(
    ("interval", "possible"),
    [
        ((-1.0, 2.0), (0.0, 2.0)),
        ((0.5, 2.0), (0.5, 2.0)),
        ((-1.0, 0.0), (0.0, 0.0)),
        # Nothing possible is left, or nothing was said: cutting would say more than the data do.
        ((-2.0, -1.0), (-2.0, -1.0)),
        ((-INFINITY, INFINITY), (-INFINITY, INFINITY)),
    ],
)
def test_intervals_end_where_the_quantity_does(interval, possible):
    quantity = QuantityEstimate(1.0, "s", 0.5, interval).judged(Verdict(Status.WEAK), LAG)
    assert quantity.interval == possible
    assert quantity.verdict is Status.WEAK
    anything = QuantityEstimate(1.0, "s", 0.5, interval).judged(
        Verdict(Status.WEAK), replace(LAG, lowest=-INFINITY)
    )
    assert anything.interval == interval


def test_what_is_not_judged_has_no_verdict():
    assert not hasattr(QuantityEstimate(1.0, "s", 0.5, (0.0, 2.0)), "verdict")
