"""Discrete nuisances on nested grids: which values are tried, from what, and in which order."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.estimation.variable_projection import Trial, between, on_nested_grids, with_values_tried
from eivor.linalg.system import Solution
from eivor.models.regression import Parameter
from eivor.models.separable import Bounds, Nuisance

GRID = np.array([0.0, 10.0, 20.0, 30.0])
UNSOLVED = Solution(np.zeros(1), np.zeros(1), 0.0, 1.0)
TREND = Nuisance(Parameter("trend"), np.array([1.0, 2.0]), discrete=True)


def delay(**more) -> Nuisance:
    return Nuisance(Parameter("delay"), GRID, **({"discrete": True} | more))


def tried(nuisances: tuple[Nuisance, ...], criterion) -> list[dict[str, float]]:
    return list(on_nested_grids(nuisances, lambda nuisance, _start: nuisance, criterion))


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        (6.0, [0.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0]),
        (11.0, [0.0, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 30.0]),
        (40.0, [0.0, 10.0, 20.0, 25.0, 27.5, 30.0]),
    ],
)
def test_steps_are_halved_beside_the_best_and_values_stay_in_order(truth, expected):
    made = tried((delay(halvings=2),), lambda item: abs(item["delay"] - truth))
    # both sides of the best; a side that has been tried already is not tried again
    assert set(expected) <= {item["delay"] for item in made}
    assert [item["delay"] for item in made] == sorted({item["delay"] for item in made})
    assert len(made) <= GRID.size + 4


def test_without_halvings_the_grid_is_what_is_tried():
    assert [item["delay"] for item in tried((delay(),), lambda item: item["delay"])] == GRID.tolist()
    continuous = (delay(discrete=False, halvings=1),)
    assert tried(continuous, lambda _: 0.0) == [{}]


def test_other_nuisances_stay_where_the_best_has_them():
    made = tried(
        (TREND, delay(halvings=1)), lambda item: abs(item["delay"] - 12.0) + abs(item["trend"] - 2.0)
    )
    finer = [item for item in made if item["delay"] not in GRID]
    assert finer == [{"trend": 2.0, "delay": 5.0}, {"trend": 2.0, "delay": 15.0}]
    assert made == sorted(made, key=lambda item: (item["trend"], item["delay"]))


def test_each_value_of_a_bounded_sum_has_a_best_of_its_own():
    lag = Nuisance(
        Parameter("lag"), np.array([20.0, 40.0]), True, bounds=Bounds(20.0, 40.0), known_with=("delay",)
    )
    made = tried((lag, delay(halvings=1)), lambda item: abs(item["delay"] - 0.5 * item["lag"]))
    finer = {(item["lag"] + item["delay"], item["delay"]) for item in made if item["delay"] not in GRID}
    # of a sum of 20 the best delay is near 7, of 40 near 13: 5 and 15 beside 10 for both
    assert finer == {(20.0, 5.0), (20.0, 15.0), (40.0, 5.0), (40.0, 15.0)}
    assert all(item["lag"] >= 0.0 for item in made)


def test_a_finer_candidate_is_made_from_the_best_beside_it():
    started = {}

    def made(nuisances, neighbours):
        started[nuisances["delay"]] = neighbours
        return nuisances["delay"]

    on_nested_grids((delay(halvings=2),), made, lambda value: abs(value - 13.0))
    assert started == {
        0.0: None,
        10.0: None,
        20.0: None,
        30.0: None,
        5.0: 10.0,
        15.0: 10.0,
        12.5: 15.0,
        17.5: 15.0,
    }


def test_values_that_were_tried_are_a_grid():
    lag = Nuisance(Parameter("lag"), GRID)
    points = [{"lag": 1.0, "delay": value} for value in (10.0, 0.0, 5.0, 10.0)]
    same, fixed = with_values_tried((lag, delay(halvings=2)), points)
    assert same is lag
    assert fixed.grid.tolist() == [0.0, 5.0, 10.0]
    assert [item["delay"] for item in tried((fixed,), lambda item: item["delay"])] == [0.0, 5.0, 10.0]


@pytest.mark.parametrize("begun", [0.055, 0.0605, 0.07])
@pytest.mark.parametrize("least", [0.0613, 0.05, 0.08])
def test_brents_search_finds_a_minimum_in_few_steps(begun, least):
    made = []

    def trial(point):
        made.append(point)
        return Trial(point, 3.0 + (point[0] - least) ** 2 * (1.0 + 5.0 * point[0]), UNSOLVED)

    best = trial((begun,))
    result = between(trial, best, (0.055, 0.07), 1e-6)
    expected = min(max(least, 0.055), 0.07)
    assert result.point[0] == pytest.approx(expected, abs=3e-6)
    assert result.objective <= best.objective
    # golden sections would take 20
    assert len(made) <= (12 if expected == least else 24)
