"""The study of planned flights: its vehicles fly, and its table tells what they reached."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.planning.vehicle import FlightLimits, candidates
from eivor.simulation.environment import Trajectory
from validation.plan.study import (
    GRID,
    OTHER_CONTROLLER,
    OWN,
    PLANNED_FOR,
    Outcome,
    answer,
    outcomes,
    requirements_of,
    table,
)

SHORT = FlightLimits(duration_s=20.0)


@pytest.mark.thorough
def test_vehicles_follow_a_plan_under_both_controllers():
    vehicle = OWN[2]
    shape = next(candidates(SHORT, ("multisine",), 0))
    reference = Trajectory(shape.offset, *shape.derivatives)
    heights = []
    for gains in (1.0, OTHER_CONTROLLER):
        flight = vehicle.fly(reference, 1, gains=gains)
        assert np.abs(flight.height - shape.offset).max() < 0.6
        heights.append(flight.height)
    assert np.abs(heights[0] - heights[1]).max() > 0.005


def test_the_table_has_medians_and_shares():
    selected = [
        Outcome("a", "lag", 0, "steps", 2.0, reached, True, kept)
        for reached, kept in ((2.0, True), (4.0, False))
    ]
    other = Outcome("b", "friction", 0, "steps", 0.1, 0.05, False, True)
    lines = table([*selected, other]).splitlines()
    assert "| a | effective lag | 2 | 2 ms | 3 ms | 1.50 | 2 of 2 | 1 of 2 |" in lines
    assert "| **all** | viscous friction | 1 | 0.1 1/s | 0.05 1/s | 0.50 | 0 of 1 | 1 of 1 |" in lines


def test_flights_that_are_kept_are_not_flown_again(tmp_path, monkeypatch):
    def flown(vehicle, requested, seed):
        asked_of.append((vehicle.name, *requested))
        return (Outcome(vehicle.name, *each, "steps", 1.0, 1.2, True, True) for each in requested)

    monkeypatch.setattr("validation.plan.study.outcomes", flown)
    asked_of: list[tuple[object, ...]] = []
    kept = tmp_path / "kept.jsonl"
    first, _ = answer(GRID, "small", kept)
    assert [item for item in asked_of if item[1:]] == [
        (vehicle.name, *((target, number) for target in PLANNED_FOR for number in (0, 1))) for vehicle in OWN
    ]
    kept.write_text("".join(kept.read_text().splitlines(keepends=True)[:-1]))
    asked_of.clear()
    assert answer(GRID, "small", kept)[0] == first
    assert [item for item in asked_of if item[1:]] == [("heavy, slow", ("lag", 1))]


def test_what_is_asked_of_planned_flights():
    selected = [Outcome("a", target, 0, "steps", 1.0, 1.5, True, True) for target in PLANNED_FOR]
    assert [item.met for item in requirements_of(selected)] == [False, True, True, True]
    left = [*selected, Outcome("a", "lag", 1, "steps", 1.0, 2.6, False, False)]
    assert [item.met for item in requirements_of(left)] == [False, False, False, False]


@pytest.mark.calibration
def test_planned_flights_reach_what_was_predicted():
    """Bounds of the study, with room for four flights."""
    result = list(outcomes(OWN[1], [(target, number) for target in PLANNED_FOR for number in (0, 1)], 1))
    ratios = {
        target: [item.ratio for item in result if item.target == target] for target in ("friction", "lag")
    }
    assert 0.6 < np.median(ratios["friction"]) < 1.6
    assert 0.5 < np.median(ratios["lag"]) < 2.0
    assert all(item.kept for item in result)
