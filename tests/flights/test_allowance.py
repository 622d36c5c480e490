"""Systematic parts of intervals: those that widen, those that are a least width, those of the verdict."""

from __future__ import annotations

import pytest

from eivor.flights.estimate import with_systematic_uncertainties
from eivor.flights.quantity import (
    NAN,
    Counts,
    QuantityEstimate,
    SystematicUncertainty,
    Wording,
    widened,
)
from eivor.inference.verdict import Status, Verdict
from eivor.motions.vertical.motion import Vertical

LATE = SystematicUncertainty(Counts.ADDED, 0.0, 0.25, "late by up to a quarter")
BOTH = SystematicUncertainty(Counts.ADDED, 0.5, 0.5, "either way")
LEAST = SystematicUncertainty(Counts.AT_LEAST, 2.0, 2.0, "at least")
OWN = SystematicUncertainty(Counts.INDEPENDENT, 0.75, 2.4, "of its own")
RESERVE = SystematicUncertainty(Counts.RESERVED, 0.1, 0.3, "for the verdict")


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ((), (9.0, 11.0)),
        ((LATE,), (9.0, 11.25)),
        ((LATE, BOTH), (8.5, 11.75)),
        ((LEAST,), (8.0, 12.0)),
        ((LEAST, BOTH, LATE), (8.0, 12.0)),  # a least width is not added to what widens
        ((RESERVE,), (9.0, 11.0)),
        ((OWN,), (8.75, 12.6)),  # squares add up: 1, .75 and 1.25, 1, 2.4 and 2.6
        ((BOTH, OWN), (8.25, 13.1)),
    ],
)
def test_intervals_with_their_systematic_parts(parts, wanted):
    assert widened((9.0, 11.0), 10.0, parts) == wanted
    assert widened((9.0, 11.0), NAN, parts) == (9.0, 11.0)


def test_a_reserve_is_the_verdicts():
    parts = (LATE, RESERVE, LEAST, RESERVE)
    quantity = QuantityEstimate(10.0, "s", 0.5, (9.0, 11.0), systematic_uncertainties=parts)
    assert quantity.reserved_uncertainty == pytest.approx(0.6)


def test_a_result_keeps_its_parts_and_widens_other_levels_by_them():
    quantity_estimate = QuantityEstimate(
        10.0, "s", 0.5, widened((9.0, 11.0), 10.0, (BOTH, RESERVE)), systematic_uncertainties=(BOTH, RESERVE)
    )
    result = quantity_estimate.judged(Verdict(Status.WEAK), Wording("lag", "τ", "s"))
    assert result.systematic_uncertainties == (BOTH, RESERVE)
    assert result.interval == (8.5, 11.5)
    assert result.widened((9.5, 10.5)) == (9.0, 11.0)


def test_what_follows_from_a_headline_follows_it_when_it_widens():
    quantities = {
        "viscous_friction": QuantityEstimate(0.5, "1/s", 0.05, (0.4, 0.6)),
        "hover_input": QuantityEstimate(10.0, "", 0.5, (9.0, 11.0)),
        "time_constant": QuantityEstimate(2.0, "s", 0.2, (1.6, 2.6)),
    }
    same = with_systematic_uncertainties(
        Vertical(), quantities, {"viscous_friction": (RESERVE,), "hover_input": (LEAST,)}
    )
    assert same["time_constant"] == quantities["time_constant"]
    assert same["hover_input"].interval == (8.0, 12.0)
    part = SystematicUncertainty(Counts.ADDED, 0.15, 0.4, "more")
    wider = with_systematic_uncertainties(Vertical(), quantities, {"viscous_friction": (part,)})
    assert wider["viscous_friction"].interval == pytest.approx((0.25, 1.0))
    assert wider["time_constant"].interval == pytest.approx((1.0, 4.0))
