"""Grids of discrete nuisances that go on where the truth lies beyond their end."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.variable_projection import on_nested_grids, reaching
from eivor.inference.verdict import Status
from eivor.models.regression import Parameter
from eivor.models.separable import Bounds, Nuisance
from eivor.motions.identify import identify_flight
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights

DELAY = Nuisance(Parameter("delay"), np.array([0.0, 10.0, 20.0]), discrete=True, furthest=65.0)


def delays(criterion, rejected=lambda _: False, delay: Nuisance = DELAY) -> list[float]:
    return list(on_nested_grids((delay,), lambda item, _start: item["delay"], criterion, rejected))


@pytest.mark.parametrize(
    ("truth", "last"), [(12.0, 20.0), (20.0, 30.0), (33.0, 40.0), (60.0, 60.0), (90.0, 60.0)]
)
def test_a_grid_goes_on_while_its_last_value_alone_fits(truth, last):
    assert delays(lambda delay: (delay - truth) ** 2) == np.arange(0.0, last + 1.0, 10.0).tolist()


def test_a_last_value_that_fits_beside_others_is_the_end():
    assert delays(lambda delay: 0.01 * (delay - 60.0) ** 2 / 4.0) == DELAY.grid.tolist()


@pytest.mark.parametrize(("truth", "kept"), [(50.0, True), (90.0, False)])
def test_where_all_are_rejected_every_value_is_tried_and_kept_only_if_it_explains_more(truth, kept):
    # far from the truth the criterion is flat
    def criterion(delay: float) -> float:
        return min((delay - truth) ** 2, 100.0)

    assert delays(criterion, lambda delay: criterion(delay) > 50.0) == (
        [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0] if kept else DELAY.grid.tolist()
    )
    assert delays(criterion) == DELAY.grid.tolist()


def test_values_that_explain_more_and_are_rejected_too_are_not_taken():
    # columns that have little to do with the instruments
    def criterion(delay: float) -> float:
        return 100.0 - 2.0 * max(delay - 20.0, 0.0)

    assert delays(criterion, lambda _: True) == DELAY.grid.tolist()
    assert len(delays(criterion, lambda delay: criterion(delay) > 50.0)) > len(DELAY.grid)


def test_between_the_values_of_a_grid_one_may_fit():
    halved = replace(DELAY, halvings=1)

    def criterion(delay: float) -> float:
        return 60.0 if delay == 5.0 else 100.0 + delay - 100.0 * (delay > 20.0)

    assert delays(criterion, lambda delay: criterion(delay) > 70.0, halved) == [0.0, 5.0, 10.0, 20.0]


@pytest.mark.parametrize(("known", "tried"), [((15.0, 20.0), {0.0, 10.0, 20.0}), ((3.0, 3.0), {0.0})])
def test_bounds_of_a_sum_may_leave_no_further_value(known, tried):
    # wrong bounds: the data reject all that is between them, and a longer delay does not fit in
    sums = Nuisance(Parameter("lag"), np.unique(known), True, bounds=Bounds(*known), known_with=("delay",))
    nested_grids = on_nested_grids((sums, DELAY), lambda item, _start: item, lambda _: 99.0, lambda _: True)
    assert {nested_grid["delay"] for nested_grid in nested_grids} == tried


def test_what_lies_behind_values_that_fit_worse_is_not_taken():
    # the next period of a periodic motion
    def criterion(delay: float) -> float:
        return 100.0 * (1.2 - math.cos(0.1 * delay)) / (1.0 + delay / 30.0)

    assert criterion(60.0) < 0.5 * criterion(0.0)
    assert delays(criterion, lambda _: True) == DELAY.grid.tolist()


def test_a_pool_has_a_grid_as_long_as_the_longest_of_its_flights():
    lag = Nuisance(Parameter("lag"), np.array([1.0, 2.0]))
    points = [{"lag": 1.0, "delay": 20.0}, {"lag": 2.0, "delay": 42.5}]
    same, longer = reaching((lag, DELAY), points)
    assert same is lag
    assert longer.grid.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert reaching((lag, DELAY), points[:1]) == (lag, DELAY)


def test_a_grid_without_a_furthest_value_ends_where_it_ends():
    ends = Nuisance(Parameter("delay"), DELAY.grid, discrete=True)
    assert delays(lambda delay: -100.0 * delay, lambda _: True, ends) == DELAY.grid.tolist()
    assert ends.longest is ends
    assert ends.longer is ends


@pytest.mark.thorough
def test_a_flight_tells_a_delay_beyond_the_usual_ones():
    # at 40 ms, the last of the usual delays, lag and gain came out too large and outside their intervals
    delay = 0.16
    spec = VerticalFlightSpec(delay=delay, gust_rms=0.1, seed=1, duration=40.0)
    (flight,) = simulate_vertical_flights([spec])
    result = identify_flight(flight.recording, input_map="square")
    for name, truth in (
        ("viscous_friction", 0.4),
        ("input_gain", flight.truth.input_gain),
        ("effective_lag", delay + 0.04),
    ):
        low, high = result.interval(name)
        assert low <= truth <= high
    assert result.verdict.status is Status.IDENTIFIED
