"""Quadratics through points around the best place lead to the least of a smooth function within the cube."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from eivor.estimation.quadratics import least_of_quadratic, quadratics_settle

ACCURACY = 1e-7


def settled(
    function: Callable[[np.ndarray], float], begin: tuple[float, ...]
) -> tuple[bool, np.ndarray, int]:
    """Whether the search settles, the least place it has seen, and how many values that took."""
    seen: list[tuple[float, tuple[float, ...]]] = []

    def value_at(place: np.ndarray) -> float:
        assert (place >= 0.0).all()
        assert (place <= 1.0).all()
        seen.append((function(place), tuple(place)))
        return seen[-1][0]

    found = quadratics_settle(value_at, np.array(begin), np.full(len(begin), 0.05), ACCURACY)
    return found, np.array(min(seen)[1]), len(seen)


def curved(at: tuple[float, ...]) -> Callable[[np.ndarray], float]:
    """A function with its least there, which is no quadratic, and whose axes depend on each other."""
    centre = np.array(at)

    def value(place: np.ndarray) -> float:
        away = place - centre
        return float(1.0 + np.cosh(2.0 * away).sum() + 1.5 * away[0] * away[-1] + 0.3 * (away**3).sum())

    return value


@pytest.mark.parametrize("at", [(0.31, 0.62), (0.31, 0.62, 0.44)])
def test_it_settles_at_the_least_with_few_values(at):
    found, place, values = settled(curved(at), tuple(x + 0.07 for x in at))
    assert found
    np.testing.assert_allclose(place, at, atol=10.0 * ACCURACY)
    assert values <= 15 * len(at) * 2


def test_a_least_beyond_the_cube_is_sought_on_its_face():
    function = curved((-0.05, 0.4))
    found, place, _ = settled(function, (0.08, 0.5))
    assert found
    assert place[0] == 0.0
    nearby = [function(np.array([0.0, place[1] + step])) for step in (-1e-3, 1e-3)]
    assert function(place) <= min(nearby)


def test_where_nothing_bends_upwards_it_says_so():
    found, _, values = settled(lambda place: -float(place @ place), (0.5, 0.5))
    assert not found
    assert values < 10


def test_bounds_are_met_one_after_another():
    bend = np.array([[2.0, 1.5], [1.5, 2.0]])
    place = least_of_quadratic(np.array([-4.0, -1.0]), bend, np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
    # with x = 1 on its bound, 2 y + 1.5 - 1 = 0
    np.testing.assert_allclose(place, [1.0, -0.25])
