"""Search in boxes: valleys, ends of grids, and functions without a least value."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from eivor.errors import ConvergenceError
from eivor.estimation.variable_projection import argmin


def over(box, function):
    """Values of a function of one array for each variable, at the points of a box."""
    mesh = np.meshgrid(*box, indexing="ij")
    return np.asarray(function(*mesh), dtype=np.float64).ravel()


@pytest.mark.parametrize("least", [0.123456, 3.0, 4.999])
def test_one_variable_is_found_between_the_places_of_its_grid(least):
    grid = [np.linspace(0.0, 5.0, 11)]
    result = argmin(lambda box: (box[0] - least) ** 2, grid)
    assert result == pytest.approx([least], abs=0.5 * 2.0**-16)


@pytest.mark.parametrize(("slope", "end"), [(1.0, 0.0), (-1.0, 5.0)])
def test_what_is_least_at_an_end_is_there(slope, end):
    result = argmin(lambda box: slope * box[0], [np.linspace(0.0, 5.0, 11)])
    np.testing.assert_array_equal(result, [end])


@pytest.mark.parametrize("axes", [2, 3, 4])
def test_a_narrow_valley_across_the_axes_is_followed(axes):
    """The grid's least is some of its steps away from the least between them."""
    least = np.array([0.31, 0.62, 0.45, 0.55])[:axes]

    def valley(*values):
        away = [value - item for value, item in zip(values, least, strict=True)]
        across = sum((a - b) ** 2 for a, b in pairwise(away))
        return sum(away) ** 2 + 400.0 * across

    result = argmin(lambda box: over(box, valley), [np.linspace(0.0, 1.0, 5)] * axes)
    np.testing.assert_allclose(result, least, atol=1e-4)


def test_of_two_valleys_the_deeper_one_is_searched():
    def two(x):
        return np.minimum((x - 1.0) ** 2, (x - 4.0) ** 2 - 0.1)

    assert argmin(lambda box: two(box[0]), [np.linspace(0.0, 5.0, 11)]) == pytest.approx([4.0], abs=1e-4)


def test_nothing_to_search_is_one_place():
    assert argmin(lambda _: np.zeros(1), []).size == 0


def test_a_search_that_never_settles_is_given_up():
    calls = iter(range(1000))

    def moving(box):
        """Least in the middle at first, then at the upper end of four boxes out of five."""
        (positions,), call = box, next(calls)
        return np.abs(positions - positions.mean()) if call < 3 or call % 5 == 0 else -positions

    with pytest.raises(ConvergenceError, match="still moves after 100 boxes"):
        argmin(moving, [np.linspace(-100.0, 100.0, 11)])
