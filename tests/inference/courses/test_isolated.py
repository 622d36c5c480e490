"""Single estimates that lie far from those before and after them."""

import numpy as np
import pytest

from eivor.fleet.change_points import outlier_test
from eivor.inference.random_effects import Groups, one_group


def added(y: np.ndarray, sizes: list[int], sets: Groups | None = None) -> np.ndarray:
    """What is added to variances of 1e-4, the groups a set unless said otherwise."""
    v = np.full(y.size, 1e-4)
    return outlier_test(Groups(np.array(sizes)), sets or one_group(len(sizes)), v)(y)


def noise(seed: int, rows: int) -> np.ndarray:
    return 0.004 * np.random.default_rng(seed).standard_normal(rows)


@pytest.mark.parametrize("place", [0, 1, 2, 9, 18, 19])
def test_a_single_far_estimate_has_its_distance_as_error(place):
    y = noise(1, 20)
    y[place] += 0.3
    result = added(y, [20])
    assert np.flatnonzero(result).tolist() == [place]
    assert np.sqrt(result[place]) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("place", [3, 4, 10, 16, 17])
@pytest.mark.parametrize("size", [0.05, 0.5, -5.0])
def test_steps_and_drifts_are_courses(place, size):
    y = noise(2, 20)
    y[place:] += size
    assert not added(y, [20]).any()
    assert not added(noise(2, 20) + np.linspace(0.0, size, 20), [20]).any()


def test_two_in_a_row_are_isolated():
    y = noise(3, 20)
    y[8:10] += 0.3
    assert np.flatnonzero(added(y, [20])).tolist() == [8, 9]


def test_groups_end_where_they_end():
    """Another group's level is no neighbour; one that scatters more by itself is held to its own scatter."""
    y = np.concatenate([noise(4, 1), 5.0 + noise(5, 12), -5.0 + 0.2 * (-1.0) ** np.arange(12), noise(7, 2)])
    assert not added(y, [1, 12, 12, 2]).any()
    assert added(y, [1, 12, 12, 2], Groups(np.array([1, 3]))).tolist() == added(y, [1, 12, 12, 2]).tolist()
    assert not added(np.zeros(3), [1, 1, 1]).any()


def test_few_of_normal_estimates_are_isolated():
    sizes = [40] * 250
    assert 0.0 < np.mean(added(2.5 * noise(8, 10_000), sizes) > 0.0) < 0.006
